use super::*;
use crate::metrics::Report;
use crate::results::Estimate;
use serde_json::{Value, json};

const METHODS: &str = r#"{"one-way": {"algorithm": "one-way"}, "two-way": {"algorithm": "two-way"},
    "jsl": {"algorithm": "jsl"}, "two-step": {"algorithm": "two-step"}, "direct": {"algorithm": "direct"},
    "window": {"algorithm": "window", "lag": 4}}"#;

/// A scenario with these keys of the world and methods beside the six.
fn scenario(world: Value, more: Value) -> Underwater {
    let mut methods: Value = serde_json::from_str(METHODS).unwrap();
    methods.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    serde_json::from_value(json!({"world": world, "method": methods})).unwrap()
}

fn runs(scenario: &Underwater, count: u32, ids: &[&str]) -> Vec<RunResult> {
    scenario.validate().unwrap();
    let methods: Vec<String> = ids.iter().map(|&id| id.to_owned()).collect();
    let run = |run| scenario.run(&(), RunRequest { seed: 1, run, methods: &methods }).unwrap();
    (0..count).map(run).collect()
}

fn last_ten(report: &Report, id: &str) -> f64 {
    report.method(id).unwrap().final_rmse_m.as_ref().unwrap().mean
}

/// NEES per degree of freedom of position, velocity, clock and state.
fn nees(report: &Report, id: &str) -> [f64; 4] {
    let blocks = report.method(id).unwrap().summary.nees.as_ref().unwrap();
    [&blocks.position, &blocks.velocity, &blocks.clock, &blocks.state].map(|block| {
        let block = block.as_ref().unwrap();
        block.mean / block.dof as f64
    })
}

/// The longest distance between the estimated positions of two methods or runs.
fn apart(a: &MethodRun, b: &MethodRun) -> f64 {
    let distance = |(a, b): (Estimate<'_>, Estimate<'_>)| {
        assert_eq!((a.step, a.node), (b.step, b.node));
        [0, 2, 4].iter().map(|&k| (a.mean[k] - b.mean[k]).powi(2)).sum::<f64>().sqrt()
    };
    assert_eq!(a.len(), b.len());
    a.estimates().zip(b.estimates()).map(distance).fold(0.0, f64::max)
}

/// 40 nodes; last-ten errors of nodes are independent and vary by half, so a mean is known to some 5 %: each limit is five
/// such deviations or more away.
#[test]
fn the_methods_keep_their_order() {
    let report = Report::new(
        "s",
        1,
        &runs(
            &scenario(json!({}), json!({})),
            4,
            &["one-way", "two-way", "jsl", "two-step", "direct", "window"],
        ),
    );
    let report = report.unwrap();
    let found = |id| last_ten(&report, id);
    assert!((1.4..2.1).contains(&found("one-way")), "{}", found("one-way"));
    assert!((0.85..1.35).contains(&found("two-way")), "{}", found("two-way"));
    assert!((5.5..8.0).contains(&found("jsl")), "{}", found("jsl"));
    assert!((8.0..25.0).contains(&found("two-step")), "{}", found("two-step"));
    assert!((45.0..65.0).contains(&found("direct")), "{}", found("direct"));
    assert!((found("window") / found("one-way") - 1.0).abs() < 0.02, "{}", found("window"));
    assert!(report.method("two-step").unwrap().last_third_over_first_third.unwrap() > 1.1);
    assert!(report.method("one-way").unwrap().last_third_over_first_third.unwrap() < 0.9);
}

/// 60 nodes, whose NEES per degree of freedom averaged over time varies by less than 0.4: a mean is known to 0.05.
#[test]
fn the_one_way_filter_is_calibrated_while_nodes_move_in_flight() {
    let scenario = scenario(
        json!({"motion_in_flight": true}),
        json!({"frozen": {"algorithm": "one-way", "frozen_flight": true}}),
    );
    let report = Report::new("s", 1, &runs(&scenario, 6, &["one-way", "frozen"])).unwrap();
    let blocks = nees(&report, "one-way");
    assert!(blocks.iter().all(|ratio| (0.75..1.25).contains(ratio)), "{blocks:?}");
    assert!(nees(&report, "frozen")[3] > 10.0);
    assert!(last_ten(&report, "frozen") > 4.0 * last_ten(&report, "one-way"));
}

