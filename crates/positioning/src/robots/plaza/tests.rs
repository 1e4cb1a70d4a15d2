use serde_json::{Value, json};
use sumprod_models::{Motion, check_residual};

use super::Plaza;
use super::model::{BackedRange, BiasedOdometry, Drift, Leg, PlazaChain, Sensor, Start};
use super::recording::{Beacon, OdometryRow, RangeRow, Recording, TruthRow};
use crate::results::MethodRun;
use crate::robots::chain::Chain;
use crate::scenario::{RunRequest, Scenario};

const DRIFT: Drift = Drift {
    across_variance: 1e-3,
    along_variance: 1e-4,
    position_variance: 1e-4,
    heading_variance: 1e-6,
    gyro_bias_variance: 1e-10,
    range_scale_variance: 1e-10,
    range_offset_variance: 1e-8,
};
const START: Start = Start {
    position_variance: 0.01,
    heading_variance: 0.0025,
    pose_covariance: None,
    gyro_bias_variance: 1e-4,
    range_scale_variance: 0.01,
    range_offset_variance: 1.0,
};
const SENSOR: Sensor = Sensor { range_variance: 0.04, degrees_of_freedom: None };

/// What the simulated gyro and radio get wrong: bias (rad/s), scale, offset (m).
const WRONG: [f64; 3] = [-0.01, 0.07, 0.4];

/// A robot in wide circles for 100 s, its odometry and ranges without noise but wrong in bias, scale and offset. Truth
/// stands between the rows of odometry too.
fn circles() -> Recording {
    let beacons = [[30.0, 5.0], [-20.0, 30.0], [0.0, -35.0]];
    let beacons: Vec<Beacon> = (0..3).map(|k| Beacon { id: k, position: beacons[k as usize] }).collect();
    let mut recording = Recording { odometry: vec![], ranges: vec![], truth: vec![], beacons, unknown: 0 };
    let mut state = [1.0, 2.0, 0.5, WRONG[0], WRONG[1], WRONG[2]];
    recording.truth.push(TruthRow { time: 7.0, pose: [1.0, 2.0, 0.5] });
    for k in 1..=1000 {
        let time = 7.0 + 0.1 * f64::from(k);
        let leg = Leg { distance: 0.3, turn: 0.02 + WRONG[0] * 0.1, duration: 0.1 };
        let mut next = state;
        let drive = |leg: Leg, next: &mut [f64; 6]| BiasedOdometry::new(leg, DRIFT, true).step(&state, next);
        // The range comes 0.04 s before the row, the truth at the row's middle and end.
        let mut at_range = state;
        drive(leg.part(0.6), &mut at_range);
        let mut middle = state;
        drive(leg.part(0.5), &mut middle);
        drive(leg, &mut next);
        let beacon = (k % 3) as usize;
        let [east, north] = recording.beacons[beacon].position;
        let range = (1.0 + WRONG[1]) * (at_range[0] - east).hypot(at_range[1] - north) + WRONG[2];
        recording.ranges.push(RangeRow { time: time - 0.04, beacon, range });
        recording.odometry.push(OdometryRow { time, distance: leg.distance, turn: leg.turn });
        recording.truth.push(TruthRow { time: time - 0.05, pose: [middle[0], middle[1], middle[2]] });
        recording.truth.push(TruthRow { time, pose: [next[0], next[1], next[2]] });
        state = next;
    }
    recording
}

fn scenario(world: Value, method: Value) -> Plaza {
    let value = json!({
        "world": world, "start": START, "motion": DRIFT, "sensor": SENSOR, "method": method,
    });
    serde_json::from_value(value).unwrap()
}

fn all_methods() -> Value {
    json!({
        "odometry": {"inference": "odometry"},
        "filter": {"inference": "filter"},
        "smoother": {"inference": "smoother"},
        "lagged": {"inference": "smoother", "lag": 5},
    })
}

fn run(scenario: &Plaza) -> Vec<MethodRun> {
    scenario.validate().unwrap();
    let methods = scenario.methods();
    let request = RunRequest { seed: 1, run: 0, methods: &methods };
    scenario.run(&circles(), request).unwrap().methods
}

fn rmse(method: &MethodRun) -> f64 {
    let squares = method
        .estimates()
        .map(|estimate| (0..2).map(|axis| estimate.error_at(axis, &method.layout).powi(2)).sum::<f64>());
    (squares.sum::<f64>() / method.len() as f64).sqrt()
}

fn by_id<'a>(methods: &'a [MethodRun], id: &str) -> &'a MethodRun {
    methods.iter().find(|method| method.id == id).unwrap()
}

