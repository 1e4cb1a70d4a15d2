//! Graphs that cannot be solved: the report names variables, directions and a remedy.

use sumprod_exact::observability::{FreeDirections, free_directions, mirror_images};
use sumprod_exact::{ExactError, Problem, SolveOptions};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{
    AnchorRange, CalibratedRange, PosePrior, Prior, Range, RelativePose, RelativePose3,
};
use sumprod_models::pose::{Pose2, Pose3};
use sumprod_models::{AddModel, Noise};

type Graph = FactorGraph<DynamicGaussian>;

fn noise(components: usize) -> Noise {
    Noise::isotropic(components, 0.01).unwrap()
}

/// The report of the failing solve, which is also what the check finds.
fn refused(graph: &Graph, start: &[&[f64]]) -> Vec<FreeDirections> {
    let problem = Problem::new(graph).unwrap();
    let mut values = problem.start();
    for (&variable, value) in problem.variables().iter().zip(start) {
        values.set(variable, value).unwrap();
    }
    let found = free_directions(&problem, &values).unwrap();
    match problem.solve(values, &SolveOptions::default()) {
        Err(ExactError::Unobservable(told)) => {
            let sizes = |free: &[FreeDirections]| free.iter().map(|part| part.dimension).collect::<Vec<_>>();
            assert_eq!(sizes(&told), sizes(&found));
        }
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("solved"),
    }
    found
}

fn chain(graph: &mut Graph, name: &str, length: usize) -> Vec<VariableId> {
    let poses: Vec<_> =
        (0..length).map(|k| graph.variable(format!("{name}{k}"), Space::Se2).unwrap()).collect();
    for pair in poses.windows(2) {
        let step = RelativePose::new([1.0, 0.1, 0.3], noise(3)).unwrap();
        graph.add("odometry", step, pair).unwrap();
    }
    poses
}

/// Poses along the chain's own odometry.
fn along(length: usize) -> Vec<Vec<f64>> {
    let step = Pose2 { x: 1.0, y: 0.1, heading: 0.3 };
    let mut pose = Pose2 { x: 2.0, y: -1.0, heading: 0.4 };
    let mut out = Vec::new();
    for _ in 0..length {
        out.push(vec![pose.x, pose.y, pose.heading]);
        pose = pose.compose(&step);
    }
    out
}

fn slices(values: &[Vec<f64>]) -> Vec<&[f64]> {
    values.iter().map(Vec::as_slice).collect()
}

