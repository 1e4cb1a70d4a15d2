//! Rules over finitely many states against enumeration, and each kind of factor against its table.

use proptest::prelude::*;
use rand::RngExt;
use std::sync::Arc;
use sumprod_graph::schedule::{Flooding, ForwardBackward, Residual};
use sumprod_graph::{
    Engine, Factor, FactorGraph, Incoming, Message, MessageError, MessageStreams, Options, Outgoing, Purpose,
    Space, Stream,
};
use sumprod_messages::{AnyForm, AnyMessage, Categorical, CategoricalFamily, CategoricalForm, LogOdds};
use sumprod_models::discrete::{LocalEvidence, Logical, PairOdds, Table, TableError, Tabulation};

const FORM: CategoricalForm = CategoricalForm { temperature: 1.0 };

/// T log Σ exp(· / T), the maximum at T = 0.
fn log_sum(logs: &[f64], temperature: f64) -> f64 {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if temperature == 0.0 || largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + temperature * logs.iter().map(|log| ((log - largest) / temperature).exp()).sum::<f64>().ln()
}

/// The message to a port by visiting every joint state.
fn enumerated(table: &Table, to: usize, incoming: &[Categorical], temperature: f64) -> Vec<f64> {
    let cardinalities = table.cardinalities();
    let mut terms = vec![Vec::new(); cardinalities[to]];
    for (index, log) in table.logs().iter().enumerate() {
        let (mut rest, mut sum, mut own) = (index, *log, 0);
        for port in (0..cardinalities.len()).rev() {
            let state = rest % cardinalities[port];
            rest /= cardinalities[port];
            if port == to {
                own = state;
            } else {
                sum += incoming[port].logs()[state];
            }
        }
        terms[own].push(sum);
    }
    let logs: Vec<f64> = terms.iter().map(|terms| log_sum(terms, temperature)).collect();
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    logs.iter().map(|log| log - largest).collect()
}

fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < 1e-11 * (1.0 + b.abs()) || a == b, "{found:?} {expected:?}");
    }
}

fn message<M: CategoricalFamily>(factor: &impl Factor<M>, to: usize, incoming: &[M], form: &M::Form) -> M {
    let variables: Vec<u32> = (0..incoming.len() as u32).collect();
    let incoming = Incoming::new(incoming, incoming, &variables);
    let mut stream = Stream::new(1, 0, Purpose::Message, 0);
    Factor::<M>::message(factor, to, &incoming, form, &mut stream).unwrap()
}

/// A few cardinalities, a table of them with some zeros, and messages.
fn cases() -> impl Strategy<Value = (Table, Vec<Categorical>)> {
    prop::collection::vec(1_usize..5, 1..5).prop_flat_map(|cardinalities| {
        let entries: usize = cardinalities.iter().product();
        let log = prop_oneof![6 => -4.0..4.0_f64, 1 => Just(f64::NEG_INFINITY), 1 => -2000.0..-700.0];
        let messages: Vec<_> =
            cardinalities.iter().map(|&n| prop::collection::vec(-5.0..0.0_f64, n)).collect();
        (prop::collection::vec(log, entries), messages).prop_filter_map(
            "all zero",
            move |(logs, messages)| {
                let table = Table::from_logs(&cardinalities, logs).ok()?;
                Some((table, messages.iter().map(|logs| Categorical::new(logs).unwrap()).collect()))
            },
        )
    })
}

