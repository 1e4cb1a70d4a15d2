//! What the builder refuses, in whose name, and what a graph can be asked.

use crate::bell::{BAD_FORM, Behaviour, Bell, Linear, chain, grid, variables};
use sumprod_graph::{Engine, FactorGraph, GraphError, Options, Space};

type Boxed = FactorGraph<Bell, Linear>;

#[test]
fn a_name_can_be_taken_once() {
    let mut graph = Boxed::new();
    graph.variable("robot", Space::real(1)).unwrap();
    let error = graph.variable("robot", Space::real(1)).unwrap_err();
    assert_eq!(error, GraphError::DuplicateName("robot".into()));
    assert!(error.to_string().contains("\"robot\""));
    assert_eq!(graph.variable_count(), 1);
}

#[test]
fn a_factor_needs_ports_and_the_right_variables() {
    let (mut graph, ids) = variables::<true>(2);
    let error = graph.factor("empty", Linear::new(&[], 0.0, 1.0), &[]).unwrap_err();
    assert_eq!(error, GraphError::NoPort("empty #0".into()));

    let error = graph.factor("step", Linear::step(0.0, 1.0), &ids[..1]).unwrap_err();
    assert_eq!(error, GraphError::PortCount { factor: "step #0".into(), ports: 2, variables: 1 });
    assert!(error.to_string().contains("\"step #0\""));

    let wide = Linear::step(0.0, 1.0).with_dimensions(&[1, 3]);
    let error = graph.factor("wide", wide, &ids).unwrap_err();
    let expected = GraphError::PortDimension {
        factor: "wide #0".into(),
        port: 1,
        expected: 3,
        variable: "x1".into(),
        found: 1,
    };
    assert_eq!(error, expected);
    for word in ["\"wide #0\"", "port 1", "\"x1\"", "dimension 3"] {
        assert!(error.to_string().contains(word), "{error}");
    }
    assert_eq!((graph.factor_count(), graph.edge_count()), (0, 0), "a refused factor leaves nothing behind");
}

#[test]
fn handles_of_another_graph_are_unknown() {
    let (other, foreign) = variables::<true>(5);
    let foreign_factor = {
        let graph = chain::<true>(3, Behaviour::Exact);
        graph.factor_ids().last().unwrap()
    };
    let (mut graph, ids) = variables::<true>(2);
    let last = *foreign.last().unwrap();
    let unknown = GraphError::Unknown { what: "variable", index: 4, count: 2 };
    let factor = graph.factor("step", Linear::step(0.0, 1.0), &[ids[0], last]).unwrap_err();
    assert_eq!(factor, unknown);
    assert_eq!(graph.set_prior(last, Bell::new(0.0, 1.0)).unwrap_err(), unknown);
    assert_eq!(graph.set_start(last, Bell::new(0.0, 1.0)).unwrap_err(), unknown);
    assert_eq!(graph.set_time(last, 0.0).unwrap_err(), unknown);
    assert_eq!(graph.set_belief_form(last, 0).unwrap_err(), unknown);
    let error = graph.edge(foreign_factor, 0).unwrap_err();
    assert_eq!(error, GraphError::Unknown { what: "factor", index: 2, count: 0 });
    assert!(error.to_string().contains("factor 2"));
    assert_eq!(other.variable_count(), 5);
}

#[test]
fn ports_and_forms_are_checked() {
    let mut graph = chain::<true>(2, Behaviour::Exact);
    let step = graph.factor_ids().nth(1).unwrap();
    let error = graph.set_edge_form(step, 2, 0).unwrap_err();
    assert_eq!(error, GraphError::NoSuchPort { factor: "step #1".into(), port: 2, last: 1 });

    let error = graph.set_edge_form(step, 1, BAD_FORM).unwrap_err();
    assert!(matches!(&error, GraphError::Form { factor, port: 1, variable, .. }
        if factor == "step #1" && variable == "x1"));
    assert!(error.to_string().contains("no form 99"), "{error}");

    graph.set_edge_form(step, 1, 7).unwrap();
    assert_eq!(*graph.edge_form(graph.edge(step, 1).unwrap()), 7);
    assert_eq!(*graph.edge_form(graph.edge(step, 0).unwrap()), 0);
}