#[test]
fn no_anchor() {
    let mut graph = Graph::new();
    chain(&mut graph, "x", 6);
    let found = refused(&graph, &slices(&along(6)));
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].dimension, found[0].variables.len(), found[0].apart), (3, 6, false));
    let said = found[0].to_string();
    for word in
        ["position along x", "position along y", "orientation", "x0 … x5 (6 variables)", "prior on one pose"]
    {
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn no_anchor_in_space() {
    let mut graph = Graph::new();
    let poses: Vec<_> = (0..4).map(|k| graph.variable(format!("x{k}"), Space::Se3).unwrap()).collect();
    for pair in poses.windows(2) {
        let z = [1.0, 0.0, 0.2, 0.1, 0.0, 0.0, 0.99];
        graph.add("odometry", RelativePose3::new(z, noise(6)).unwrap(), pair).unwrap();
    }
    let mut pose = Pose3 { position: [1.0, 2.0, 3.0], rotation: [0.0, 0.0, 0.0, 1.0] };
    let step = Pose3::read(&[1.0, 0.0, 0.2, 0.1, 0.0, 0.0, 0.99]).normalised();
    let mut start = Vec::new();
    for _ in 0..4 {
        let mut value = vec![0.0; 7];
        pose.write(&mut value);
        start.push(value);
        pose = pose.compose(&step).normalised();
    }
    let found = refused(&graph, &slices(&start));
    assert_eq!((found.len(), found[0].dimension, found[0].directions.len()), (1, 6, 6));
}

#[test]
fn a_disconnected_robot() {
    let mut graph = Graph::new();
    let first = chain(&mut graph, "a", 4);
    chain(&mut graph, "b", 3);
    graph.add("prior", PosePrior::new([2.0, -1.0, 0.4], noise(3)).unwrap(), &first[..1]).unwrap();
    let start = [along(4), along(3)].concat();
    let found = refused(&graph, &slices(&start));
    assert_eq!((found.len(), found[0].dimension, found[0].apart), (1, 3, true));
    assert_eq!(found[0].variables, ["b0", "b1", "b2"]);
    assert!(found[0].to_string().contains("which no factor joins to the others"));
}

#[test]
fn a_sensor_scale_that_nothing_fixes() {
    let mut graph = Graph::new();
    let x = graph.variable("x", Space::real(2)).unwrap();
    let sensor = graph.variable("radio", Space::real(2)).unwrap();
    // Three ranges for four unknowns: position, scale and offset.
    for anchor in [[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]] {
        let range = CalibratedRange::new(7.0, anchor, 2, [0, 1], noise(1)).unwrap();
        graph.add("range", range, &[x, sensor]).unwrap();
    }
    let found = refused(&graph, &[&[5.0, 4.0], &[0.0, 0.0]]);
    assert_eq!((found.len(), found[0].dimension), (1, 1));
    let said = found[0].to_string();
    assert!(said.contains("radio") && said.contains("coordinate 0"), "{said}");
    assert!(said.contains("add a prior on, or a factor that measures,"), "{said}");
}

#[test]
fn a_variable_that_no_factor_touches() {
    // A variable that no factor touches.
    let mut graph = Graph::new();
    let x = graph.variable("x", Space::real(2)).unwrap();
    graph.variable("forgotten", Space::real(1)).unwrap();
    graph.add("prior", Prior::new(&Space::real(2), &[0.0; 2], noise(2)).unwrap(), &[x]).unwrap();
    let found = refused(&graph, &[]);
    assert_eq!((found.len(), found[0].dimension), (1, 1));
    assert!(found[0].to_string().contains("the value (forgotten)"), "{}", found[0]);
}

#[test]
fn ranges_alone_leave_a_rigid_motion() {
    let mut graph = Graph::new();
    let points: Vec<_> = (0..4).map(|k| graph.variable(format!("p{k}"), Space::real(2)).unwrap()).collect();
    for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
        let range = Range::new(3.0, [2, 2], [[0, 1]; 2], noise(1)).unwrap();
        graph.add("range", range, &[points[i], points[j]]).unwrap();
    }
    let start: [&[f64]; 4] = [&[0.0, 0.0], &[3.0, 0.2], &[0.1, 3.0], &[3.2, 3.3]];
    let found = refused(&graph, &start);
    assert_eq!((found.len(), found[0].dimension), (1, 3));
    assert_eq!(found[0].directions.len(), 3, "{}", found[0]);
}

#[test]
fn a_mirror_ambiguity() {
    let build = |third: Option<[f64; 2]>| {
        let mut graph = Graph::new();
        let x = graph.variable("x", Space::real(2)).unwrap();
        for anchor in [[0.0, 0.0], [10.0, 0.0]].into_iter().chain(third) {
            let range = AnchorRange::new(7.0, anchor, 2, [0, 1], noise(1)).unwrap();
            graph.add("range", range, &[x]).unwrap();
        }
        (graph, x)
    };
    let (graph, x) = build(None);
    let problem = Problem::new(&graph).unwrap();
    let mut values = problem.start();
    values.set(x, &[5.0, 4.0]).unwrap();
    assert!(free_directions(&problem, &values).unwrap().is_empty());
    let images = mirror_images(&problem, &values).unwrap();
    assert_eq!(images.len(), 1);
    assert_eq!(images[0].variables, ["x"]);
    assert!((images[0].distance - 8.0).abs() < 1e-12);
    assert!(images[0].to_string().contains("off that line"), "{}", images[0]);
    let (graph, x) = build(Some([3.0, 8.0]));
    let problem = Problem::new(&graph).unwrap();
    let mut values = problem.start();
    values.set(x, &[5.0, 4.0]).unwrap();
    assert_eq!(mirror_images(&problem, &values).unwrap(), []);
}

