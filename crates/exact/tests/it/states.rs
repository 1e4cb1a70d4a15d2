//! Graphs of finitely many states: recorded answers, enumeration, and files that are wrong.

use crate::support::{json, numbers, recorded};
use proptest::prelude::*;
use std::path::Path;
use sumprod_exact::read::TableFile;
use sumprod_exact::{JunctionOptions, JunctionTree, discrete_log_evidence, factor_probabilities};
use sumprod_graph::schedule::{Coloured, Flooding, Residual, Schedule};
use sumprod_graph::{Engine, FactorGraph, Options, Space};
use sumprod_messages::{Categorical, CategoricalFamily, CategoricalForm, LogOdds};
use sumprod_models::discrete::{Logical, Table};

const GOLDEN: [&str; 3] = ["testfast", "grid8_attractive", "zeroes1"];

fn golden(name: &str) -> Option<(TableFile, serde_json::Value)> {
    let file = recorded(&format!("discrete_golden/{name}.fg"))?;
    let golden = recorded(&format!("discrete_golden/{name}.golden.json"))?;
    Some((TableFile::read(&file).unwrap(), json(&golden)))
}

#[track_caller]
fn close(found: &[Vec<f64>], expected: &serde_json::Value, tolerance: f64) {
    let (found, expected) = (found.concat(), numbers(expected));
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).abs() <= tolerance, "{a} {b}");
    }
}

#[test]
fn junction_trees_give_the_recorded_answers() {
    for name in GOLDEN {
        let Some((file, golden)) = golden(name) else { return };
        let graph = file.graph().unwrap();
        let tree = JunctionTree::new(&graph, JunctionOptions::default()).unwrap();
        let answer = tree.solve().unwrap();
        let exact = &golden["exact"];
        close(&answer.marginals, &exact["var_marginals"], 1e-10);
        close(&answer.factor_marginals, &exact["factor_marginals"], 1e-10);
        let log_z = exact["log_z"].as_f64().unwrap();
        assert!((answer.log_evidence + file.log_constant - log_z).abs() < 1e-10, "{name}");
        let most = tree.most_probable().unwrap();
        let score = golden["map"]["log_score"].as_f64().unwrap();
        assert!((most.log_score - score).abs() < 1e-10, "{name}");
        let states: Vec<f64> = most.states.iter().map(|&state| state as f64).collect();
        assert_eq!(states, numbers(&golden["map"]["state"]), "{name}");
    }
}

