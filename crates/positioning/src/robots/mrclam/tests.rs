use serde_json::{Value, json};
use sumprod_messages::Moments;
use sumprod_models::Motion;

use super::Mrclam;
use super::commands::Commands;
use super::model::{Layout, Start, TeamChain};
use super::motion::{CommandedMotion, Drift, driven_pose};
use super::recording::{Command, Landmark, Recording, Robot, SightingRow, Subject, TruthRow};
use super::sighting::Camera;
use crate::results::MethodRun;
use crate::robots::chain::Chain;
use crate::scenario::{RunRequest, Scenario};

const DELAY: f64 = 0.24;
/// Errors of turn and forward scale, and of the range scale, of the simulated robots.
const WRONG: [[f64; 3]; 2] = [[-0.08, 0.05, 0.02], [0.06, -0.04, -0.02]];
const START: Start = Start {
    position_variance: 0.0025,
    heading_variance: 0.0025,
    turn_scale_variance: 0.01,
    forward_scale_variance: 0.01,
    range_scale_variance: 9e-4,
};
const DRIFT: Drift = Drift {
    position_variance: 1e-5,
    heading_variance: 1e-5,
    turn_scale_variance: 1e-8,
    forward_scale_variance: 1e-8,
    range_scale_variance: 1e-8,
};
const CAMERA: Camera = Camera {
    range_variance: 4e-4,
    range_variance_growth: 0.0,
    bearing_variance: 1e-4,
    correlation_s: 0.0,
    degrees_of_freedom: None,
};

/// Two robots for 60 s, one of which sees a landmark and is seen by the other. Everything is without noise but late
/// by the delay and wrong in scale, and sightings come at odd times.
fn pair() -> Recording {
    let landmarks = vec![Landmark { id: 6, position: [1.0, 3.0] }];
    let starts = [[0.0, 0.0, 0.2], [2.0, -1.0, 2.0]];
    let mut robots = Vec::new();
    for (k, start) in starts.iter().enumerate() {
        let row = |i: u32| Command {
            time: 100.0 + 0.5 * f64::from(i),
            speed: 0.3 + 0.1 * f64::from(i % 3),
            turn_rate: 0.4 - 0.3 * f64::from((i + k as u32) % 4),
        };
        let commands: Vec<Command> = (0..=120).map(row).collect();
        let driver = Commands::new(&commands, DELAY);
        let mut state = [start[0], start[1], start[2], WRONG[k][0], WRONG[k][1], WRONG[k][2]];
        let mut truth = vec![TruthRow { time: 100.0, pose: *start }];
        for i in 1..=6000 {
            let time = 100.0 + 0.01 * f64::from(i);
            let pose = driven_pose(&state, driver.between(time - 0.01, time), true);
            state[..3].copy_from_slice(&pose);
            truth.push(TruthRow { time, pose });
        }
        robots.push(Robot { id: k as u32 + 1, commands, truth });
    }
    let mut sightings = Vec::new();
    for i in (37..6000).step_by(53) {
        let [one, two] = [robots[0].truth[i], robots[1].truth[i]];
        let mut see = |observer: usize, from: TruthRow, to: [f64; 2], subject| {
            let (east, north) = (to[0] - from.pose[0], to[1] - from.pose[1]);
            let range = (1.0 + WRONG[observer][2]) * east.hypot(north);
            let bearing = north.atan2(east) - from.pose[2];
            sightings.push(SightingRow { time: from.time, observer, subject, range, bearing });
        };
        see(0, one, landmarks[0].position, Subject::Landmark(0));
        see(1, two, [one.pose[0], one.pose[1]], Subject::Robot(0));
    }
    Recording { robots, landmarks, sightings, unknown: 2 }
}

fn scenario(change: impl Fn(&mut Value)) -> Mrclam {
    let mut value = json!({
        "world": {
            "known_landmarks": true, "range_only": false, "calibrate": true,
            "slice_s": 0.2, "odometry_delay_s": DELAY,
        },
        "start": START, "motion": DRIFT, "camera": CAMERA,
        "method": {
            "odometry": {"inference": "odometry"},
            "filter": {"inference": "filter", "rounds": 2},
            "alone": {"inference": "filter", "cooperation": false},
            "smoother": {"inference": "smoother", "sweeps": 3},
        },
    });
    change(&mut value);
    serde_json::from_value(value).unwrap()
}

fn run(scenario: &Mrclam) -> Vec<MethodRun> {
    scenario.validate().unwrap();
    let methods = scenario.methods();
    scenario.run(&pair(), RunRequest { seed: 1, run: 0, methods: &methods }).unwrap().methods
}

/// Root mean squared position error of one robot, or of all.
fn rmse(methods: &[MethodRun], id: &str, node: Option<u32>) -> f64 {
    let method = methods.iter().find(|method| method.id == id).unwrap();
    let own = || method.estimates().filter(|estimate| node.is_none_or(|node| estimate.node == node));
    let squares =
        own().map(|estimate| (0..2).map(|axis| estimate.error_at(axis, &method.layout).powi(2)).sum::<f64>());
    (squares.sum::<f64>() / own().count() as f64).sqrt()
}

