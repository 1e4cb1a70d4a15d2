//! A small made-up recording, whole and damaged. The real one is tracked by the program's own tests.

use super::*;
use crate::metrics::Report;
use crate::robots::scratch::Scratch;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write;
use sumprod_graph::{Purpose, Stream};

const NODES: [[f64; 2]; 6] = [[0.0, 0.0], [6.0, 0.5], [5.5, 6.0], [0.5, 5.0], [3.0, -0.5], [2.5, 6.5]];
const EMPTY: usize = 40;

/// Six nodes, one channel; from 20 s on a walker adds variance to links near them, on legs of 10 s.
fn recording() -> Scratch {
    let folder = Scratch::new();
    let place = |[x, y]: &[f64; 2]| format!("{x} {y}\n");
    folder.write("sensor_coords_m.txt", &NODES.iter().map(place).collect::<String>());
    folder.write("pivot_coords_m.txt", "1 1\n5 1\n5 5\n1 5\n");
    folder.write("path_1.txt", "0\n1\n2\n3\n0\n2\n");
    let pivots = [[1.0, 1.0], [5.0, 1.0], [5.0, 5.0], [1.0, 5.0], [1.0, 1.0], [5.0, 5.0]];
    let mut random = Stream::new(4, 0, Purpose::World, 0).fast();
    let mut text = String::new();
    for sweep in 0..140 {
        let time = 0.5 * sweep as f64;
        let legs = ((time - 20.0) / 10.0).max(0.0);
        let (from, to) = (pivots[legs as usize], pivots[(legs as usize + 1).min(5)]);
        let at = [0, 1].map(|k| from[k] + legs.fract() * (to[k] - from[k]));
        for (a, first) in NODES.iter().enumerate() {
            for (b, second) in NODES.iter().enumerate().filter(|(b, _)| *b != a) {
                let far = |p: [f64; 2], q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
                let excess = far(at, first) + far(at, second) - far(*first, second);
                let walker = if sweep < EMPTY { 0.0 } else { 9.0 * (-excess).exp() };
                let normal: f64 = StandardNormal.sample(&mut random);
                let strength = -50.0 - (3 * a + 5 * b) as f64 % 7.0 + (0.4 + walker).sqrt() * normal;
                write!(text, "{} ", if (sweep + a * b) % 29 == 0 { 127.0 } else { strength.round() })
                    .unwrap();
            }
        }
        writeln!(text, "{}", (1000.0 * time) as u64 + 600).unwrap();
    }
    folder.write("made_up_listen_1.txt", &text);
    folder
}

fn scenario(methods: &str) -> Walk {
    let text = format!(
        r#"{{"world": {{"empty_until": 20.6, "leg": 10.0}}, "model": {{"cell": 0.4, "rounds": 4}}, "method": {methods}}}"#
    );
    serde_json::from_str(&text).unwrap()
}

/// The walker moves by 0.2 m a sweep through six nodes. Every method has the same posterior up to the noise of its
/// particles, which moves an error of half a metre by centimetres.
#[test]
fn a_walker_is_found_by_the_variance_of_the_links_and_all_methods_agree() {
    let folder = recording();
    let walk = scenario(
        r#"{"grid": {"algorithm": "grid"}, "pf": {"algorithm": "bootstrap", "particles": 500},
            "qgpf-mh": {"algorithm": "quantum-metropolis", "particles": 500},
            "kcpf": {"algorithm": "knowledge-board", "particles": 500}}"#,
    );
    walk.validate().unwrap();
    let prepared = walk.prepare(1, Some(&folder.path(""))).unwrap();
    let share = prepared.calibration.independent_share();
    assert!(share > 0.0 && share <= 1.0, "{share}");
    let profile = &prepared.calibration.profiles()[0];
    assert!(profile.variance[0] > 4.0 * profile.variance[links::KNOTS.len() - 1], "{profile:?}");
    let methods = walk.methods();
    let run = walk.run(&prepared, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap();
    let report = Report::new("walk", 1, &[run]).unwrap();
    let error = |id| report.method(id).unwrap().summary.position_rmse_m.as_ref().unwrap().mean;
    let grid = error("grid");
    assert!(grid < 1.5, "{grid} m; anywhere in the room is 2.5 m off");
    for id in ["pf", "qgpf-mh", "kcpf"] {
        assert!((error(id) - grid).abs() < 0.15, "{id}: {} m, on the grid {grid} m", error(id));
    }
    assert_eq!(walk.check(&prepared, 1, &methods).unwrap()[0].factors, 16);
}

