use proptest::prelude::*;

use super::super::candidates::Candidates;
use super::super::{AssociationError, Pair, Tracks, global_nearest, nearest};

fn worth(pairs: &[Pair], gate: f64) -> f64 {
    pairs.iter().map(|pair| gate * gate - pair.distance * pair.distance).sum()
}

/// Largest worth over all one-to-one choices of pairs within the gate.
fn best(first: &[[f64; 2]], second: &[[f64; 2]], gate: f64, taken: &mut Vec<bool>) -> f64 {
    let Some(([x, y], rest)) = first.split_first() else { return 0.0 };
    let mut most = best(rest, second, gate, taken);
    for n in 0..second.len() {
        let distance = (x - second[n][0]).hypot(y - second[n][1]);
        if distance < gate && !taken[n] {
            taken[n] = true;
            most = most.max(gate * gate - distance * distance + best(rest, second, gate, taken));
            taken[n] = false;
        }
    }
    most
}

fn places(most: usize) -> impl Strategy<Value = Vec<[f64; 2]>> {
    prop::collection::vec([0.0..4.0, 0.0..4.0], 0..=most)
}

proptest! {
    #[test]
    fn the_assignment_is_the_best_of_all(first in places(6), second in places(6), gate in 0.2_f64..5.0) {
        let (a, b) = (Tracks::planar(&first).unwrap(), Tracks::planar(&second).unwrap());
        let found = global_nearest(&a, &b, gate).unwrap();
        let wanted = best(&first, &second, gate, &mut vec![false; second.len()]);
        prop_assert!((worth(&found, gate) - wanted).abs() < 1e-9 * (1.0 + wanted));
        let mut taken: Vec<usize> = found.iter().map(|pair| pair.second).collect();
        taken.sort_unstable();
        taken.dedup();
        prop_assert_eq!(taken.len(), found.len());
        prop_assert!(found.is_sorted_by(|a, b| a.first < b.first));
    }

    #[test]
    fn the_nearest_is_the_nearest(first in places(8), second in places(8), gate in 0.2_f64..5.0) {
        let (a, b) = (Tracks::planar(&first).unwrap(), Tracks::planar(&second).unwrap());
        let found = nearest(&a, &b, gate).unwrap();
        for (m, place) in first.iter().enumerate() {
            let distance = |other: &[f64; 2]| (place[0] - other[0]).hypot(place[1] - other[1]);
            let least = second.iter().map(distance).fold(f64::INFINITY, f64::min);
            let pair = found.iter().find(|pair| pair.first == m);
            prop_assert_eq!(pair.is_some(), least < gate);
            prop_assert!(pair.is_none_or(|pair| (pair.distance - least).abs() < 1e-12));
        }
    }

    #[test]
    fn candidates_are_all_within_the_radius(
        first in places(20), second in places(20), radius in 0.1_f64..6.0, shift in -1e6_f64..1e6,
    ) {
        let far = |places: &[[f64; 2]]| -> Vec<[f64; 2]> {
            places.iter().map(|place| place.map(|x| x + shift)).collect()
        };
        let (first, second) = (far(&first), far(&second));
        let [a, b] = [&first, &second].map(|places| Tracks::planar(places).unwrap());
        let found = Candidates::collect(&a, &b, radius, usize::MAX).unwrap();
        let found: Vec<(usize, usize)> = found.pairs().map(|(_, m, n)| (m, n)).collect();
        let mut wanted = Vec::new();
        for (n, x) in second.iter().enumerate() {
            for (m, y) in first.iter().enumerate() {
                if (x[0] - y[0]).powi(2) + (x[1] - y[1]).powi(2) <= radius * radius {
                    wanted.push((m, n));
                }
            }
        }
        prop_assert_eq!(found, wanted);
    }
}

#[test]
fn an_allowance_is_kept_by_taking_the_nearest() {
    let line: Vec<[f64; 2]> = (0..100).map(|i| [f64::from(i), 0.0]).collect();
    let tracks = Tracks::planar(&line).unwrap();
    let found = Candidates::within(&tracks, &tracks, f64::INFINITY, 1000).unwrap();
    assert!((400..=1000).contains(&found.len()), "{}", found.len());
    assert!(found.pairs().all(|(_, m, n)| m.abs_diff(n) <= 5));
}

#[test]
fn one_long_chain_of_competitors_is_solved() {
    let places = |offset: f64| -> Tracks {
        let line: Vec<[f64; 2]> = (0..300).map(|i| [f64::from(i) + offset, 0.0]).collect();
        Tracks::planar(&line).unwrap()
    };
    // All but the first have one 0.4 behind; 299 times 1.28 is worth more than 300 times 1.08.
    let found = global_nearest(&places(0.0), &places(0.6), 1.2).unwrap();
    assert_eq!(found.len(), 299);
    assert!(found.iter().all(|pair| pair.first == pair.second + 1));
}

#[test]
fn what_would_not_fit_is_refused_with_its_size() {
    let places = vec![[0.0, 0.0]; 4100];
    let tracks = Tracks::planar(&places).unwrap();
    let error = global_nearest(&tracks, &tracks, 1.0).unwrap_err();
    assert!(matches!(error, AssociationError::Crowded { first: 4100, second: 4100, .. }));
    assert!(error.to_string().ends_with("narrow the gate"));
}
