//! Wrong input is told with a remedy, and leaves the belief as it was.

use nalgebra::{Matrix2, Vector2};
use sumprod_fusion::{
    Direction, Fusible, FusionError, FusionNode, InformationGraph, InformationSet, Item, Known, Rule,
};
use sumprod_graph::{MessageError, Space};
use sumprod_messages::{AnyMessage, Categorical, Gaussian, Particles};

use crate::support::World;

fn still(belief: &Gaussian<2>, _: f64) -> Result<Gaussian<2>, MessageError> {
    Ok(*belief)
}

fn pair(rule: Rule) -> [FusionNode<Gaussian<2>>; 2] {
    let mut nodes = ["a", "b"].map(|name| FusionNode::new(name, Space::real(2), Gaussian::known(), rule));
    nodes[0].connect(1, Direction::Both, Gaussian::known());
    nodes[1].connect(0, Direction::Both, Gaussian::known());
    nodes
}

#[test]
fn a_separator_narrower_than_the_belief_is_reported() {
    let [mut a, _] = pair(Rule::Edge);
    let mut b = FusionNode::new("b", Space::real(2), Gaussian::known(), Rule::Edge);
    let narrow = Gaussian::from_moments(Vector2::zeros(), Matrix2::new(9.0, 0.1, 0.1, 0.01)).unwrap();
    b.connect(0, Direction::Both, Known::new(InformationSet::prior(), narrow));
    a.observe(Item::new(0, 0), &World::likelihood(Item::new(0, 0))).unwrap();
    let message = a.send(0, 1).unwrap();
    let before = *b.belief();
    let error = b.receive(&message, still).unwrap_err();
    let words = error.to_string();
    assert!(matches!(error, FusionError::Indivisible { .. }));
    for part in ["node \"b\"", "message from node 0", "along (", "start both ends", "intersection"] {
        assert!(words.contains(part), "{words}");
    }
    assert_eq!(*b.belief(), before);
}

#[test]
fn a_message_from_the_future_is_refused() {
    let [mut a, mut b] = pair(Rule::Removal);
    a.predict(2.0, |belief| Ok(*belief)).unwrap();
    a.observe(Item::new(0, 0), &World::likelihood(Item::new(0, 0))).unwrap();
    let message = a.send(0, 1).unwrap();
    let error = b.receive(&message, still).unwrap_err();
    assert_eq!(
        error.to_string(),
        "node \"b\", time 0, message from node 0: the message is from time 2 and the receiver is at 0; predict the \
         receiver to the message's time first, or set the clocks right"
    );
    b.predict(3.0, |belief| Ok(*belief)).unwrap();
    assert!(b.receive(&message, still).is_ok());
    assert!(b.belief().distance(&Gaussian::posterior(a.information())) < 1e-12);
    assert!(matches!(b.predict(1.0, |belief| Ok(*belief)), Err(FusionError::Backwards { .. })));
    assert!(b.predict(f64::NAN, |belief| Ok(*belief)).is_err());
}

#[test]
fn strangers_and_loops_are_refused() {
    let [mut a, _] = pair(Rule::Removal);
    assert!(matches!(a.send(0, 7), Err(FusionError::NotConnected { neighbour: 7, .. })));
    let mut nodes: Vec<_> = (0..4)
        .map(|k| FusionNode::new(format!("{k}"), Space::real(2), Gaussian::<2>::known(), Rule::Removal))
        .collect();
    for (from, to) in [(0, 1), (0, 3), (1, 2), (3, 2)] {
        nodes[from].connect(to, Direction::Both, Gaussian::known());
        nodes[to].connect(from, Direction::Both, Gaussian::known());
    }
    for (k, node) in nodes.iter_mut().enumerate() {
        let item = Item::new(k as u32, 0);
        node.observe(item, &World::likelihood(item)).unwrap();
    }
    for (from, to) in [(0, 1), (0, 3), (1, 2)] {
        let message = nodes[from].send(from, to).unwrap();
        nodes[to].receive(&message, still).unwrap();
    }
    // What node 0 observed comes to node 2 by both ways.
    let message = nodes[3].send(3, 2).unwrap();
    let before = *nodes[2].belief();
    let error = nodes[2].receive(&message, still).unwrap_err();
    assert!(matches!(error, FusionError::Loop { .. }));
    assert!(
        error.to_string().contains("both hold observation 0 of 0, which came by more than one path"),
        "{error}"
    );
    assert_eq!(*nodes[2].belief(), before);
}

#[test]
fn a_graph_refuses_the_future_and_strangers() {
    let mut graph = InformationGraph::new();
    let [a, b] = ["a", "b"].map(|name| graph.add_node(name));
    let seen = graph.observe(a, 5.0).unwrap();
    assert!(matches!(graph.communicate(&[seen], b, 4.0), Err(FusionError::FromTheFuture { .. })));
    assert!(matches!(graph.observe(9, 1.0), Err(FusionError::Unknown { what: "node", .. })));
    assert!(matches!(graph.observe(a, 4.0), Err(FusionError::Backwards { .. })));
    assert!(graph.observe(a, f64::NAN).is_err());
    assert_eq!(graph.silent(), [a, b]);
    for wrong in [
        r#"[{"observe": {"node": 0, "time": 1.0}}]"#,
        r#"[{"node": "a"}, {"receive": {"node": 0, "time": 1.0, "from": [7]}}]"#,
        r#"[{"node": "a"}, {"node": "b"}, {"observe": {"node": 0, "time": 2.0}},
            {"receive": {"node": 1, "time": 1.0, "from": [3]}}]"#,
        r#"[{"node": "a"}, {"observe": {"node": 0, "time": -1.0}}]"#,
    ] {
        assert!(serde_json::from_str::<InformationGraph>(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn families_say_why_they_cannot_divide() {
    let certain = Categorical::certain(3, 0).unwrap();
    assert!(Categorical::prior().remove(&certain).unwrap_err().contains("rules state 1 out"));
    assert_eq!(certain.remove(&certain).unwrap(), certain);
    let space = Space::real(1);
    let particles = AnyMessage::from_particles(Particles::equally_weighted(&space, vec![0.0, 1.0]).unwrap());
    assert!(particles.power(0.5).is_err());
    let gaussian = |variance| AnyMessage::gaussian(&space, &[0.0], &[variance]).unwrap();
    assert!(gaussian(2.0).remove(&gaussian(1.0)).unwrap_err().contains("narrower"));
    assert!(gaussian(1.0).remove(&gaussian(2.0)).is_ok());
    assert!(gaussian(1.0).remove(&particles).is_err());
}
