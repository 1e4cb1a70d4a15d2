//! Times of flight: derivatives against finite differences, motion in flight, and what is refused.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sumprod_graph::MessageError;
use sumprod_models::library::{NodePseudoRange, PseudoRange, RoundTrip, TravelTime};
use sumprod_models::{Noise, Residual, check_residual};

const SPEED: f64 = 1500.0;

fn noise() -> Noise {
    Noise::isotropic(1, 5.0).unwrap()
}

/// Positions within a kilometre, velocities within 20 m/s, clocks within 30 m and 1 m/s.
fn state() -> impl Strategy<Value = Vec<f64>> {
    let spans = [1000.0, 20.0, 1000.0, 20.0, 1000.0, 20.0, 30.0, 1.0];
    spans.map(|span| -span..span).to_vec()
}

fn place() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(-1000.0f64..1000.0)
}

fn value<R: Residual>(residual: &R, x: &[&[f64]]) -> f64 {
    let mut out = [0.0];
    residual.residual(x, &mut out);
    out[0]
}

/// Where a state is after a time.
fn after(state: &[f64], time: f64) -> [f64; 3] {
    [0, 2, 4].map(|k| state[k] + state[k + 1] * time)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// When sound reaches a node that moves on from a state, by bisection.
fn arrival(state: &[f64], from: [f64; 3]) -> f64 {
    let (mut early, mut late) = (0.0, 10.0);
    for _ in 0..100 {
        let middle = 0.5 * (early + late);
        if distance(after(state, middle), from) > SPEED * middle {
            early = middle;
        } else {
            late = middle;
        }
    }
    early
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn derivatives(x in state(), y in state(), anchor in place(), z in 0.0f64..2000.0, age in -2.0f64..2.0) {
        prop_assume!(distance(after(&x, age), anchor) > 1.0 && distance(after(&x, 0.0), after(&y, 0.0)) > 1.0);
        let heard = PseudoRange::new(z, anchor, SPEED, noise()).unwrap();
        for heard in [heard.clone(), heard.clone().still(), heard.aged(age).unwrap()] {
            prop_assert_eq!(check_residual(&heard, &[&x], 1e-6), Ok(()));
        }
        let between = NodePseudoRange::new(z, SPEED, noise()).unwrap();
        prop_assert_eq!(check_residual(&between, &[&x, &y], 1e-6), Ok(()));
        let trip = RoundTrip::new(z, anchor, SPEED, 0.5, 8, noise()).unwrap();
        prop_assert_eq!(check_residual(&trip, &[&x], 1e-6), Ok(()));
        prop_assert_eq!(check_residual(&trip.clone().still_outward(), &[&x], 1e-6), Ok(()));
        let trip = trip.replying_from(1.0).unwrap();
        prop_assert_eq!(check_residual(&trip, &[&x, &y], 1e-6), Ok(()));
        let travel = TravelTime::new(z / SPEED, anchor, [1.0, 2.0, 3.0], 0.013, noise()).unwrap();
        prop_assert_eq!(check_residual(&travel, &[&[x[0], x[2], x[4]], &[SPEED + x[6]]], 1e-6), Ok(()));
    }

    /// The node is met where it then is, its clock read then.
    #[test]
    fn pseudo_ranges_hold_at_the_arrival(x in state(), y in state(), anchor in place(), age in -2.0f64..2.0) {
        let moved: Vec<f64> =
            x.iter().enumerate().map(|(k, &value)| if k % 2 == 0 { value + age * x[k + 1] } else { value }).collect();
        let time = arrival(&moved, anchor);
        let ahead = moved[6] + moved[7] * time;
        let heard = PseudoRange::new(SPEED * time + ahead, anchor, SPEED, noise()).unwrap();
        prop_assert!(value(&heard, &[&moved]).abs() < 1e-6);
        prop_assert!(value(&heard.aged(age).unwrap(), &[&x]).abs() < 1e-6);
        let time = arrival(&y, after(&x, 0.0));
        let between = NodePseudoRange::new(SPEED * time + y[6] + y[7] * time - x[6], SPEED, noise()).unwrap();
        prop_assert!(value(&between, &[&x, &y]).abs() < 1e-6);
    }

    /// Out, a wait, and back, seen from one state and from two of the same motion.
    #[test]
    fn round_trips_hold_at_both_ends(x in state(), anchor in place(), delay in 0.0f64..3.0, later in 0.0f64..3.0) {
        let out = arrival(&x, anchor);
        let path = SPEED * out + distance(after(&x, out + delay), anchor);
        let trip = RoundTrip::new(path, anchor, SPEED, delay, 8, noise()).unwrap();
        prop_assert!(value(&trip, &[&x]).abs() < 1e-6);
        let mut next = x.clone();
        after(&x, later).into_iter().enumerate().for_each(|(k, value)| next[2 * k] = value);
        prop_assert!(value(&trip.replying_from(later).unwrap(), &[&x, &next]).abs() < 1e-6);
    }
}

#[test]
fn a_node_that_stands_still_is_heard_at_its_distance() {
    let heard = PseudoRange::new(0.0, [0.0, 0.0, 0.0], SPEED, noise()).unwrap();
    let state = [300.0, 9.0, 400.0, 9.0, 0.0, 9.0, 15.0, 0.6];
    let expected = 500.0 * (1.0 + 0.6 / SPEED) + 15.0;
    assert!((value(&heard.clone().still(), &[&state]) - expected).abs() < 1e-9);
    assert!((value(&heard, &[&state]) - expected).abs() > 3.0);
}

#[test]
fn what_no_time_of_flight_is_made_of_is_refused() {
    let two = Noise::isotropic(2, 1.0).unwrap();
    let size = MessageError::Dimension { what: "the noise of the path", found: 2, expected: 1 };
    assert_eq!(PseudoRange::new(1.0, [0.0; 3], SPEED, two.clone()).unwrap_err(), size);
    assert_eq!(NodePseudoRange::new(1.0, SPEED, two.clone()).unwrap_err(), size);
    assert_eq!(RoundTrip::new(1.0, [0.0; 3], SPEED, 0.0, 6, two.clone()).unwrap_err(), size);
    assert_eq!(TravelTime::new(1.0, [0.0; 3], [0.0; 3], 0.0, two).unwrap_err(), size);
    assert!(PseudoRange::new(f64::NAN, [0.0; 3], SPEED, noise()).is_err());
    assert!(PseudoRange::new(1.0, [0.0, f64::INFINITY, 0.0], SPEED, noise()).is_err());
    assert!(PseudoRange::new(1.0, [0.0; 3], -1.0, noise()).is_err());
    assert!(PseudoRange::new(1.0, [0.0; 3], SPEED, noise()).unwrap().aged(f64::NAN).is_err());
    let few = MessageError::Dimension { what: "the state of a round trip", found: 4, expected: 6 };
    assert_eq!(RoundTrip::new(1.0, [0.0; 3], SPEED, 0.0, 4, noise()).unwrap_err(), few);
    assert!(RoundTrip::new(1.0, [0.0; 3], SPEED, f64::NAN, 6, noise()).is_err());
    assert!(TravelTime::new(1.0, [0.0; 3], [f64::NAN; 3], 0.0, noise()).is_err());
}