#[test]
fn options_out_of_range_are_refused() {
    let graph = chain::<true>(2, Behaviour::Exact);
    let refused = |options: Options| Engine::new(&graph, options).map(|_| ()).unwrap_err();
    for damping in [-0.1, 1.0, f64::NAN] {
        let error = refused(Options { damping, ..Options::default() });
        assert!(matches!(error, GraphError::Option { what: "damping", .. }), "{error}");
    }
    for tolerance in [-1e-9, f64::NAN] {
        let error = refused(Options { tolerance, ..Options::default() });
        assert!(matches!(error, GraphError::Option { what: "tolerance", .. }), "{error}");
    }
}

#[test]
fn the_graph_answers_questions() {
    // x0 - x1 - x2 with a triple over x2, x3, x4; x5 alone; a loop of x6, x7.
    let (mut graph, x) = variables::<true>(8);
    for k in 0..2 {
        graph.factor("step", Linear::step(0.0, 1.0), &x[k..k + 2]).unwrap();
    }
    let triple = graph.factor("triple", Linear::new(&[1.0; 3], 0.0, 1.0), &x[2..5]).unwrap();
    for _ in 0..2 {
        graph.factor("pair", Linear::step(0.0, 1.0), &x[6..8]).unwrap();
    }
    assert_eq!(graph.neighbours(x[2]), [x[1], x[3], x[4]]);
    assert_eq!(graph.neighbours(x[6]), [x[7]], "a neighbour by two factors is listed once");
    assert!(graph.neighbours(x[5]).is_empty());
    assert_eq!(graph.components(), [x[..5].to_vec(), vec![x[5]], x[6..].to_vec()]);
    assert_eq!(graph.loop_count(), 1);
    assert_eq!(graph.find("x3"), Some(x[3]));
    assert_eq!(graph.find("x9"), None);
    assert_eq!(graph.ports(triple).collect::<Vec<_>>(), x[2..5]);
    assert_eq!(graph.factors_of(x[2]).len(), 2);
    assert_eq!(graph.factor_kind(triple), "triple");
    assert_eq!(graph.petgraph().node_count(), 8 + 5);
    assert_eq!(graph.petgraph().edge_count(), graph.edge_count());

    assert_eq!(chain::<true>(20, Behaviour::Exact).loop_count(), 0);
    // A side x side grid has (side - 1)² faces.
    assert_eq!(grid::<true>(6, Behaviour::Exact).loop_count(), 25);
}

#[test]
fn the_drawing_has_every_node_and_edge() {
    let (mut graph, x) = variables::<true>(2);
    let quoted = graph.variable("say \"hi\"", Space::real(1)).unwrap();
    graph.factor("step", Linear::step(0.0, 1.0), &x).unwrap();
    graph.factor("", Linear::step(0.0, 1.0), &[x[1], quoted]).unwrap();
    let dot = graph.dot();
    assert!(dot.starts_with("graph {") && dot.ends_with("}\n"));
    assert_eq!(dot.matches("shape=ellipse").count(), 3);
    assert_eq!(dot.matches("shape=box").count(), 2);
    assert!(dot.contains("label=\"step #0\"") && dot.contains("label=\"factor 1\""));
    assert!(dot.contains(r#"label="say \"hi\"""#));
    // Nodes are numbered as they were made: x0, x1, the quoted one, then the factors.
    for line in ["n3 -- n0 [taillabel=\"0\"]", "n3 -- n1 [taillabel=\"1\"]", "n4 -- n2 [taillabel=\"1\"]"] {
        assert!(dot.contains(line), "{line} is missing in\n{dot}");
    }
}