/// Numbers in [0, 1) from a seed.
fn draws(seed: u64) -> impl FnMut() -> f64 {
    let mut random = Stream::new(seed, 0, Purpose::World, 0).fast();
    move || random.random()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn tables_send_what_enumeration_finds((table, messages) in cases(), temperature in prop_oneof![Just(0.0), Just(1.0), 0.2..3.0]) {
        let form = CategoricalForm { temperature };
        for to in 0..messages.len() {
            let expected = enumerated(&table, to, &messages, temperature);
            assert_close(message(&table, to, &messages, &form).logs(), &expected);
            let any: Vec<AnyMessage> = messages.iter().cloned().map(AnyMessage::from_categorical).collect();
            let sent = message(&table, to, &any, &AnyForm::Categorical(form));
            assert_close(sent.categorical().unwrap().logs(), &expected);
        }
        let mut question = LocalEvidence::default();
        messages.iter().for_each(|message| question.logs.extend_from_slice(message.logs()));
        prop_assert!(Factor::<Categorical>::answer(&table, &mut question));
        let to_first = enumerated(&table, 0, &messages, 1.0);
        // Up to the constant that normalising takes: compare with a table of the whole product.
        let mut terms = Vec::new();
        for (index, log) in table.logs().iter().enumerate() {
            let (mut rest, mut sum) = (index, *log);
            for port in (0..messages.len()).rev() {
                sum += messages[port].logs()[rest % messages[port].states()];
                rest /= messages[port].states();
            }
            terms.push(sum);
        }
        prop_assert!(!to_first.is_empty());
        let expected = table.peak() + log_sum(&terms, 1.0);
        prop_assert!((question.log_sum - expected).abs() < 1e-11 * (1.0 + expected.abs()));
    }

    #[test]
    fn large_pairs_send_what_enumeration_finds(
        (rows, columns) in prop_oneof![Just((50, 50)), Just((9, 33)), Just((70, 3)), Just((1, 20))],
        symmetric in any::<bool>(),
        depth in prop_oneof![Just(5.0), Just(500.0), Just(3000.0)],
        zeros in prop_oneof![Just(0), Just(3), Just(40)],
        temperature in prop_oneof![Just(0.0), Just(1.0), Just(0.5)],
        seed in 0_u64..1000,
    ) {
        let mut draw = draws(seed);
        let mut logs: Vec<f64> = (0..rows * columns).map(|_| -depth * draw()).collect();
        if symmetric && rows == columns {
            (0..rows).for_each(|i| (0..i).for_each(|j| logs[i * columns + j] = logs[j * columns + i]));
        }
        for _ in 0..zeros {
            let place = (draw() * logs.len() as f64) as usize;
            logs[place] = f64::NEG_INFINITY;
        }
        let Ok(table) = Table::from_logs(&[rows, columns], logs) else { return Ok(()) };
        let mut states = |n: usize| -> Vec<f64> { (0..n).map(|_| -depth * draw()).collect() };
        let messages = [rows, columns].map(|n| Categorical::new(&states(n)).unwrap());
        for to in 0..2 {
            let expected = enumerated(&table, to, &messages, temperature);
            let found = message(&table, to, &messages, &CategoricalForm { temperature });
            assert_close(found.logs(), &expected);
        }
    }

    #[test]
    fn logical_factors_are_their_tables(
        ports in 2_usize..7,
        kind in 0_usize..5,
        odds in prop::collection::vec(prop_oneof![8 => -6.0..6.0_f64, 1 => Just(0.0), 1 => 30.0..60.0], 7),
        certain in 0_usize..20,
        temperature in prop_oneof![Just(0.0), Just(1.0), 0.3..2.0],
    ) {
        let factor = match kind {
            0 => Logical::or(ports),
            1 => Logical::and(ports),
            2 => Logical::at_most_one(ports),
            odd => Logical::parity(ports, odd == 3),
        }.unwrap();
        let mut question = Tabulation::new(1 << ports);
        prop_assert!(Factor::<Categorical>::answer(&factor, &mut question));
        let table = question.table.unwrap();
        let form = CategoricalForm { temperature };
        let mut messages: Vec<LogOdds> = odds[..ports].iter().map(|&odds| LogOdds(odds)).collect();
        if certain < ports {
            messages[certain] = LogOdds(f64::NEG_INFINITY);
        }
        let as_states = |message: &LogOdds| {
            let mut logs = [0.0; 2];
            message.read_logs(&mut logs);
            Categorical::new(&logs).unwrap()
        };
        let states: Vec<Categorical> = messages.iter().map(as_states).collect();
        let variables: Vec<u32> = (0..ports as u32).collect();
        let mut all = vec![LogOdds(0.0); ports];
        let forms = vec![form; ports];
        let incoming = Incoming::new(&messages, &messages, &variables);
        let streams = MessageStreams::new(1, 0, 0);
        factor.all_messages_into(&incoming, &forms, streams, &mut all).unwrap();
        for (to, all) in all.iter().enumerate() {
            let expected = enumerated(&table, to, &states, temperature);
            let by_odds = as_states(&message(&factor, to, &messages, &form));
            assert_close(by_odds.logs(), &expected);
            assert_close(as_states(all).logs(), &expected);
            assert_close(message(&factor, to, &states, &form).logs(), &expected);
        }
        let mut logs = LocalEvidence::default();
        let mut by_table = LocalEvidence::default();
        for question in [&mut logs, &mut by_table] {
            states.iter().for_each(|message| question.logs.extend_from_slice(message.logs()));
        }
        Factor::<Categorical>::answer(&factor, &mut logs);
        Factor::<Categorical>::answer(&table, &mut by_table);
        prop_assert!((logs.log_sum - by_table.log_sum).abs() < 1e-11 || logs.log_sum == by_table.log_sum);
    }

    #[test]
    fn pairs_of_odds_are_their_tables(
        logs in prop::collection::vec(-40.0..40.0_f64, 4),
        odds in prop::array::uniform2(prop_oneof![6 => -50.0..50.0_f64, 1 => Just(f64::INFINITY), 1 => Just(f64::NEG_INFINITY)]),
        temperature in prop_oneof![Just(0.0), Just(1.0), 0.3..2.0],
    ) {
        let table = Table::from_logs(&[2, 2], logs).unwrap();
        let pair = PairOdds::from_table(&table).unwrap();
        let (form, messages) = (CategoricalForm { temperature }, odds.map(LogOdds));
        let mut graph = FactorGraph::<LogOdds, PairOdds>::new();
        let ends = [0, 1].map(|k| {
            let variable = graph.unnamed_variable(Space::finite(2));
            graph.set_prior(variable, messages[k]).unwrap();
            variable
        });
        // Enough of them that the loop over lanes has a whole chunk and a rest.
        for _ in 0..35 {
            let factor = graph.factor("", pair, &ends).unwrap();
            (0..2).for_each(|port| graph.set_edge_form(factor, port, form).unwrap());
        }
        let mut engine = Engine::new(&graph, Options { max_iterations: 1, ..Options::default() }).unwrap();
        engine.run(&mut Flooding).unwrap();
        let topology = engine.topology().clone();
        for factor in graph.factor_ids() {
            for (to, edge) in topology.edges_of_factor(factor).enumerate() {
                let expected = message(&table, to, &messages, &form).0;
                for found in [engine.message(edge).0, message(&pair, to, &messages, &form).0] {
                    prop_assert!((found - expected).abs() < 1e-12 * (1.0 + expected.abs() + 80.0), "{found} {expected}");
                }
            }
        }
    }
}