#[test]
fn bias_scale_and_offset_are_found_and_every_truth_is_scored() {
    let methods = run(&scenario(json!({"calibrate": true}), all_methods()));
    let error = |id| rmse(by_id(&methods, id));
    assert!(error("odometry") > 2.0, "the bias leads dead reckoning away: {}", error("odometry"));
    assert!(error("filter") < 0.2 && error("smoother") < 0.05, "{} {}", error("filter"), error("smoother"));
    assert!(error("lagged") < error("filter") && error("lagged") > error("smoother"));
    for method in &methods {
        assert_eq!(method.len(), 2001);
    }
    let filter = by_id(&methods, "filter");
    for (name, wrong, tolerance) in [
        ("final_gyro_bias_radps", WRONG[0], 1e-3),
        ("final_range_scale", WRONG[1], 0.01),
        ("final_range_offset_m", WRONG[2], 0.2),
    ] {
        let found = filter.diagnostics.iter().find(|number| number.name == name).unwrap().value;
        assert!((found - wrong).abs() < tolerance, "{name}: {found}");
    }
}

#[test]
fn without_calibration_the_three_stay_zero() {
    let methods = run(&scenario(json!({"calibrate": false}), all_methods()));
    assert!(rmse(by_id(&methods, "filter")) > 1.0);
    assert!(by_id(&methods, "filter").diagnostics.is_empty());
}

#[test]
fn no_truth_is_scored_inside_a_long_row() {
    let mut recording = circles();
    // The row from 56.9 s to 57.6 s spans a gap; truth inside it is at 56.95 s, 57.0 s and so on.
    recording.odometry.drain(499..505);
    recording.ranges.retain(|range| range.time < 56.9 || range.time > 57.6);
    let scenario = scenario(json!({"calibrate": true}), json!({"filter": {"inference": "filter"}}));
    let request = RunRequest { seed: 1, run: 0, methods: &scenario.methods() };
    let result = scenario.run(&recording, request).unwrap();
    let inside = |time: f64| time > 49.95 && time < 50.55;
    assert_eq!(result.methods[0].estimates().filter(|estimate| inside(estimate.time)).count(), 0);
    assert_eq!(result.methods[0].len(), 2001 - 13);
}

#[test]
fn ranges_go_to_the_slice_at_or_after_them() {
    let recording = circles();
    let chain = PlazaChain::new(&recording, &START, DRIFT, &SENSOR, true, true).unwrap();
    for slice in [1, 2, 1000] {
        assert_eq!(chain.evidence(slice).unwrap().len(), 1);
    }
    let mut early = recording.clone();
    early.ranges = vec![
        RangeRow { time: 6.5, beacon: 0, range: 1.0 },
        RangeRow { time: 7.1, beacon: 0, range: 1.0 },
        RangeRow { time: 7.1001, beacon: 0, range: 1.0 },
        RangeRow { time: 900.0, beacon: 0, range: 1.0 },
    ];
    let chain = PlazaChain::new(&early, &START, DRIFT, &SENSOR, true, true).unwrap();
    let counts: Vec<usize> = (1..4).map(|slice| chain.evidence(slice).unwrap().len()).collect();
    assert_eq!(counts, [1, 1, 0]);
    assert_eq!(chain.evidence(1000).unwrap().len(), 0);
}

#[test]
fn derivatives_of_range_and_motion_are_right() {
    let leg = Leg { distance: 0.7, turn: 0.3, duration: 0.4 };
    for calibrated in [true, false] {
        let range = BackedRange::new(12.0, [10.0, -3.0], leg.part(0.3), calibrated, SENSOR.noise().unwrap());
        let state = [1.0, 2.0, 0.4, 0.05, 0.07, -0.3];
        let state = if calibrated { &state[..] } else { &state[..3] };
        check_residual(&range, &[state], 1e-6).unwrap();
        let motion = BiasedOdometry::new(leg, DRIFT, calibrated);
        let noise = motion.noise(state);
        let across = DRIFT.across_variance * 0.7 + DRIFT.position_variance * 0.4;
        let along = DRIFT.along_variance * 0.7 + DRIFT.position_variance * 0.4;
        let covariance = noise.covariance();
        let d = motion.dimension();
        assert!((covariance[0] + covariance[d + 1] - across - along).abs() < 1e-12);
    }
}

#[test]
fn wrong_values_are_refused_by_key() {
    let refused = |world: Value, change: fn(&mut Value)| {
        let plaza = scenario(world, all_methods());
        let mut value = serde_json::to_value(plaza).unwrap();
        change(&mut value);
        let plaza: Plaza = serde_json::from_value(value).unwrap();
        plaza.validate().unwrap_err().to_string()
    };
    let world = || json!({"calibrate": true});
    assert_eq!(
        refused(world(), |value| value["sensor"]["range_variance"] = json!(-1.0)),
        "`sensor.range_variance` is -1; it must be positive and finite"
    );
    assert_eq!(
        refused(world(), |value| value["motion"]["heading_variance"] = json!(-0.5)),
        "`motion.heading_variance` is -0.5; it must be finite and not negative"
    );
    assert_eq!(
        refused(world(), |value| value["method"]["filter"]["lag"] = json!(2)),
        "`method.filter.lag` belongs to a smoother; leave it out"
    );
}
