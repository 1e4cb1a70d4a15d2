//! The order of forward-backward, read off by a pass that only takes notes.

use crate::bell::{Behaviour, Graph, Linear, chain, variables};
use proptest::prelude::*;
use std::collections::HashSet;
use sumprod_graph::schedule::{ForwardBackward, Refusal};
use sumprod_graph::{EdgeId, Engine, GraphError, Options, Pass, Schedule, Topology};

#[derive(Default)]
struct Notes(Vec<EdgeId>);

impl Pass for Notes {
    fn everything(&mut self) -> Result<f64, GraphError> {
        panic!("forward-backward sends one message at a time");
    }

    fn together(&mut self, _edges: &[EdgeId]) -> Result<f64, GraphError> {
        panic!("forward-backward sends one message at a time");
    }

    fn in_order(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError> {
        self.0.extend_from_slice(edges);
        Ok(1.0)
    }
}

/// Every message exactly once, after all the messages that flow into it.
fn check_order(graph: &Graph) {
    let topology = Topology::new(graph);
    let mut schedule = ForwardBackward::new();
    schedule.begin(&topology).unwrap();
    let mut notes = Notes::default();
    schedule.iteration(&topology, &mut notes).unwrap();
    let mut sent = HashSet::new();
    for &edge in &notes.0 {
        let factor = topology.factor_of(edge);
        for other in topology.edges_of_factor(factor).filter(|&other| other != edge) {
            let variable = topology.variable_of(other);
            for input in topology.edges_of_variable(variable).filter(|&input| input != other) {
                assert!(sent.contains(&input), "edge {edge:?} was sent before its input {input:?}");
            }
        }
        assert!(sent.insert(edge), "edge {edge:?} was sent twice");
    }
    assert_eq!(sent.len(), topology.edge_count());
}

#[test]
fn a_chain_is_filtered_then_smoothed() {
    let graph = chain::<true>(50, Behaviour::Exact);
    check_order(&graph);
    let topology = Topology::new(&graph);
    let mut schedule = ForwardBackward::new();
    schedule.begin(&topology).unwrap();
    let mut notes = Notes::default();
    schedule.iteration(&topology, &mut notes).unwrap();
    let steps =
        notes.0.iter().filter(|&&edge| topology.edges_of_factor(topology.factor_of(edge)).count() == 2);
    let visited: Vec<usize> = steps.map(|&edge| topology.variable_of(edge).index()).collect();
    let expected: Vec<usize> = (1..50).chain((0..49).rev()).collect();
    assert_eq!(visited, expected);
}

#[test]
fn a_star_and_a_forest_are_ordered() {
    let (mut star, x) = variables::<true>(30);
    for &leaf in &x[1..] {
        star.factor("spoke", Linear::step(0.0, 1.0), &[x[0], leaf]).unwrap();
        star.factor("prior", Linear::prior(0.0, 1.0), &[leaf]).unwrap();
    }
    check_order(&star);
    let (mut forest, x) = variables::<true>(7);
    forest.factor("step", Linear::step(0.0, 1.0), &x[..2]).unwrap();
    forest.factor("triple", Linear::new(&[1.0; 3], 0.0, 1.0), &x[3..6]).unwrap();
    check_order(&forest);
}

proptest! {
    #[test]
    fn random_trees_are_ordered(
        shape in prop::collection::vec((0usize..1000, 1usize..4, any::<bool>(), any::<bool>()), 1..40),
    ) {
        // Each entry hangs a factor with some new variables on an older variable, in a random port order.
        let total = 1 + shape.iter().map(|(_, new, _, _)| new).sum::<usize>();
        let (mut graph, x) = variables::<true>(total);
        let mut used = 1;
        for (anchor, new, prior, reversed) in shape {
            let mut ports = vec![x[anchor % used]];
            ports.extend(&x[used..used + new]);
            if reversed {
                ports.reverse();
            }
            graph.factor("joint", Linear::new(&vec![1.0; ports.len()], 0.0, 1.0), &ports).unwrap();
            if prior {
                graph.factor("prior", Linear::prior(0.0, 1.0), &[x[used]]).unwrap();
            }
            used += new;
        }
        prop_assert_eq!(graph.loop_count(), 0);
        check_order(&graph);
    }

    #[test]
    fn a_loop_is_named(length in 2usize..12, tail in 0usize..6, turn in 0usize..12) {
        // A loop of `length` variables, a tail hanging from one of them, and a tree apart.
        let (mut graph, x) = variables::<true>(length + tail + 2);
        for k in 0..length {
            graph.factor("side", Linear::step(0.0, 1.0), &[x[k], x[(k + 1) % length]]).unwrap();
        }
        for k in 0..tail {
            let from = if k == 0 { x[turn % length] } else { x[length + k - 1] };
            graph.factor("tail", Linear::step(0.0, 1.0), &[from, x[length + k]]).unwrap();
        }
        graph.factor("apart", Linear::step(0.0, 1.0), &x[length + tail..]).unwrap();
        let topology = Topology::new(&graph);
        let Err(Refusal::Loop(nodes)) = ForwardBackward::new().begin(&topology) else {
            panic!("the loop was not refused");
        };
        prop_assert_eq!(nodes.len(), 2 * length);

        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        let error = engine.run(&mut ForwardBackward::new()).unwrap_err();
        let GraphError::Loop(names) = &error else { panic!("{error}") };
        // Variables and factors alternate, and each is joined to the next, the last to the first.
        let (topology, nodes) = (graph.petgraph(), names.len());
        let find = |name: &str| topology.node_indices().find(|&node| topology[node] == name).unwrap();
        for k in 0..nodes {
            let (a, b) = (find(&names[k]), find(&names[(k + 1) % nodes]));
            prop_assert!(topology.contains_edge(a, b), "{} and {} are not joined", names[k], names[(k + 1) % nodes]);
        }
        prop_assert_eq!(names.iter().collect::<HashSet<_>>().len(), nodes);
        let joined = names.join(" - ");
        prop_assert!(error.to_string().contains(&joined));
    }
}

#[test]
fn a_factor_that_takes_a_variable_twice_is_a_loop() {
    let (mut graph, x) = variables::<true>(1);
    graph.factor("twice", Linear::new(&[1.0, 1.0], 0.0, 1.0), &[x[0], x[0]]).unwrap();
    assert_eq!(graph.loop_count(), 1);
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    let error = engine.run(&mut ForwardBackward::new()).unwrap_err();
    assert_eq!(error, GraphError::Loop(vec!["x0".into(), "twice #0".into()]));
}