#[test]
fn a_tree_of_states_is_exact_by_every_schedule_and_family() {
    // a - b - c with a prior, by enumeration.
    let (pa, pab, pbc) = ([0.3, 0.7], [0.9, 0.1, 0.4, 0.6], [0.2, 0.8, 0.5, 0.5]);
    let mut exact = [[0.0; 2]; 3];
    for index in 0..8 {
        let [a, b, c] = [index >> 2 & 1, index >> 1 & 1, index & 1];
        let p = pa[a] * pab[2 * a + b] * pbc[2 * b + c];
        exact[0][a] += p;
        exact[1][b] += p;
        exact[2][c] += p;
    }
    let total: f64 = exact[0].iter().sum();
    fn graph<M: CategoricalFamily>(tables: &[Arc<Table>; 3]) -> FactorGraph<M> {
        let mut graph = FactorGraph::<M>::new();
        let ids: Vec<_> = ["a", "b", "c"].map(|n| graph.variable(n, Space::finite(2)).unwrap()).into();
        graph.factor("prior", Box::new(tables[0].clone()), &ids[..1]).unwrap();
        graph.factor("step", Box::new(tables[1].clone()), &ids[..2]).unwrap();
        graph.factor("step", Box::new(tables[2].clone()), &ids[1..]).unwrap();
        graph
    }
    let table = |cards: &[usize], values: &[f64]| Arc::new(Table::new(cards, values.to_vec()).unwrap());
    let tables = [table(&[2], &pa), table(&[2, 2], &pab), table(&[2, 2], &pbc)];
    fn check<M: CategoricalFamily>(tables: &[Arc<Table>; 3], exact: &[[f64; 2]; 3], total: f64) {
        let graph = graph::<M>(tables);
        for schedule in 0..3 {
            let mut engine = Engine::new(&graph, Options::default()).unwrap();
            let report = match schedule {
                0 => engine.run(&mut Flooding),
                1 => engine.run(&mut ForwardBackward::new()),
                _ => engine.run(&mut Residual::default()),
            };
            assert!(report.unwrap().converged());
            for (variable, exact) in graph.variable_ids().zip(exact) {
                let mut logs = [0.0; 2];
                engine.belief(variable).read_logs(&mut logs);
                let odds = (exact[1] / total).ln() - (exact[0] / total).ln();
                assert!((logs[1] - logs[0] - odds).abs() < 1e-12);
            }
        }
    }
    check::<Categorical>(&tables, &exact, total);
    check::<LogOdds>(&tables, &exact, total);
    check::<AnyMessage>(&tables, &exact, total);
}

