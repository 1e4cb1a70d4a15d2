//! Ranges and silence on a lattice against the enumerated posterior.

use sumprod_graph::schedule::Coloured;
use sumprod_graph::{Engine, Factor, FactorGraph, Incoming, Options, Purpose, Space, Stream, VariableId};
use sumprod_messages::{Gaussian, LatticeForm, LatticeMessage};
use sumprod_models::{LatticeRange, Noise, Silence};

const WIDTH: f64 = 0.5;
const FORM: LatticeForm = LatticeForm::Lattice { width: WIDTH, most: 4000 };
const VARIANCE: f64 = 0.25;

fn noise() -> Noise {
    Noise::isotropic(1, VARIANCE).unwrap()
}

/// Adds a factor with all its edges on the lattice.
fn add(
    graph: &mut FactorGraph<LatticeMessage>,
    factor: impl Factor<LatticeMessage> + 'static,
    variables: &[VariableId],
) {
    let factor = graph.factor("factor", Box::new(factor), variables).unwrap();
    for port in 0..variables.len() {
        graph.set_edge_form(factor, port, FORM).unwrap();
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn likelihood(a: [f64; 2], b: [f64; 2], measured: f64) -> f64 {
    (-0.5 * (distance(a, b) - measured).powi(2) / VARIANCE).exp()
}

/// Two anchors leave agent 0 with two mirror images; its range to agent 1, and agent 1's to an anchor, favour one.
struct Pair {
    anchors: [[f64; 2]; 3],
    measured: [f64; 4],
}

const PAIR: Pair = Pair { anchors: [[0.0, 0.0], [12.0, 0.0], [18.0, 1.5]], measured: [9.2, 10.8, 7.3, 8.0] };

/// Agent 0's share of weight north of the anchors' line, and the means of both agents, by enumeration over points.
fn enumerated(silent: Option<([f64; 2], f64)>) -> (f64, [[f64; 2]; 2]) {
    let Pair { anchors, measured } = PAIR;
    let step = 0.4;
    let points: Vec<[f64; 2]> =
        (-60..90).flat_map(|i| (-60..60).map(move |j| [f64::from(i) * step, f64::from(j) * step])).collect();
    let own: Vec<([f64; 2], f64)> = points
        .iter()
        .map(|&p| {
            let heard = likelihood(p, anchors[0], measured[0]) * likelihood(p, anchors[1], measured[1]);
            let silence = silent.map_or(1.0, |(at, reach)| if distance(p, at) <= reach { 1e-3 } else { 1.0 });
            (p, heard * silence)
        })
        .filter(|(_, weight)| *weight > 1e-9)
        .collect();
    let other: Vec<([f64; 2], f64)> = points
        .iter()
        .map(|&p| (p, likelihood(p, anchors[2], measured[2])))
        .filter(|(_, weight)| *weight > 1e-9)
        .collect();
    let (mut total, mut north, mut sums) = (0.0, 0.0, [[0.0; 2]; 2]);
    for &(a, weight_a) in &own {
        for &(b, weight_b) in &other {
            let weight = weight_a * weight_b * likelihood(a, b, measured[3]);
            total += weight;
            north += if a[1] > 0.0 { weight } else { 0.0 };
            for (sum, at) in sums.iter_mut().zip([a, b]) {
                sum[0] += weight * at[0];
                sum[1] += weight * at[1];
            }
        }
    }
    (north / total, sums.map(|sum| sum.map(|x| x / total)))
}

fn on_lattice(silent: Option<([f64; 2], f64)>) -> (f64, [[f64; 2]; 2]) {
    let Pair { anchors, measured } = PAIR;
    let mut graph = FactorGraph::new();
    let agents = [0, 1].map(|_| graph.unnamed_variable(Space::real(2)));
    for (factor, agent) in [(0, 0), (1, 0), (2, 1)] {
        let range = LatticeRange::to_anchor(measured[factor], anchors[factor], noise()).unwrap();
        add(&mut graph, range, &agents[agent..=agent]);
    }
    add(&mut graph, LatticeRange::between(measured[3], noise()).unwrap(), &agents);
    if let Some((at, reach)) = silent {
        add(&mut graph, Silence::to_anchor(reach, 1e-3, at).unwrap(), &agents[..1]);
    }
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    // A tree: after as many rounds as it is deep nothing changes.
    engine.run(&mut Coloured::new().rounds(4)).unwrap();
    let belief = engine.belief(agents[0]).lattice().unwrap();
    let mut weights = Vec::new();
    belief.weights_into(&mut weights);
    let north =
        belief.cells().iter().zip(&weights).filter(|(cell, _)| cell[1] >= 0).map(|(_, weight)| weight).sum();
    let means = agents.map(|agent| engine.belief(agent).moments().unwrap().0);
    (north, means.map(|mean| [mean[0], mean[1]]))
}

#[test]
fn two_agents_have_the_enumerated_posterior() {
    for silent in [None, Some(([6.0, -16.0], 10.5))] {
        let (expected, found) = (enumerated(silent), on_lattice(silent));
        let shift = (expected.0 - found.0).abs();
        assert!(shift < 0.05, "north {} {}", expected.0, found.0);
        for (expected, found) in expected.1.into_iter().zip(found.1) {
            // A share of weight that moves from one image to the other takes the mean along.
            assert!(distance(expected, found) < 0.3 + 16.0 * shift, "{expected:?} {found:?}");
        }
        match silent {
            None => assert!(expected.0 > 0.05 && expected.0 < 0.95, "both images matter: {}", expected.0),
            Some(_) => assert!(found.0 > 0.98, "the silent anchor decides: {}", found.0),
        }
    }
}

/// A message to a receiver whose belief is on the cells of `belief`.
fn message(
    factor: &dyn Factor<LatticeMessage>,
    sender: Option<LatticeMessage>,
    belief: LatticeMessage,
) -> LatticeMessage {
    let ports: Vec<LatticeMessage> = std::iter::once(belief).chain(sender).collect();
    let variables: Vec<u32> = (0..ports.len() as u32).collect();
    let mut stream = Stream::new(1, 0, Purpose::Message, 0);
    factor.message(0, &Incoming::new(&ports, &ports, &variables), &FORM, &mut stream).unwrap()
}

fn line() -> LatticeMessage {
    let cells: Vec<[i32; 2]> = (0..80).map(|i| [i, 0]).collect();
    let count = cells.len();
    sumprod_messages::Lattice::new(WIDTH, cells.into(), vec![0.0; count], 0.0).unwrap().into()
}

#[test]
fn silence_follows_its_law() {
    let missed = 0.2;
    let anchor = message(&Silence::to_anchor(20.0, missed, [0.0, 0.0]).unwrap(), None, line());
    let place = Gaussian::from_moments(Default::default(), nalgebra::Matrix2::identity() * 1e-6).unwrap();
    let agent = message(&Silence::between(20.0, missed).unwrap(), Some(place.into()), line());
    for found in [anchor, agent] {
        let lattice = found.lattice().unwrap();
        assert!(
            lattice.log_values().windows(2).all(|pair| pair[0] <= pair[1] + 1e-12),
            "more likely farther away"
        );
        for (&cell, &value) in lattice.cells().iter().zip(lattice.log_values()) {
            let at = distance(lattice.centre(cell), [0.0, 0.0]);
            // Cells of 0.5 m blur the step by 0.14 m along one axis.
            if at < 19.0 {
                assert!((value - missed.ln()).abs() < 1e-9, "{at}: {value}");
            } else if at > 21.0 {
                assert!(value.abs() < 1e-9, "{at}: {value}");
            }
        }
    }
    // Nobody is known to be near, or nothing is known: no news.
    let far = message(&Silence::to_anchor(20.0, missed, [500.0, 0.0]).unwrap(), None, line());
    let unknown = message(&Silence::between(20.0, missed).unwrap(), Some(LatticeMessage::default()), line());
    assert!(far.lattice().is_none() && unknown.lattice().is_none());
    assert!(Silence::between(0.0, 0.1).is_err() && Silence::between(20.0, 0.0).is_err());
    assert!(Silence::to_anchor(20.0, 0.1, [f64::NAN, 0.0]).is_err());
}

#[test]
fn a_ring_is_the_likelihood_of_the_range_and_too_fine_cells_are_refused() {
    let range = LatticeRange::to_anchor(9.0, [3.0, 0.25], noise()).unwrap();
    let ring = message(&range, None, LatticeMessage::default());
    let lattice = ring.lattice().unwrap();
    let peak = lattice
        .cells()
        .iter()
        .map(|&cell| likelihood(lattice.centre(cell), [3.0, 0.25], 9.0))
        .fold(0.0, f64::max);
    for (&cell, &value) in lattice.cells().iter().zip(lattice.log_values()) {
        let exact = likelihood(lattice.centre(cell), [3.0, 0.25], 9.0) / peak;
        // The cell's own spread, 0.02 m² beside 0.25, is part of the message.
        assert!((value.exp() - exact).abs() < 0.04, "{} {exact}", value.exp());
    }
    let on_line = message(&range, None, line());
    assert_eq!(on_line.lattice().unwrap().cells(), line().lattice().unwrap().cells());

    let far = LatticeRange::to_anchor(1e6, [0.0; 2], noise()).unwrap();
    let ports = [LatticeMessage::default()];
    let mut stream = Stream::new(1, 0, Purpose::Message, 0);
    let error = far.message(0, &Incoming::new(&ports, &ports, &[0]), &FORM, &mut stream).unwrap_err();
    assert!(error.to_string().starts_with("cells of 0.5 m are too narrow"), "{error}");
    let between = LatticeRange::between(9.0, noise()).unwrap();
    assert!(
        message(&between, Some(LatticeMessage::default()), line()).lattice().is_none(),
        "nothing heard, nothing said"
    );
    assert!(LatticeRange::between(f64::NAN, noise()).is_err());
}
