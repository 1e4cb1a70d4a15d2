//! Windows: what they refuse, what they forget, and what they must not.

use crate::bell::{BAD_FORM, Behaviour, Bell, Linear};
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{GraphError, Options, Space, Window, WindowVariable};

type Line = Window<Bell, Linear>;

fn window(lag: usize) -> Line {
    Window::new(lag, Options::default()).unwrap()
}

/// A random walk: begins a slice, steps from `last`, and measures.
fn advance(window: &mut Line, k: usize, last: Option<WindowVariable>, measured: f64) -> WindowVariable {
    window.begin(k as f64).unwrap();
    let x = window.variable(format!("x{k}"), Space::real(1)).unwrap();
    match last {
        Some(last) => window.factor("step", Linear::step(0.1, 1.0), &[(last, 0), (x, 0)]).unwrap(),
        None => window.set_prior(x, Bell::new(0.0, 4.0)).unwrap(),
    }
    window.factor("measure", Linear::prior(measured, 2.0), &[(x, 0)]).unwrap();
    x
}

#[test]
fn misuse_is_refused() {
    let error = Line::new(0, Options::default()).map(|_| ()).unwrap_err();
    assert!(matches!(error, GraphError::Option { what: "the window's lag", .. }), "{error}");
    let mut window = window(2);
    assert!(matches!(window.variable("early", Space::real(1)), Err(GraphError::Schedule(_))));
    window.begin(1.0).unwrap();
    for time in [1.0, 0.5, f64::NAN, f64::INFINITY] {
        assert!(matches!(window.begin(time), Err(GraphError::Option { what: "the slice's time", .. })));
    }
    let x = window.variable("x", Space::real(1)).unwrap();
    for k in 2..6 {
        window.begin(k as f64).unwrap();
    }
    let unknown = |result: Result<(), GraphError>| {
        assert!(matches!(result, Err(GraphError::Unknown { what: "window variable", index: 0, .. })));
    };
    unknown(window.factor("late", Linear::prior(0.0, 1.0), &[(x, 0)]));
    unknown(window.set_prior(x, Bell::new(0.0, 1.0)));
    unknown(window.set_start(x, Bell::new(0.0, 1.0)));
    unknown(window.set_belief(x, Bell::new(0.0, 1.0)));
    unknown(window.set_belief_form(x, 0));
    assert_eq!(window.belief(x), None);
}

#[test]
fn errors_speak_of_the_window_s_names() {
    let mut window = window(3);
    let first = advance(&mut window, 0, None, 1.0);
    let second = advance(&mut window, 1, Some(first), 1.0);
    let bad = Linear::step(0.0, 1.0).behaving(Behaviour::NotANumber(1));
    window.factor("bad", bad, &[(first, 0), (second, 0)]).unwrap();
    let error = window.run(&mut Flooding).unwrap_err();
    assert!(matches!(&error, GraphError::Rule { variable, port: 1, .. } if variable == "x1"), "{error}");
    let error = window.run(&mut ForwardBackward::new()).unwrap_err();
    let GraphError::Loop(names) = &error else { panic!("{error}") };
    assert!(names.contains(&"x0".to_owned()) && names.contains(&"x1".to_owned()), "{names:?}");

    let mut wrong = self::window(1);
    let x = advance(&mut wrong, 0, None, 1.0);
    wrong.factor("form", Linear::prior(0.0, 1.0), &[(x, BAD_FORM)]).unwrap();
    let error = wrong.run(&mut Flooding).unwrap_err();
    assert!(matches!(&error, GraphError::Form { variable, .. } if variable == "x0"), "{error}");
}

#[test]
fn nothing_grows_with_time() {
    for lag in [1, 2, 5] {
        let mut window = window(lag);
        let mut last = None;
        for k in 0..100 {
            last = Some(advance(&mut window, k, last, k as f64));
            window.run(&mut ForwardBackward::new()).unwrap();
            let graph = window.graph().unwrap();
            let slices = (k + 1).min(lag + 1);
            assert_eq!((window.slice_count(), graph.variable_count()), (slices, slices));
            // A step and a measurement per slice; the filter keeps the newest slice's alone.
            assert!(
                graph.factor_count() <= if lag == 1 { 2 } else { 2 * slices },
                "{}",
                graph.factor_count()
            );
            assert_eq!(window.slice(0), [last.unwrap()]);
        }
        assert_eq!(window.slice(lag + 1), []);
    }
}

#[test]
fn a_factor_that_no_run_has_heard_cannot_leave() {
    for lag in [1, 2] {
        let mut window = window(lag);
        let mut last = None;
        for k in 0..4 {
            last = Some(advance(&mut window, k, last, 1.0));
            window.run(&mut ForwardBackward::new()).unwrap();
        }
        let oldest = window.slice(window.slice_count() - 1)[0];
        window.factor("second thought", Linear::prior(0.0, 1.0), &[(oldest, 0)]).unwrap();
        let error = window.begin(9.0).unwrap_err();
        assert!(error.to_string().contains("second thought"), "{error}");
        window.run(&mut ForwardBackward::new()).unwrap();
        window.begin(9.0).unwrap();
    }
}

#[test]
fn a_start_is_no_evidence_in_a_filter_either() {
    // Nothing constrains x0; it steps to x1, which is measured.
    let mut window = window(1);
    window.begin(0.0).unwrap();
    let first = window.variable("x0", Space::real(1)).unwrap();
    window.set_start(first, Bell::new(50.0, 1e-2)).unwrap();
    window.run(&mut ForwardBackward::new()).unwrap();
    window.begin(1.0).unwrap();
    let second = window.variable("x1", Space::real(1)).unwrap();
    window.factor("step", Linear::step(0.0, 1.0), &[(first, 0), (second, 0)]).unwrap();
    window.factor("measure", Linear::prior(3.0, 2.0), &[(second, 0)]).unwrap();
    window.run(&mut ForwardBackward::new()).unwrap();
    let belief = window.belief(second).unwrap();
    assert!((belief.mean() - 3.0).abs() < 1e-12 && (belief.variance() - 2.0).abs() < 1e-12, "{belief:?}");
}

#[test]
fn a_prior_set_after_a_run_counts() {
    for lag in [1, 3] {
        let mut window = window(lag);
        let first = advance(&mut window, 0, None, 1.0);
        window.run(&mut ForwardBackward::new()).unwrap();
        window.set_prior(first, Bell::new(9.0, 1.0)).unwrap();
        let second = advance(&mut window, 1, Some(first), 1.0);
        window.run(&mut ForwardBackward::new()).unwrap();
        // N(9, 1) times the measurement N(1, 2), stepped by N(0.1, 1), times the measurement N(1, 2).
        let precision: f64 = 1.0 + 0.5;
        let predicted = 1.0 / precision + 1.0;
        let mean = (9.0 + 0.5) / precision + 0.1;
        let posterior = 1.0 / (1.0 / predicted + 0.5);
        let expected = posterior * (mean / predicted + 0.5);
        let belief = window.belief(second).unwrap();
        assert!((belief.variance() - posterior).abs() < 1e-12, "lag {lag}: {belief:?}");
        assert!((belief.mean() - expected).abs() < 1e-12, "lag {lag}: {belief:?}");
    }
}
