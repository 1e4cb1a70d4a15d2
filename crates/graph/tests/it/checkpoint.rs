//! Saving, loading, and going on as if nothing had happened.

use crate::bell::{Behaviour, Bell, Graph, Linear, chain, grid};
use sumprod_graph::schedule::{Flooding, ForwardBackward, Sequential};
use sumprod_graph::{Checkpoint, Engine, GraphError, Options, Schedule};

fn options(max_iterations: usize) -> Options {
    Options { seed: 7, max_iterations, tolerance: 0.0, damping: 0.3, ..Options::default() }
}

fn saved(graph: &Graph, schedule: &mut dyn Schedule, iterations: usize) -> String {
    let mut engine = Engine::new(graph, options(iterations)).unwrap();
    engine.run(schedule).unwrap();
    serde_json::to_string(&engine.checkpoint()).unwrap()
}

fn load(text: &str) -> Checkpoint<Bell> {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_resumed_run_equals_the_uninterrupted_one() {
    let mut graph = grid::<true>(6, Behaviour::Drawing);
    // Starts that still stand in for beliefs at the time of saving: this variable hears of nothing proper.
    let lonely = graph.variable("lonely", sumprod_graph::Space::real(1)).unwrap();
    graph.set_start(lonely, Bell::new(3.0, 1.0)).unwrap();
    type Make = fn() -> Box<dyn Schedule>;
    let schedules: [Make; 2] = [|| Box::new(Flooding), || Box::new(Sequential::default())];
    for make in schedules {
        let whole = saved(&graph, &mut *make(), 7);
        for split in [0, 1, 3] {
            let part = load(&saved(&graph, &mut *make(), split));
            // The seed is the checkpoint's own.
            let rest = Options { seed: 99, ..options(7 - split) };
            let mut engine = Engine::resume(&graph, rest, part).unwrap();
            engine.run(&mut *make()).unwrap();
            assert_eq!(serde_json::to_string(&engine.checkpoint()).unwrap(), whole, "split after {split}");
        }
    }
}

#[test]
fn sweeps_resume_too() {
    let graph = chain::<true>(10, Behaviour::Drawing);
    let whole = saved(&graph, &mut ForwardBackward::iterated(4), 4);
    let part = load(&saved(&graph, &mut ForwardBackward::iterated(1), 4));
    let mut engine = Engine::resume(&graph, options(4), part).unwrap();
    engine.run(&mut ForwardBackward::iterated(3)).unwrap();
    assert_eq!(serde_json::to_string(&engine.checkpoint()).unwrap(), whole);
}

#[test]
fn another_graph_is_refused() {
    let graph = chain::<true>(5, Behaviour::Exact);
    let text = saved(&graph, &mut Flooding, 2);
    let refuse = |graph: &Graph, text: &str| {
        let error = Engine::resume(graph, options(2), load(text)).map(|_| ()).unwrap_err();
        assert!(matches!(error, GraphError::Checkpoint(_)), "{error}");
        error.to_string()
    };
    assert!(Engine::resume(&graph, options(2), load(&text)).is_ok());
    assert!(refuse(&chain(6, Behaviour::Exact), &text).contains("other variables"));
    // The same sizes, one factor on another variable.
    let mut moved = Graph::new();
    let x: Vec<_> =
        (0..5).map(|k| moved.variable(format!("x{k}"), sumprod_graph::Space::real(1)).unwrap()).collect();
    moved.factor("prior", Linear::prior(1.0, 2.0), &x[1..2]).unwrap();
    for k in 1..5 {
        moved.factor("step", Linear::step(0.5, 1.0), &x[k - 1..=k]).unwrap();
        if k % 3 == 0 {
            moved.factor("measurement", Linear::prior(0.9, 0.5), &[x[k]]).unwrap();
        }
    }
    assert_eq!(moved.edge_count(), graph.edge_count());
    refuse(&moved, &text);
    // Another version, and arrays that were cut short.
    assert!(refuse(&graph, &text.replace("\"version\":1", "\"version\":2")).contains("version is 2"));
    for field in ["messages", "beliefs", "guessed", "sent"] {
        let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
        value[field].as_array_mut().unwrap().pop();
        refuse(&graph, &value.to_string());
    }
}