/// A grid with random tables: damped, broadcast and plain flooding say the same whatever the family and the threads.
#[test]
fn families_and_threads_agree_on_a_grid_with_loops() {
    const SIDE: usize = 40;
    fn beliefs<M: CategoricalFamily>(damping: f64, outgoing: Outgoing, parallel: bool) -> Vec<f64> {
        let mut random = Stream::new(3, 0, Purpose::World, 0).fast();
        let mut table = |cards: &[usize]| {
            let logs = (0..cards.iter().product()).map(|_| 1.6 * random.random::<f64>() - 0.8).collect();
            Box::new(Table::from_logs(cards, logs).unwrap())
        };
        let mut graph = FactorGraph::<M>::new();
        let ids: Vec<_> = (0..SIDE * SIDE).map(|_| graph.unnamed_variable(Space::finite(2))).collect();
        for (k, &id) in ids.iter().enumerate() {
            graph.factor("own", table(&[2]), &[id]).unwrap();
            if k % SIDE + 1 < SIDE {
                graph.factor("beside", table(&[2, 2]), &[id, ids[k + 1]]).unwrap();
            }
            if k + SIDE < SIDE * SIDE {
                graph.factor("below", table(&[2, 2]), &[id, ids[k + SIDE]]).unwrap();
            }
        }
        let options =
            Options { max_iterations: 7, tolerance: 0.0, damping, outgoing, parallel, ..Options::default() };
        let mut engine = Engine::new(&graph, options).unwrap();
        engine.run(&mut Flooding).unwrap();
        let odds = |id| {
            let mut logs = [0.0; 2];
            engine.belief(id).read_logs(&mut logs);
            logs[1] - logs[0]
        };
        ids.iter().map(|&id| odds(id)).collect()
    }
    for (damping, outgoing) in
        [(0.0, Outgoing::Extrinsic), (0.3, Outgoing::Extrinsic), (0.3, Outgoing::Broadcast)]
    {
        let states = beliefs::<Categorical>(damping, outgoing, false);
        let odds = beliefs::<LogOdds>(damping, outgoing, false);
        assert_eq!(states, beliefs::<Categorical>(damping, outgoing, true));
        assert_eq!(odds, beliefs::<LogOdds>(damping, outgoing, true));
        let any = beliefs::<AnyMessage>(damping, outgoing, false);
        assert_eq!(any, beliefs::<AnyMessage>(damping, outgoing, true));
        for ((states, odds), any) in states.iter().zip(&odds).zip(&any) {
            assert!((states - odds).abs() < 1e-10 && (states - any).abs() < 1e-10, "{states} {odds} {any}");
        }
    }
}

/// Users write the least number for what is impossible: its logarithm divides out like any other, or is told.
#[test]
fn the_least_number_as_an_impossible_state_is_no_failure_of_the_engine() {
    let mut graph = FactorGraph::<Categorical>::new();
    let ids = ["x", "y"].map(|name| graph.variable(name, Space::finite(3)).unwrap());
    graph.set_prior(ids[0], Categorical::from_probabilities(&[0.5, 0.5, 0.0]).unwrap()).unwrap();
    let forbidden = |x: usize| if x < 2 { f64::MIN } else { 0.0 };
    let logs: Vec<f64> = (0..9).map(|index| forbidden(index / 3)).collect();
    graph.factor("forbidding", Box::new(Table::from_logs(&[3, 3], logs).unwrap()), &ids).unwrap();
    graph.factor("flat", Box::new(Table::from_logs(&[3, 3], vec![0.0; 9]).unwrap()), &ids).unwrap();
    let mut engine = Engine::new(&graph, Options { max_iterations: 6, ..Options::default() }).unwrap();
    engine.run(&mut Flooding).unwrap();
    let found = engine.belief(ids[0]).probabilities();
    assert!((found[0] - 0.5).abs() < 1e-12 && found[2] == 0.0, "{found:?}");
}