#[test]
fn scales_are_learned_and_a_seen_robot_helps_the_one_that_sees() {
    let methods = run(&scenario(|_| ()));
    let error = |id| rmse(&methods, id, None);
    assert!(error("odometry") > 0.3, "{}", error("odometry"));
    assert!(error("filter") < 0.04 && error("smoother") < 0.02, "{} {}", error("filter"), error("smoother"));
    let alone = rmse(&methods, "alone", Some(1));
    assert!(
        (alone - rmse(&methods, "odometry", Some(1))).abs() < 1e-9,
        "nothing tells robot 2 alone: {alone}"
    );
    for method in &methods {
        assert_eq!(method.len(), 2 * 6001);
        assert_eq!(method.notes, ["2 sightings of unknown barcodes or of the robot's own were left out"]);
    }
}

#[test]
fn without_calibration_or_the_delay_the_filter_is_worse() {
    let right = rmse(&run(&scenario(|_| ())), "filter", None);
    for change in [(|value| value["world"]["calibrate"] = json!(false)) as fn(&mut Value), |value| {
        value["world"]["odometry_delay_s"] = json!(0.0)
    }] {
        assert!(rmse(&run(&scenario(change)), "filter", None) > 2.0 * right);
    }
}

#[test]
fn observers_and_range_only_choose_the_evidence() {
    let recording = pair();
    let layout = |observers: [bool; 2], range_only, cooperation| Layout {
        slice_s: 0.2,
        odometry_delay_s: DELAY,
        calibrated: true,
        range_only,
        landmark_observers: observers.to_vec(),
        cooperation,
    };
    let residuals = |layout: Layout| -> usize {
        let chain = TeamChain::new(&recording, &START, DRIFT, CAMERA, layout).unwrap();
        (1..chain.times().len()).map(|slice| chain.evidence(slice).unwrap().len()).sum()
    };
    let of_each = (37..6000).step_by(53).count();
    assert_eq!(residuals(layout([true, true], false, true)), 4 * of_each);
    assert_eq!(residuals(layout([true, true], true, true)), 2 * of_each);
    assert_eq!(residuals(layout([false, true], false, true)), 2 * of_each);
    assert_eq!(residuals(layout([true, false], false, false)), 2 * of_each);
    assert_eq!(residuals(layout([false, true], false, false)), 0);
}

#[test]
fn wrong_settings_are_refused_by_key() {
    let sentence = |change: fn(&mut Value)| scenario(change).validate().unwrap_err().to_string();
    assert!(
        sentence(|value| value["world"]["known_landmarks"] = json!(false))
            .starts_with("`world.known_landmarks` is false, but this system has no variables for landmarks")
    );
    assert_eq!(
        sentence(|value| value["world"]["slice_s"] = json!(0.0)),
        "`world.slice_s` is 0; it must be positive and finite"
    );
    assert_eq!(
        sentence(|value| value["camera"]["range_variance"] = json!(-1.0)),
        "`camera.range_variance` is -1; it must be positive and finite"
    );
    let stranger = scenario(|value| value["world"]["landmark_observers"] = json!([1, 7]));
    assert_eq!(
        stranger.check_observers(&pair()).unwrap_err().to_string(),
        "`world.landmark_observers` names robot 7; the recording has robots 1, 2"
    );
}

#[test]
fn slices_too_short_to_hold_are_refused() {
    let short = scenario(|value| value["world"]["slice_s"] = json!(1e-9));
    let methods = short.methods();
    let error = short.run(&pair(), RunRequest { seed: 1, run: 0, methods: &methods }).unwrap_err();
    assert!(
        error.to_string().starts_with("`world.slice_s` is 0.000000001, which makes 60000000000 slices"),
        "{error}"
    );
}

#[test]
fn a_robot_without_truth_at_the_start_is_named() {
    let mut recording = pair();
    recording.robots[1].truth.retain(|row| row.time > 101.0);
    let all = scenario(|_| ());
    let methods = all.methods();
    let error = all.run(&recording, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap_err();
    assert!(error.to_string().starts_with("nothing constrains the pose that robot 2 starts from"), "{error}");
    assert!(error.is_input());
}

#[test]
fn moments_go_forward_by_jacobian_and_noise() {
    let commands =
        [(0.0, 0.5, 0.3), (9.0, 0.0, 0.0)].map(|(time, speed, turn_rate)| Command { time, speed, turn_rate });
    let driven = Commands::new(&commands, 0.0).between(0.0, 2.0);
    let motion = CommandedMotion { driven, duration: 2.0, drift: DRIFT, calibrated: false };
    let state =
        Moments { mean: vec![1.0, 2.0, 0.4], covariance: vec![0.1, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.3] };
    let ahead = sumprod_models::Transition::new(motion).predict_moments(&state).unwrap();
    // With u = θ + φ/2: dx'/dθ = -s sin u and dy'/dθ = s cos u.
    let (east, north) = (-0.7_f64.sin(), 0.7_f64.cos());
    let blur = 2.0 * DRIFT.position_variance;
    let expected = [0.1 + 0.3 * east * east + blur, 0.3 * east * north, 0.3 * east];
    for (column, expected) in expected.iter().enumerate() {
        assert!((ahead.covariance_at(0, column) - expected).abs() < 1e-12);
    }
    let mut next = [0.0; 3];
    motion.step(&state.mean, &mut next);
    assert_eq!(ahead.mean, next);
}