fn fixed_point<M: CategoricalFamily>(
    graph: &FactorGraph<M>,
    schedule: &mut dyn Schedule,
    damping: f64,
    check: impl FnOnce(&Engine<'_, M>),
) {
    let options = Options { damping, tolerance: 1e-13, max_iterations: 1000, ..Options::default() };
    let mut engine = Engine::new(graph, options).unwrap();
    assert!(engine.run(schedule).unwrap().converged());
    check(&engine);
}

fn probabilities<M: CategoricalFamily>(engine: &Engine<'_, M>) -> Vec<Vec<f64>> {
    let of = |variable| {
        let belief: &M = engine.belief(variable);
        let mut logs = vec![0.0; belief.states()];
        belief.read_logs(&mut logs);
        Categorical::new(&logs).unwrap().probabilities()
    };
    engine.graph().variable_ids().map(of).collect()
}

/// The same factors on another family of messages.
fn of_family<M: CategoricalFamily>(file: &TableFile) -> FactorGraph<M> {
    let mut graph = FactorGraph::<M>::new();
    let ids: Vec<_> =
        file.variables.iter().map(|v| graph.unnamed_variable(Space::finite(v.states))).collect();
    for factor in &file.factors {
        let ports: Vec<_> = factor.variables.iter().map(|&number| ids[number]).collect();
        graph.factor("table", Box::new(factor.table.clone()), &ports).unwrap();
    }
    graph
}

#[test]
fn messages_reach_the_recorded_fixed_points_by_every_schedule() {
    for name in GOLDEN {
        let Some((file, golden)) = golden(name) else { return };
        let bp = &golden["bp"];
        let graph = file.graph().unwrap();
        let check = |engine: &Engine<'_, Categorical>| {
            close(&probabilities(engine), &bp["var_marginals"], 1e-9);
            let factors: Vec<_> =
                graph.factor_ids().map(|factor| factor_probabilities(engine, factor).unwrap()).collect();
            close(&factors, &bp["factor_marginals"], 1e-9);
            let log_z = bp["log_z_bethe"].as_f64().unwrap();
            assert!((discrete_log_evidence(engine).unwrap() - log_z).abs() < 1e-9, "{name}");
        };
        for (schedule, damping) in [
            (Box::new(Flooding) as Box<dyn Schedule>, 0.0),
            (Box::new(Flooding), 0.5),
            (Box::new(Residual::default()), 0.0),
            (Box::new(Coloured::new()), 0.0),
        ] {
            let mut schedule = schedule;
            fixed_point(&graph, schedule.as_mut(), damping, check);
        }
        let odds = of_family::<LogOdds>(&file);
        for damping in [0.0, 0.5] {
            fixed_point(&odds, &mut Flooding, damping, |engine| {
                close(&probabilities(engine), &bp["var_marginals"], 1e-9);
                let log_z = bp["log_z_bethe"].as_f64().unwrap();
                assert!((discrete_log_evidence(engine).unwrap() - log_z).abs() < 1e-9, "{name}");
            });
        }
    }
}

#[test]
fn the_published_errors_of_testfast() {
    let Some((file, _)) = golden("testfast") else { return };
    let graph = file.graph().unwrap();
    let exact = JunctionTree::new(&graph, JunctionOptions::default()).unwrap().solve().unwrap();
    fixed_point(&graph, &mut Residual::default(), 0.0, |engine| {
        let pairs = probabilities(engine).concat().into_iter().zip(exact.marginals.concat());
        let largest = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert_eq!(format!("{largest:.3e}"), "8.924e-3");
        let error = discrete_log_evidence(engine).unwrap() - exact.log_evidence;
        assert_eq!(format!("{error:.3e}"), "7.187e-4");
    });
}

#[test]
fn maxima_reach_the_recorded_beliefs() {
    // Of the attractive grid maxima have several fixed points: every schedule here reaches another than the recorded one.
    for name in GOLDEN.into_iter().filter(|&name| name != "grid8_attractive") {
        let Some((file, golden)) = golden(name) else { return };
        let mut graph = file.graph().unwrap();
        let factors: Vec<_> = graph.factor_ids().collect();
        for factor in factors {
            for port in 0..graph.ports(factor).count() {
                graph.set_edge_form(factor, port, CategoricalForm::max_product()).unwrap();
            }
        }
        let recorded = &golden["max_product_bp"]["max_marginals"];
        fixed_point(&graph, &mut Coloured::new(), 0.0, |engine| {
            close(&probabilities(engine), recorded, 1e-9);
        });
    }
}

/// Cardinalities, and tables with their scopes.
type Tables = (Vec<usize>, Vec<(Vec<usize>, Table)>);

fn build((cardinalities, tables): &Tables) -> FactorGraph<Categorical> {
    let mut graph = FactorGraph::<Categorical>::new();
    let ids: Vec<_> = cardinalities.iter().map(|&n| graph.unnamed_variable(Space::finite(n))).collect();
    for (scope, table) in tables {
        let ports: Vec<_> = scope.iter().map(|&variable| ids[variable]).collect();
        graph.factor("table", Box::new(table.clone()), &ports).unwrap();
    }
    graph
}