/// A variable that is no position beside those that are changes nothing.
#[test]
fn a_mirror_ambiguity_beside_a_variable_of_three_numbers() {
    for calibration_first in [true, false] {
        let mut graph = Graph::new();
        let calibration = |graph: &mut Graph| graph.variable("calibration", Space::real(3)).unwrap();
        let early = calibration_first.then(|| calibration(&mut graph));
        let x = graph.variable("x", Space::real(2)).unwrap();
        let other = early.unwrap_or_else(|| calibration(&mut graph));
        for anchor in [[0.0, 0.0], [10.0, 0.0]] {
            let range = AnchorRange::new(7.0, anchor, 2, [0, 1], noise(1)).unwrap();
            graph.add("range", range, &[x]).unwrap();
        }
        graph
            .add("known", Prior::new(&Space::real(3), &[1.0, 2.0, 3.0], noise(3)).unwrap(), &[other])
            .unwrap();
        let tie = Range::new(5.0, [2, 3], [[0, 1]; 2], noise(1)).unwrap();
        graph.add("tie", tie, &[x, other]).unwrap();
        let problem = Problem::new(&graph).unwrap();
        let mut values = problem.start();
        values.set(x, &[5.0, 4.0]).unwrap();
        values.set(other, &[5.0, 0.0, 1.0]).unwrap();
        let images = mirror_images(&problem, &values).unwrap();
        assert_eq!(images.len(), 1, "{calibration_first}: {images:?}");
        assert_eq!(images[0].variables, ["x"]);
    }
}

/// Three known points on a surface leave a fourth two places, above it and below.
#[test]
fn a_mirror_ambiguity_in_space() {
    let build = |fourth: Option<[f64; 3]>| {
        let mut graph = Graph::new();
        let space = Space::real(3);
        let x = graph.variable("x", space.clone()).unwrap();
        for (k, place) in
            [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [2.0, 9.0, 0.0]].into_iter().chain(fourth).enumerate()
        {
            let anchor = graph.variable(format!("anchor {k}"), space.clone()).unwrap();
            graph.add("place", Prior::new(&space, &place, noise(3)).unwrap(), &[anchor]).unwrap();
            let range = Range::new(8.0, [3, 3], [[0, 1, 2]; 2], noise(1)).unwrap();
            graph.add("range", range, &[anchor, x]).unwrap();
        }
        (graph, x)
    };
    for (fourth, expected) in [(None, 1), (Some([3.0, 3.0, 6.0]), 0)] {
        let (graph, x) = build(fourth);
        let problem = Problem::new(&graph).unwrap();
        let mut values = problem.start();
        values.set(x, &[4.0, 3.0, -5.0]).unwrap();
        let places = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [2.0, 9.0, 0.0], [3.0, 3.0, 6.0]];
        for (name, place) in (0..).map(|k| format!("anchor {k}")).zip(places) {
            if let Some(anchor) = graph.find(&name) {
                values.set(anchor, &place).unwrap();
            }
        }
        let images = mirror_images(&problem, &values).unwrap();
        assert_eq!(images.len(), expected);
        for image in images {
            assert_eq!(image.variables, ["x"]);
            assert!((image.distance - 10.0).abs() < 1e-12);
            assert!(image.to_string().contains("off that plane"), "{image}");
        }
    }
}

#[test]
fn one_agent_that_flips_about_its_neighbours() {
    let mut graph = Graph::new();
    let points: Vec<_> = (0..3).map(|k| graph.variable(format!("p{k}"), Space::real(2)).unwrap()).collect();
    for (point, mean) in points.iter().zip([[0.0, 0.0], [10.0, 1.0]]) {
        graph.add("prior", Prior::new(&Space::real(2), &mean, noise(2)).unwrap(), &[*point]).unwrap();
    }
    for k in 0..2 {
        let range = Range::new(7.0, [2, 2], [[0, 1]; 2], noise(1)).unwrap();
        graph.add("range", range, &[points[k], points[2]]).unwrap();
    }
    let problem = Problem::new(&graph).unwrap();
    let mut values = problem.start();
    for (&point, place) in points.iter().zip([[0.0, 0.0], [10.0, 1.0], [5.0, 4.0]]) {
        values.set(point, &place).unwrap();
    }
    let images = mirror_images(&problem, &values).unwrap();
    assert_eq!(images.len(), 1);
    assert_eq!(images[0].variables, ["p2"]);
}

#[test]
fn a_long_chain_is_no_null_space() {
    let mut graph = Graph::new();
    let poses = chain(&mut graph, "x", 3000);
    let held = Noise::isotropic(3, 1e-8).unwrap();
    graph.add("prior", PosePrior::new([2.0, -1.0, 0.4], held).unwrap(), &poses[..1]).unwrap();
    let problem = Problem::new(&graph).unwrap();
    let mut values = problem.start();
    for (&pose, value) in poses.iter().zip(along(3000)) {
        values.set(pose, &value).unwrap();
    }
    assert!(free_directions(&problem, &values).unwrap().is_empty());
    assert!(problem.solve(values, &SolveOptions::default()).is_ok());
}
