//! Forms that change between iterations.

use crate::bell::{BAD_FORM, Bell, variables};
use sumprod_graph::schedule::{Coloured, Flooding};
use sumprod_graph::{
    EdgeId, Engine, Factor, FactorGraph, GraphError, Incoming, MessageError, Options, Port, Space, Stream,
};

/// Sends a message of which the precision is the form's number.
struct Formed;

impl Factor<Bell> for Formed {
    fn dimensions(&self) -> &[usize] {
        &[1]
    }

    fn message(
        &self,
        _to: Port,
        _incoming: &Incoming<'_, Bell>,
        form: &u8,
        _stream: &mut Stream,
    ) -> Result<Bell, MessageError> {
        Ok(Bell { precision: f64::from(*form), shift: 0.0 })
    }
}

fn graph() -> (FactorGraph<Bell, Formed>, [EdgeId; 2]) {
    let mut graph = FactorGraph::new();
    let edges = [4, 2].map(|form| {
        let variable = graph.unnamed_variable(Space::real(1));
        let factor = graph.factor("formed", Formed, &[variable]).unwrap();
        graph.set_edge_form(factor, 0, form).unwrap();
        graph.edge(factor, 0).unwrap()
    });
    (graph, edges)
}

#[test]
fn a_message_in_a_new_form_is_sent_whole_and_others_are_damped() {
    let (graph, [changed, kept]) = graph();
    for coloured in [true, false] {
        let run = |engine: &mut Engine<'_, Bell, Formed>| match coloured {
            true => engine.run(&mut Coloured::new().rounds(1)).unwrap(),
            false => engine.run(&mut Flooding).unwrap(),
        };
        let options = Options { max_iterations: 1, tolerance: 0.0, damping: 0.5, ..Options::default() };
        let mut engine = Engine::new(&graph, options).unwrap();
        run(&mut engine);
        assert_eq!([changed, kept].map(|edge| engine.message(edge).precision), [4.0, 2.0]);
        engine.set_edge_form(changed, 10).unwrap();
        assert_eq!((*engine.edge_form(changed), *graph.edge_form(changed)), (10, 4));
        assert_eq!(engine.message(changed).precision, 4.0, "until the next message");
        run(&mut engine);
        assert_eq!(engine.message(changed).precision, 10.0, "not half of it");
        engine.set_edge_form(changed, 10).unwrap();
        run(&mut engine);
        engine.set_damping(0.0).unwrap();
        engine.set_edge_form(changed, 20).unwrap();
        run(&mut engine);
        assert_eq!(engine.message(changed).precision, 20.0);
        let variable = engine.topology().variable_of(changed);
        assert_eq!(engine.belief(variable).precision, 20.0);
        engine.set_belief_form(variable, 7).unwrap();
        assert_eq!(*engine.belief_form(variable), 7);
    }
}

#[test]
fn forms_and_handles_that_do_not_exist_are_refused() {
    let (graph, [edge, _]) = graph();
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    let message = engine.set_edge_form(edge, BAD_FORM).unwrap_err().to_string();
    assert!(message.contains("port 0 of factor \"formed #0\" (variable \"variable 0\")"), "{message}");
    assert!(matches!(engine.set_damping(1.0), Err(GraphError::Option { what: "damping", .. })));

    let (mut larger, x) = variables::<true>(9);
    for &x in &x {
        larger.factor("prior", crate::bell::Linear::prior(0.0, 1.0), &[x]).unwrap();
    }
    let foreign = larger.edge(larger.factor_ids().nth(8).unwrap(), 0).unwrap();
    assert!(matches!(
        engine.set_edge_form(foreign, 1),
        Err(GraphError::Unknown { what: "edge", index: 8, count: 2 })
    ));
    assert!(matches!(engine.set_belief_form(x[5], 1), Err(GraphError::Unknown { what: "variable", .. })));
    let refused = engine.run(&mut Coloured::new().among([foreign])).unwrap_err();
    assert_eq!(refused.to_string(), "edge 8 is not in this graph, which has 2");
}

#[test]
fn only_the_chosen_edges_are_sent_along() {
    let (graph, [sent, silent]) = graph();
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut Coloured::new().among([sent]).rounds(1)).unwrap();
    assert_eq!([sent, silent].map(|edge| engine.message(edge).precision), [4.0, 0.0]);
}
