use super::*;
use crate::seafloor::frame::Frame;
use recording::Ping;

fn scenario(station: &str) -> Seafloor {
    let text = format!(
        r#"{{"world": {{"station": "{station}", "turn_around_s": 0.013, "time_variance": 2.56e-6, "drop_variance": 1e6,
            "depth_variance": 4e4, "sound_speed": 1500, "sound_speed_variance": 400}},
            "method": {{"joint": {{"kernel": {{"cauchy": 2.0}}}}}}}}"#
    );
    serde_json::from_str(&text).unwrap()
}

/// Pings around an instrument at a known place, one in ten of them a second late.
fn around(place: [f64; 3], speed: f64) -> Recording {
    let drop_point = [-5.0, -132.0];
    let frame = Frame::new(drop_point);
    let pings = (0..60).map(|k| {
        let (angle, radius) = (0.7 * f64::from(k), 1e-3 * f64::from(k % 20));
        let ship = [drop_point[0] + radius * angle.sin(), drop_point[1] + radius * angle.cos()];
        let local = frame.local(ship);
        let distance = (0..3).map(|k| (local[k] - place[k]).powi(2)).sum::<f64>().sqrt();
        let late = if k % 10 == 3 { 1.0 } else { 0.0 };
        let travel_time = 2.0 * distance / speed + 0.013 + late;
        Ping { line: 10 + k as usize, travel_time, place: ship, time: 60.0 * f64::from(k) }
    });
    let (path, pings) = ("AA01.txt".into(), pings.collect());
    Recording { path, drop_point, depth: 4800.0, pings, skipped: 2, published: None }
}

fn run(scenario: &Seafloor, recording: &Recording) -> RunResult {
    let methods = [String::from("joint")];
    scenario.run(recording, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap()
}

fn told(result: &RunResult, name: &str) -> f64 {
    result.methods[0].diagnostics.iter().find(|diagnostic| diagnostic.name == name).unwrap().value
}

#[test]
fn the_place_and_the_speed_come_back_through_outliers() {
    let (place, speed) = ([140.0, -60.0, -4730.0], 1507.0);
    let result = run(&scenario("AA01"), &around(place, speed));
    for (name, expected) in [
        ("position.x_m", place[0]),
        ("position.y_m", place[1]),
        ("position.z_m", place[2]),
        ("sound_speed_mps", speed),
    ] {
        assert!((told(&result, name) - expected).abs() < 0.3, "{name}: {}", told(&result, name));
    }
    assert_eq!((told(&result, "pings.outliers"), told(&result, "pings.unanswered")), (6.0, 2.0));
    assert!(told(&result, "residual_rms_ms") < 0.1);
    assert!(result.methods[0].notes.is_empty());
    let estimates = &result.files[0];
    assert!(
        estimates.name == "estimates.csv" && estimates.contents.starts_with("station,x,y,z,sound_speed,")
    );
    assert_eq!(estimates.contents.lines().count(), 2);
    assert_eq!(result.files[1].contents.lines().count(), 61);
}

#[test]
fn a_speed_that_is_held_stays_and_moves_the_depth() {
    let mut scenario = scenario("AA01");
    scenario.world.fixed_sound_speed = Some(1500.0);
    let result = run(&scenario, &around([140.0, -60.0, -4730.0], 1507.0));
    assert!((told(&result, "sound_speed_mps") - 1500.0).abs() < 1e-2);
    assert!((told(&result, "position.z_m") + 4730.0).abs() > 10.0);
}

#[test]
fn times_that_are_not_two_way_are_noted() {
    let mut recording = around([140.0, -60.0, -4730.0], 1507.0);
    recording.pings.iter_mut().for_each(|ping| ping.travel_time *= 0.5);
    let result = run(&scenario("AA01"), &recording);
    assert!(result.methods[0].notes[0].contains("these may be no two-way times"));
}

#[test]
fn keys_that_mean_nothing_are_refused() {
    let sentence = |change: fn(&mut Seafloor)| {
        let mut scenario = scenario("CC03");
        change(&mut scenario);
        scenario.validate().unwrap_err().to_string()
    };
    assert!(sentence(|s| s.world.station = "../CC03".into()).starts_with("`world.station` is \"../CC03\""));
    assert!(sentence(|s| s.world.time_variance = 0.0).starts_with("`world.time_variance` is 0"));
    assert!(
        sentence(|s| s.world.fixed_sound_speed = Some(-1.0)).starts_with("`world.fixed_sound_speed` is -1")
    );
    assert!(sentence(|s| s.world.turn_around_s = f64::NAN).starts_with("`world.turn_around_s` is NaN"));
    let mut scenario = scenario("CC03");
    scenario.method = Methods::new(vec![("joint".into(), MethodSettings { kernel: Kernel::Cauchy(-2.0) })]);
    assert!(scenario.validate().unwrap_err().to_string().starts_with("`method.joint.kernel` is -2"));
}

#[test]
fn the_graph_is_described() {
    let scenario = scenario("AA01");
    let recording = around([0.0, 0.0, -4700.0], 1500.0);
    let summary = scenario.check(&recording, 1, &["joint".to_owned()]).unwrap();
    assert_eq!((summary[0].variables, summary[0].factors, summary[0].edges), (2, 62, 122));
}

/// The recorded pings, where they are at hand.
fn recorded(station: &str) -> Option<Recording> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let root = std::env::var_os("SUMPROD_DATA").map_or(beside, Into::into);
    let folder = root.join("obs_ranging");
    if !folder.is_dir() {
        println!("skipped: the recording is not at {}", folder.display());
        return None;
    }
    Some(Recording::read(&folder, station).unwrap())
}

#[test]
fn recorded_instruments_are_where_their_authors_found_them() {
    for (station, pings, unanswered, outliers) in [("CC03", 88, 33, 3.0), ("EC03", 49, 40, 2.0)] {
        let Some(recording) = recorded(station) else { return };
        assert_eq!((recording.pings.len(), recording.skipped), (pings, unanswered), "{station}");
        let result = run(&scenario(station), &recording);
        assert!(told(&result, "to_published.horizontal_m") < 1.5, "{station}");
        assert!(told(&result, "to_published.depth_m").abs() < 3.0, "{station}");
        assert!(told(&result, "to_published.sound_speed_mps").abs() < 1.0, "{station}");
        assert_eq!(told(&result, "pings.outliers"), outliers, "{station}");
        assert!((1.0..2.0).contains(&told(&result, "residual_rms_ms")), "{station}");
        assert!(result.methods[0].notes.is_empty());
    }
    // One-way times of shots along a line: nothing here is a two-way time.
    let Some(recording) = recorded("1AS16") else { return };
    let result = run(&scenario("1AS16"), &recording);
    assert!(result.methods[0].notes[0].contains("these may be no two-way times"));
}
