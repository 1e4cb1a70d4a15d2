//! Every example runs, and finds its own answer right: each returns an error where it does not.

#[path = "../examples/association.rs"]
mod association;
#[path = "../examples/encoder_calibration.rs"]
mod encoder_calibration;
#[path = "../examples/equal_evaluations.rs"]
#[allow(dead_code, reason = "the tests run it in small")]
mod equal_evaluations;
#[path = "../examples/filters.rs"]
mod filters;
#[path = "../examples/fusion.rs"]
mod fusion;
#[path = "../examples/hidden_markov.rs"]
mod hidden_markov;
#[path = "../examples/ising_denoising.rs"]
mod ising_denoising;
#[path = "../examples/kcpf.rs"]
mod kcpf;
#[path = "../examples/ldpc.rs"]
mod ldpc;
#[path = "../examples/linear_chain.rs"]
mod linear_chain;
#[path = "../examples/own_factor.rs"]
mod own_factor;
#[path = "../examples/own_message.rs"]
mod own_message;
#[path = "../examples/own_optimizer.rs"]
mod own_optimizer;
#[path = "../examples/own_schedule.rs"]
mod own_schedule;
#[path = "../examples/p_mpa.rs"]
mod p_mpa;
#[path = "../examples/pose_graph.rs"]
mod pose_graph;
#[path = "../examples/swap_forms.rs"]
mod swap_forms;
#[path = "../examples/switching.rs"]
mod switching;
#[path = "../examples/underwater.rs"]
mod underwater;

macro_rules! run {
    ($($example:ident),*) => {$(
        #[test]
        fn $example() {
            crate::$example::main().unwrap();
        }
    )*};
}

/// One test per example, by its name.
mod of {
    run!(
        association,
        encoder_calibration,
        filters,
        fusion,
        hidden_markov,
        ising_denoising,
        kcpf,
        ldpc,
        linear_chain,
        own_factor,
        own_message,
        own_optimizer,
        own_schedule,
        p_mpa,
        pose_graph,
        swap_forms,
        switching,
        underwater
    );

    #[test]
    fn equal_evaluations() {
        crate::equal_evaluations::in_small().unwrap();
    }
}