#[test]
fn the_tracker_does_not_read_the_path() {
    let estimates = |path: &str| {
        let folder = recording();
        folder.write("path_1.txt", path);
        let walk = scenario(r#"{"pf": {"algorithm": "bootstrap", "particles": 50}}"#);
        let prepared = walk.prepare(1, Some(&folder.path(""))).unwrap();
        let run = walk.run(&prepared, RunRequest { seed: 1, run: 0, methods: &walk.methods() }).unwrap();
        let means: Vec<f64> =
            run.methods[0].estimates().flat_map(|estimate| estimate.mean.to_vec()).collect();
        means
    };
    assert_eq!(estimates("0\n1\n2\n3\n0\n2\n"), estimates("3\n3\n1\n0\n2\n1\n"));
}

#[test]
fn damaged_recordings_are_refused_with_file_line_and_field() {
    let sentence = |damage: &dyn Fn(&Scratch)| {
        let folder = recording();
        damage(&folder);
        let walk = scenario(r#"{"grid": {"algorithm": "grid"}}"#);
        let error = walk.prepare(1, Some(&folder.path(""))).err().unwrap();
        assert!(error.is_input());
        error.to_string().replace(&folder.path("").display().to_string(), "")
    };
    let sweeps = "made_up_listen_1.txt";
    let edited = |line: usize, with: &dyn Fn(&str) -> String| {
        sentence(&|folder: &Scratch| {
            let text = std::fs::read_to_string(folder.path(sweeps)).unwrap();
            let lines = text.lines().enumerate();
            let lines = lines.map(|(k, text)| if k + 1 == line { with(text) } else { text.into() });
            folder.write(sweeps, &lines.map(|text| text + "\n").collect::<String>());
        })
    };
    let cut = edited(7, &|text| text[..40].to_owned());
    assert!(
        cut.contains("made_up_listen_1.txt:7: the line is cut short: ") && cut.contains(" of 31 fields"),
        "{cut}"
    );
    let words = edited(9, &|text| text.replacen('-', "x", 1));
    assert!(
        words.contains("made_up_listen_1.txt:9: field ") && words.contains("which is no finite number"),
        "{words}"
    );
    let back = edited(5, &|text| format!("{} 3", text.rsplit_once(' ').unwrap().0));
    assert!(back.contains("listen_1.txt:5: the time is 0.003 s, no later than"), "{back}");
    let first = edited(1, &|_| "-50 -60 631".into());
    assert!(first.contains("listen_1.txt:1: the line has 3 fields; expected 30 strengths"), "{first}");
    let remove =
        |name: &'static str| move |folder: &Scratch| std::fs::remove_file(folder.path(name)).unwrap();
    assert!(sentence(&remove(sweeps)).ends_with("holds no file *listen*.txt of sweeps"));
    assert!(sentence(&remove("path_1.txt")).ends_with("holds no file path*.txt"));
    assert!(sentence(&remove("sensor_coords_m.txt")).ends_with("holds no file sensor_coords*.txt"));
    let pivot = sentence(&|folder: &Scratch| folder.write("path_1.txt", "0\n9\n"));
    assert!(pivot.contains("path_1.txt:2: pivot 9 does not exist; there are 4, from 0"), "{pivot}");
    let twice = sentence(&|folder: &Scratch| folder.write("listen_2.txt", ""));
    assert!(twice.ends_with("holds several files *listen*.txt; a recording has one"), "{twice}");
}

#[test]
fn settings_that_mean_nothing_are_refused_with_their_key() {
    let sentence = |walk: Walk| walk.validate().unwrap_err().to_string();
    let zero = scenario(r#"{"pf": {"algorithm": "bootstrap", "particles": 0}}"#);
    assert_eq!(sentence(zero), "`method.pf.particles` is 0; at least 1 particle is needed");
    let grid = scenario(r#"{"grid": {"algorithm": "grid", "particles": 9}}"#);
    assert!(sentence(grid).starts_with("`method.grid.particles` is 9, but a grid has none"));
    let literal = scenario(r#"{"k": {"algorithm": "knowledge-board", "board": {"form": "literal"}}}"#);
    assert!(sentence(literal).starts_with("`method.k.board.form` is \"literal\""));
    let mut early = scenario(r#"{"grid": {"algorithm": "grid"}}"#);
    early.world.empty_until = 2.0;
    let folder = recording();
    let error = early.prepare(1, Some(&folder.path(""))).err().unwrap();
    assert!(error.is_input());
    assert!(
        error.to_string().starts_with("`world.empty_until` is 2 s, before which there are 3 of"),
        "{error}"
    );
    early.world.empty_until = f64::NAN;
    assert!(sentence(early).starts_with("`world.empty_until` is NaN s"));
}