#[test]
fn the_epoch_does_not_matter() {
    let at = |epoch: f64| {
        let world =
            json!({"epoch_s": epoch, "motion_in_flight": true, "nodes": 4, "slot_s": 0.2, "heard_nodes": 1});
        let more = json!({"together": {"algorithm": "window", "cooperative": true}});
        runs(&scenario(world, more), 1, &["one-way", "two-way", "two-step", "window", "together"]).remove(0)
    };
    let (zero, unix) = (at(0.0), at(1.7e9));
    for (a, b) in zero.methods.iter().zip(&unix.methods) {
        assert!(apart(a, b) < 1e-4, "{}: {}", a.id, apart(a, b));
    }
    // The clocks are 680,000 s ahead by then, and known to a millisecond.
    let last = unix.methods[0].estimates().last().unwrap();
    assert!((last.truth[6] - 680_000.0).abs() < 1.0 && (last.mean[6] - last.truth[6]).abs() < 1e-3);
}

/// What the receiver's clock reads is what it reads when sound meets the moving node.
#[test]
fn the_world_holds_what_was_heard() {
    let scenario =
        scenario(json!({"motion_in_flight": true, "range_variance": 1e-14, "nodes": 2}), json!({}));
    let draw = world::simulate(&scenario.world, 3, 0).unwrap();
    let place = |state: &[f64; 8], time: f64| [0, 2, 4].map(|k| state[k] + time * state[k + 1]);
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    for node in &draw.nodes {
        for frame in &node.frames {
            for emission in &frame.emissions {
                let anchor = draw.anchors[emission.anchor];
                let (mut early, mut late) = (0.0, 5.0);
                for _ in 0..80 {
                    let middle: f64 = 0.5 * (early + late);
                    if distance(place(&frame.truth, middle), anchor) > 1500.0 * middle {
                        early = middle;
                    } else {
                        late = middle;
                    }
                }
                let read = 1500.0 * early + frame.truth[6] + early * frame.truth[7];
                assert!((read - emission.pseudo_range).abs() < 1e-6);
                let back = distance(place(&frame.truth, early + 0.5), anchor);
                assert!((1500.0 * early + back - emission.round_trip).abs() < 1e-6);
            }
        }
        // f(t) = (1 + 400 ppm) t + 10 ms at the start.
        assert!((node.start[6] - 15.0).abs() < 1e-12 && (node.start[7] - 0.6).abs() < 1e-12);
    }
}

/// Without noise the corrected equations give the position itself; the printed ones are hundreds of metres off.
#[test]
fn the_linear_equations_locate_a_standing_node() {
    for anchors in ["cube", "random"] {
        let world = json!({"range_variance": 1e-16, "anchors": anchors, "nodes": 20});
        let scenario = scenario(world, json!({}));
        let draw = world::simulate(&scenario.world, 1, 0).unwrap();
        for (start, node) in scenario.starts(&draw).unwrap().iter().zip(&draw.nodes) {
            let linear = start.closed_form.unwrap();
            for (k, linear) in linear.into_iter().enumerate() {
                assert!((linear - node.start[2 * k]).abs() < 1e-2, "{anchors}: {linear}");
            }
            assert!((start.state.mean[7] - 0.6).abs() < 1e-6);
            assert!((start.state.mean[6] + start.reference - 15.0).abs() < 1e-3);
        }
    }
}

/// The positions' NEES of 200 starts has mean 3 and standard deviation √(6 / 200) = 0.17.
#[test]
fn starts_know_how_wrong_they_are() {
    let scenario = scenario(json!({"nodes": 200, "steps": 1}), json!({}));
    let draw = world::simulate(&scenario.world, 1, 0).unwrap();
    let mut sum = 0.0;
    for (start, node) in scenario.starts(&draw).unwrap().iter().zip(&draw.nodes) {
        let own = crate::robots::marginal(&start.state, 0, 8);
        let rows = [0, 2, 4];
        let covariance = nalgebra::Matrix3::from_fn(|r, c| own.covariance_at(rows[r], rows[c]));
        let error = nalgebra::Vector3::from_fn(|k, _| own.mean[rows[k]] - node.start[rows[k]]);
        sum += (error.transpose() * covariance.try_inverse().unwrap() * error)[0];
    }
    assert!((sum / 200.0 - 3.0).abs() < 0.9, "{}", sum / 200.0);
}

#[test]
fn a_clock_that_cannot_be_told_from_ranges_is_refused() {
    for count in 1..4 {
        let scenario = scenario(json!({"anchor_count": count}), json!({}));
        scenario.validate().unwrap();
        let methods = ["one-way".to_owned()];
        let error = scenario.run(&(), RunRequest { seed: 1, run: 0, methods: &methods }).unwrap_err();
        assert!(error.is_input());
        let sentence = error.to_string();
        assert!(sentence.contains("anchors cannot tell the clock of node 1 from its ranges"), "{sentence}");
        let summary = scenario.check(&(), 1, &methods).unwrap().remove(0);
        assert!(summary.unconstrained[0].contains("cannot tell the clock"));
    }
    assert_eq!(runs(&scenario(json!({"anchor_count": 4, "steps": 2}), json!({})), 1, &["one-way"]).len(), 1);
}