fn tables() -> impl Strategy<Value = Tables> {
    let cardinalities = prop::collection::vec(1_usize..4, 2..7);
    let factors = prop::collection::vec(
        (prop::collection::vec(any::<prop::sample::Index>(), 1..4), any::<u64>()),
        1..9,
    );
    (cardinalities, factors).prop_map(|(cardinalities, factors)| {
        let mut tables = Vec::new();
        for (scope, seed) in factors {
            let mut scope: Vec<_> = scope.iter().map(|index| index.index(cardinalities.len())).collect();
            scope.sort_unstable();
            scope.dedup();
            let turn = seed as usize % scope.len();
            scope.rotate_left(turn);
            let states: Vec<usize> = scope.iter().map(|&variable| cardinalities[variable]).collect();
            let mut seed = seed;
            let mut value = || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let x = (seed >> 40) as f64 / (1u64 << 24) as f64;
                if x < 0.1 { 0.0 } else { x }
            };
            let mut values: Vec<f64> = (0..states.iter().product()).map(|_| value()).collect();
            values[0] = 0.5;
            tables.push((scope, Table::new(&states, values).unwrap()));
        }
        (cardinalities, tables)
    })
}

/// Every joint state: its logarithm of the product.
fn enumerate((cardinalities, tables): &Tables) -> Vec<(Vec<usize>, f64)> {
    let joint = |index: usize| {
        let mut rest = index;
        let mut states = Vec::new();
        for &n in cardinalities {
            states.push(rest % n);
            rest /= n;
        }
        let own = |scope: &[usize]| scope.iter().map(|&v| states[v]).collect::<Vec<_>>();
        let log = tables.iter().map(|(scope, table)| table.log_at(&own(scope))).sum();
        (states.clone(), log)
    };
    (0..cardinalities.iter().product()).map(joint).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn junction_trees_agree_with_enumeration(tables in tables()) {
        let (joint, graph) = (enumerate(&tables), build(&tables));
        let total: f64 = joint.iter().map(|(_, log)| log.exp()).sum();
        let tree = JunctionTree::new(&graph, JunctionOptions::default()).unwrap();
        let answer = tree.solve().unwrap();
        prop_assert!((answer.log_evidence - total.ln()).abs() < 1e-10);
        for (variable, marginal) in answer.marginals.iter().enumerate() {
            for (state, p) in marginal.iter().enumerate() {
                let expected: f64 = joint.iter().filter(|(s, _)| s[variable] == state).map(|(_, log)| log.exp()).sum();
                prop_assert!((p - expected / total).abs() < 1e-11);
            }
        }
        for (factor, marginal) in graph.factor_ids().zip(&answer.factor_marginals) {
            let ports: Vec<usize> = graph.ports(factor).map(|v| v.index()).collect();
            let mut expected = vec![0.0; marginal.len()];
            for (states, log) in &joint {
                let place = ports.iter().fold(0, |place, &v| {
                    place * graph.space(graph.variable_ids().nth(v).unwrap()).dimension() + states[v]
                });
                expected[place] += log.exp() / total;
            }
            for (a, b) in marginal.iter().zip(&expected) {
                prop_assert!((a - b).abs() < 1e-11);
            }
        }
        let most = tree.most_probable().unwrap();
        let best = joint.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
        let own = joint.iter().find(|(states, _)| *states == most.states).unwrap().1;
        prop_assert!((most.log_score - best).abs() < 1e-10 && (own - best).abs() < 1e-10);
        if graph.loop_count() == 0 {
            let mut engine = Engine::new(&graph, Options::default()).unwrap();
            engine.run(&mut Flooding).unwrap();
            prop_assert!((discrete_log_evidence(&engine).unwrap() - total.ln()).abs() < 1e-10);
            for (own, exact) in probabilities(&engine).concat().iter().zip(answer.marginals.concat()) {
                prop_assert!((own - exact).abs() < 1e-10);
            }
        }
    }
}