#[test]
fn contradictions_are_told_and_not_answered() {
    fn run<M: CategoricalFamily>() -> String {
        let mut graph = FactorGraph::<M>::new();
        let x = graph.variable("x", Space::finite(2)).unwrap();
        for values in [vec![1.0, 0.0], vec![0.0, 1.0]] {
            graph.factor("certain", Box::new(Table::new(&[2], values).unwrap()), &[x]).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut Flooding).unwrap_err().to_string()
    }
    for said in [run::<Categorical>(), run::<LogOdds>(), run::<AnyMessage>()] {
        assert!(said.contains("\"x\"") && said.contains("rules out every state"), "{said}");
    }
}

#[test]
fn zeros_pass_through_loops() {
    // Three variables that must be equal, around a loop, one of them known.
    let equal = Arc::new(Table::new(&[3, 3], vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]).unwrap());
    let mut graph = FactorGraph::<Categorical>::new();
    let ids: Vec<_> = (0..3).map(|_| graph.unnamed_variable(Space::finite(3))).collect();
    for k in 0..3 {
        graph.factor("equal", Box::new(equal.clone()), &[ids[k], ids[(k + 1) % 3]]).unwrap();
    }
    graph.set_prior(ids[1], Categorical::certain(3, 2).unwrap()).unwrap();
    for damping in [0.0, 0.5] {
        let mut engine = Engine::new(&graph, Options { damping, ..Options::default() }).unwrap();
        assert!(engine.run(&mut Flooding).unwrap().converged());
        for &id in &ids {
            assert_eq!(engine.belief(id).probabilities(), [0.0, 0.0, 1.0]);
        }
    }
}

#[test]
fn wrong_tables_and_forms_are_refused_in_words() {
    let said = |result: Result<Table, TableError>| result.unwrap_err().to_string();
    assert!(said(Table::new(&[2, 3], vec![1.0; 5])).contains("has 6 entries, but 5 values"));
    assert!(said(Table::new(&[2, 2], vec![1.0, 2.0, -0.5, 1.0])).contains("entry 2 (states [1, 0]) is -0.5"));
    assert!(said(Table::new(&[2], vec![0.0; 2])).contains("every entry of the table is zero"));
    assert!(said(Table::new(&[2, 0], vec![])).contains("port 1 of a table has no state"));
    assert!(said(Table::new(&[], vec![1.0])).contains("no port"));
    assert!(said(Table::new(&[usize::MAX, 3], vec![1.0])).contains("more entries than can be addressed"));
    assert!(said(Table::from_logs(&[2], vec![f64::NAN, 0.0])).contains("is NaN"));
    let zero = Table::new(&[2, 2], vec![1.0, 0.0, 1.0, 1.0]).unwrap();
    assert!(PairOdds::from_table(&zero).unwrap_err().to_string().contains("entry 1 of the table is zero"));
    assert!(PairOdds::new([0.0; 2], 700.0).unwrap_err().to_string().contains("coupling of 700"));
    assert!(Logical::or(1).unwrap_err().to_string().contains("or needs at least 2 ports, not 1"));

    let mut graph = FactorGraph::<Categorical>::new();
    let x = graph.variable("x", Space::finite(3)).unwrap();
    let error = graph.factor("pair", Box::new(zero), &[x, x]).unwrap_err().to_string();
    assert!(error.contains("takes dimension 2") && error.contains("\"x\" has dimension 3"), "{error}");
    let table = Table::new(&[3], vec![1.0; 3]).unwrap();
    let factor = graph.factor("one", Box::new(table), &[x]).unwrap();
    let error = graph.set_edge_form(factor, 0, CategoricalForm { temperature: -1.0 }).unwrap_err();
    assert!(error.to_string().contains("the temperature is -1"), "{error}");
    assert!(LogOdds::check_form(&FORM, &Space::finite(3)).unwrap_err().contains("this one has 3"));
    assert!(Categorical::check_form(&FORM, &Space::real(1)).is_err());
    let contrary = Categorical::new(&[f64::NEG_INFINITY; 2]);
    assert!(matches!(contrary, Err(MessageError::Impossible { .. })));
}