#[test]
fn staggered_emissions_need_a_prediction_each() {
    let more = json!({"together": {"algorithm": "one-way", "simultaneous": true}});
    let report =
        Report::new("s", 1, &runs(&scenario(json!({"slot_s": 0.2}), more), 3, &["one-way", "together"]));
    let report = report.unwrap();
    assert!(last_ten(&report, "one-way") < 2.2, "{}", last_ten(&report, "one-way"));
    assert!(last_ten(&report, "together") > 2.0 * last_ten(&report, "one-way"));
}

/// Nodes that hear each other know more, say so, and are right: 40 nodes, a mean known to some 5 %.
#[test]
fn hearing_other_nodes_helps() {
    let more = json!({"together": {"algorithm": "window", "lag": 1, "cooperative": true}});
    let world = json!({"heard_nodes": 2, "motion_in_flight": true, "steps": 25});
    let report = Report::new("s", 1, &runs(&scenario(world, more), 4, &["one-way", "together"])).unwrap();
    assert!(last_ten(&report, "together") < 0.9 * last_ten(&report, "one-way"));
    let state = nees(&report, "together")[3];
    assert!((0.75..1.25).contains(&state), "{state}");
}

#[test]
fn a_window_that_waits_knows_more() {
    let more = json!({"late": {"algorithm": "window", "lag": 6, "delay": 5}});
    let results = runs(&scenario(json!({"steps": 30}), more), 3, &["window", "late"]);
    assert!(results.iter().all(|run| run.methods[1].len() == 300));
    let report = Report::new("s", 1, &results).unwrap();
    let error = |id: &str| report.method(id).unwrap().summary.position_rmse_m.as_ref().unwrap().mean;
    assert!(error("late") < 0.9 * error("window"), "{} {}", error("late"), error("window"));
}

#[test]
fn keys_that_mean_nothing_are_refused() {
    for (world, more, sentence) in [
        (json!({"steps": 0}), json!({}), "`world.steps` is 0; it must be at least 1"),
        (json!({"steps": 4_000_000}), json!({}), "`world.steps` is 4000000: with 10 nodes"),
        (json!({"anchor_count": 6}), json!({}), "`world.anchor_count` is 6, but \"cube\" has 5 places"),
        (json!({"beacons": 1}), json!({}), "`world.beacons` is 1; without at least 2 beacons"),
        (json!({"heard_nodes": 10}), json!({}), "`world.heard_nodes` is 10"),
        (json!({"range_variance": -1.0}), json!({}), "`world.range_variance` is -1"),
        (json!({"slot_s": -1.0}), json!({}), "`world.slot_s` is -1"),
        (json!({"velocity": [1500.0, 0.0, 0.0]}), json!({}), "`world.velocity` is 1500 m/s fast"),
        (json!({"clock_skew_ppm": 1e6}), json!({}), "`world.clock_skew_ppm` is 1000000 ppm"),
        (json!({"epoch_s": 1e12}), json!({}), "`world.epoch_s` is 1000000000000 s"),
        (json!({}), json!({"m": {"algorithm": "jsl", "lag": 3}}), "`method.m.lag` is for algorithm"),
        (json!({}), json!({"m": {"algorithm": "window", "lag": 0}}), "`method.m.lag` is 0"),
        (json!({"clock_density": 1e-12}), json!({}), "set that to 2.5e-10 or more"),
        (json!({}), json!({"m": {"algorithm": "window", "delay": 6}}), "`method.m.delay` is 6"),
        (json!({}), json!({"m": {"algorithm": "window", "cooperative": true}}), "set `world.heard_nodes`"),
        (json!({}), json!({"m": {"algorithm": "window", "simultaneous": true}}), "`method.m.simultaneous`"),
        (json!({}), json!({"m": {"algorithm": "jsl", "frozen_flight": true}}), "`method.m.frozen_flight`"),
    ] {
        let error = scenario(world, more).validate().unwrap_err().to_string();
        assert!(error.contains(sentence), "{error}");
    }
}

#[test]
fn the_graph_is_described() {
    let scenario =
        scenario(json!({"heard_nodes": 2}), json!({"t": {"algorithm": "window", "cooperative": true}}));
    let summaries = scenario.check(&(), 1, &["one-way".to_owned(), "t".to_owned()]).unwrap();
    let shape = |k: usize| {
        let GraphSummary { variables, factors, edges, components, loops, .. } = summaries[k];
        [variables, factors, edges, components, loops]
    };
    assert_eq!((shape(0), shape(1)), ([20, 60, 70, 10, 0], [20, 80, 110, 1, 11]));
}