#[test]
fn what_is_too_wide_or_impossible_is_told() {
    let mut graph = FactorGraph::<LogOdds>::new();
    let side = 40;
    let ids: Vec<_> =
        (0..side * side).map(|k| graph.variable(format!("pixel {k}"), Space::finite(2)).unwrap()).collect();
    let pair = std::sync::Arc::new(Table::new(&[2, 2], vec![2.0, 1.0, 1.0, 2.0]).unwrap());
    for row in 0..side {
        for column in 0..side {
            let here = row * side + column;
            if column + 1 < side {
                graph.factor("pair", Box::new(pair.clone()), &[ids[here], ids[here + 1]]).unwrap();
            }
            if row + 1 < side {
                graph.factor("pair", Box::new(pair.clone()), &[ids[here], ids[here + side]]).unwrap();
            }
        }
    }
    let error = JunctionTree::new(&graph, JunctionOptions::default()).err().unwrap().to_string();
    assert!(error.contains("too wide for a junction tree") && error.contains("pixel"), "{error}");
    assert!(error.contains("67108864 are allowed"), "{error}");
    // A factor over all at once has no table that small, but its messages are no burden.
    let one = graph.factor("one", Box::new(Logical::at_most_one(side * side).unwrap()), &ids);
    one.unwrap();
    let error = JunctionTree::new(&graph, JunctionOptions::default()).err().unwrap().to_string();
    assert!(error.contains("1600 variables"), "{error}");

    let mut graph = FactorGraph::<Categorical>::new();
    let ids: Vec<_> = ["a", "b"].map(|name| graph.variable(name, Space::finite(2)).unwrap()).into();
    let differ = Table::new(&[2, 2], vec![0.0, 1.0, 1.0, 0.0]).unwrap();
    let same = Table::new(&[2, 2], vec![1.0, 0.0, 0.0, 1.0]).unwrap();
    graph.factor("differ", Box::new(differ), &ids).unwrap();
    graph.factor("same", Box::new(same), &ids).unwrap();
    let tree = JunctionTree::new(&graph, JunctionOptions::default()).unwrap();
    let error = tree.solve().unwrap_err().to_string();
    assert!(error.contains("no joint state is possible") && error.contains('b'), "{error}");
    assert!(tree.most_probable().is_err());

    let real = {
        let mut graph = FactorGraph::<sumprod_messages::AnyMessage>::new();
        graph.variable("x", Space::real(1)).unwrap();
        JunctionTree::new(&graph, JunctionOptions::default()).err().unwrap().to_string()
    };
    assert!(real.contains("\"x\" is continuous"), "{real}");
}

fn said(name: &str, text: &str) -> String {
    match TableFile::parse(Path::new(name), text) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("read: {text}"),
    }
}

