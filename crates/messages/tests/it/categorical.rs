//! Messages over states: what is computed with values is what is computed with logarithms.

use proptest::prelude::*;
use sumprod_graph::{Message, Messages, Purpose, Stream};
use sumprod_messages::{Categorical, CategoricalFamily, CategoricalForm};

/// Logarithms of many states, some far out of the range of doubles and some of them zeros.
fn logs(states: usize) -> impl Strategy<Value = Vec<f64>> {
    let near = prop::collection::vec(-30.0..0.0_f64, states);
    let deep = prop_oneof![8 => -30.0..0.0_f64, 1 => -2000.0..-300.0, 1 => Just(f64::NEG_INFINITY)];
    let far = prop::collection::vec(deep, states);
    (prop_oneof![near, far], 0..states).prop_map(|(mut logs, best)| {
        logs[best] = 0.0;
        logs
    })
}

/// The same messages held in different ways: as given, as logarithms alone, and, where that is possible, as values alone.
fn held(logs: &[f64]) -> Vec<Categorical> {
    let given = Categorical::new(logs).unwrap();
    let like = Categorical::default();
    let mut by_logs = Categorical::default();
    by_logs.write_logs(&like, logs).unwrap();
    let mut all = vec![given, by_logs];
    let values: Vec<f64> = logs.iter().map(|log| 3.0 * log.exp()).collect();
    let mut by_values = Categorical::default();
    if by_values.write_values(&like, &values).unwrap() {
        all.push(by_values);
    } else {
        assert!(logs.iter().any(|log| *log < -600.0));
    }
    all
}

fn product(messages: &[Categorical]) -> Result<Categorical, String> {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    let mut stream = Stream::new(1, 0, Purpose::Belief, 0);
    let messages = Messages::new(messages, &edges);
    Categorical::product(messages, &CategoricalForm::default(), &mut stream)
        .map_err(|error| error.to_string())
}

fn assert_logs(found: &Categorical, expected: &[f64]) {
    let largest = expected.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    for (a, b) in found.logs().iter().zip(expected) {
        let b = b - largest;
        assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()) || *a == b, "{found:?} {expected:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn values_and_logarithms_agree(
        (a, b, c) in prop_oneof![Just(2), Just(3), Just(8), Just(17), Just(50)].prop_flat_map(|n| (logs(n), logs(n), logs(n))),
        damping in 0.0..0.9_f64,
    ) {
        let sum: Vec<f64> = a.iter().zip(&b).zip(&c).map(|((a, b), c)| a + b + c).collect();
        let possible = sum.iter().any(|log| *log > f64::NEG_INFINITY);
        for a in held(&a) {
            for b in held(&b) {
                let c = Categorical::new(&c).unwrap();
                let Ok(belief) = product(&[a.clone(), b.clone(), c.clone()]) else {
                    prop_assert!(!possible);
                    continue;
                };
                assert_logs(&belief, &sum);
                // Dividing what was multiplied in, wherever nothing is ruled out by it.
                let mut rest = Categorical::default();
                let divisible = b.logs().iter().all(|log| log.is_finite());
                prop_assert_eq!(b.can_be_divided_out(), divisible);
                prop_assert_eq!(belief.quotient_into(&b, &mut rest), divisible);
                if divisible {
                    let expected: Vec<f64> = sum.iter().zip(b.logs()).map(|(sum, b)| sum - b).collect();
                    assert_logs(&rest, &expected);
                }
                // A move is measured, and damped, in logarithms.
                let moved = a.change(&b);
                let seen = |(x, y): &(&f64, &f64)| x.max(**y) > -36.0;
                let far = a.logs().iter().zip(b.logs()).filter(seen).map(|(x, y)| (x - y).abs());
                let far = far.fold(0.0, f64::max).min(700.0);
                prop_assert!((moved - far).abs() < 1e-12 * (1.0 + far), "{moved} {far}");
                let mut damped = a.clone();
                prop_assert!(damped.damp(&b, damping));
                let mixed: Vec<f64> =
                    a.logs().iter().zip(b.logs()).map(|(x, y)| (1.0 - damping) * x + damping * y).collect();
                if mixed.iter().any(|log| log.is_finite()) {
                    assert_logs(&damped, &mixed);
                }
                prop_assert_eq!(a.change(&a), 0.0);
            }
        }
    }

    #[test]
    fn what_is_written_is_read_bit_for_bit(logs in prop_oneof![logs(2), logs(9), logs(50)]) {
        for message in held(&logs) {
            let text = serde_json::to_string(&message).unwrap();
            let read: Categorical = serde_json::from_str(&text).unwrap();
            let other = Categorical::new(&logs).unwrap();
            prop_assert_eq!(&read, &message);
            prop_assert_eq!(product(&[read, other.clone()]), product(&[message, other]));
        }
    }
}

#[test]
fn what_is_no_message_is_refused_in_words() {
    let refused = |text: &str| serde_json::from_str::<Categorical>(text).unwrap_err().to_string();
    assert!(refused(r#"{"values": [1.0, 0.0]}"#).contains("a value of a message over states is 0"));
    assert!(
        refused(r#"{"logs": [0.0, null], "values": [1.0]}"#).contains("logs of 2 states and values of 1")
    );
    assert!(refused("{}").contains("neither logs nor values"));
    let (mut message, like) = (Categorical::default(), Categorical::default());
    for wrong in [[1.0, f64::NAN], [0.0, 1.0], [1.0, f64::INFINITY], [1e-200, 1e100], [-1.0, 1.0]] {
        assert!(!message.write_values(&like, &wrong).unwrap(), "{wrong:?}");
    }
}