#[test]
fn malformed_fg() {
    let pair = "1\n\n2\n0 1\n2 2\n";
    for (text, expected) in [
        ("", "a.fg: is empty"),
        ("# only words\n", "a.fg: is empty"),
        ("x", "a.fg:1: the number of factors is \"x\", expected a whole number from 0"),
        ("-1", "a.fg:1: the number of factors is \"-1\""),
        ("0", "a.fg: holds no variable"),
        ("1", "a.fg:1: the file ends where the number of variables of factor 0 should follow"),
        (&format!("{pair}4\n0 1\n1 -2\n"), "a.fg:8: entry 1 of factor 0 is -2"),
        (&format!("{pair}4\n0 1\n1 inf\n"), "a.fg:8: entry 1 of factor 0 is inf"),
        (&format!("{pair}4\n0 1\n1 one\n"), "a.fg:8: entry 1 of factor 0 is \"one\", not a number"),
        (&format!("{pair}4\n0 1\n4 1\n"), "a.fg:8: entry 4 of factor 0 is none of its table"),
        (&format!("{pair}2\n0 1\n0 1\n"), "a.fg:8: entry 0 of factor 0 is given twice"),
        (&format!("{pair}5\n"), "a.fg:6: factor 0 lists 5 entries, but a table of [2, 2] states has 4"),
        (&format!("{pair}2\n0 0\n1 0\n"), "a.fg:3: every entry of the table is zero"),
        (&format!("{pair}0\n"), "a.fg:3: every entry of the table is zero"),
        (&format!("{pair}1\n0 1\n7\n"), "a.fg:8: \"7\" follows after the last factor"),
        (
            &format!("{pair}2\n0 1\n"),
            "a.fg:7: the file ends where an entry's index of factor 0 should follow",
        ),
        ("1\n2\n0 0\n2 2\n", "a.fg:3: factor 0 names variable 0 twice"),
        ("1\n2\n0 1\n2 0\n", "a.fg:4: variable 1 has 0 states"),
        ("1\n99999999999\n", "a.fg:2: factor 0 has 99999999999 variables"),
        ("1\n2\n0 1\n99999999 99999999\n1\n", "a.fg:4: with a table of [99999999, 99999999] states"),
        (
            "2\n1\n0\n2\n1\n0 1\n\n1\n0\n3\n1\n0 1\n",
            "a.fg:10: variable 0 has 3 states here, but 2 on line 4; they must be the same",
        ),
        ("1\n0\n1\n0 0\n", "a.fg:2: every entry of the table is zero"),
    ] {
        let error = said("a.fg", text);
        assert!(error.contains(expected), "{error}\nexpected {expected}");
    }
    let file = TableFile::parse(Path::new("a.fg"), "2\n0\n1\n0 2\n\n1\n7\n3\n2\n0 1 # one\n2 1\n").unwrap();
    assert!((file.log_constant - 2f64.ln()).abs() < 1e-15);
    assert_eq!(
        (file.variables[0].name.as_str(), file.factors[0].table.values()),
        ("7", &[1.0, 0.0, 1.0][..])
    );
}

#[test]
fn malformed_uai() {
    let head = "MARKOV\n2\n2 3\n1\n2 0 1\n";
    for (text, expected) in [
        ("MARKOW\n", "a.uai:1: starts with \"MARKOW\", expected MARKOV or BAYES"),
        ("MARKOV\n2\n2", "a.uai:3: the file ends where the number of states of variable 1 should follow"),
        ("MARKOV\n2\n2 0\n", "a.uai:3: variable 1 has 0 states"),
        ("MARKOV\n2\n2 2\n1\n2 0 2\n", "a.uai:5: factor 0 names variable 2, but there are 2"),
        ("MARKOV\n2\n2 2\n1\n2 1 1\n", "a.uai:5: factor 0 names variable 1 twice"),
        (&format!("{head}5\n"), "a.uai:6: factor 0 has 5 entries, but a table of [2, 3] states has 6"),
        (&format!("{head}6\n1 2 3 4 5\n"), "a.uai:7: the file ends where entry 5 of factor 0 should follow"),
        (&format!("{head}6\n1 2 3 -4 5 6\n"), "a.uai:7: entry 3 of factor 0 is -4"),
        (&format!("{head}6\n0 0 0 0 0 0\n"), "a.uai:6: every entry of the table is zero"),
        (&format!("{head}6\n1 2 3 4 5 6 7\n"), "a.uai:7: \"7\" follows after the last factor"),
    ] {
        let error = said("a.uai", text);
        assert!(error.contains(expected), "{error}\nexpected {expected}");
    }
    // The last variable runs fastest.
    let file = TableFile::parse(Path::new("a.uai"), &format!("{head}6\n1 2 3 4 5 6\n")).unwrap();
    assert!((file.factors[0].table.log_at(&[1, 0]) - 4f64.ln()).abs() < 1e-15);
    // The same table in libDAI's order.
    let fg = "1\n2\n0 1\n2 3\n6\n0 1\n1 4\n2 2\n3 5\n4 3\n5 6\n";
    let same = TableFile::parse(Path::new("a.fg"), fg).unwrap();
    assert!((same.factors[0].table.log_at(&[0, 1]) - 4f64.ln()).abs() < 1e-15);
    assert_eq!(same.factors[0].variables, [1, 0]);
}
