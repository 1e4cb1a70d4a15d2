//! The law of Gibbs labels after few sweeps, against the exact law of the chain on the tensor of all label choices.

use crate::common::{all_labels, choice, mixture, stream};
use std::collections::HashMap;
use sumprod_messages::{Gibbs, GibbsStart, Mixture, MultiscaleGibbs};

const CHAINS: usize = 100_000;

/// The exact law after the start and `sweeps` sweeps, choice by choice in the order of `all_labels`.
fn law(inputs: &[&Mixture], start: GibbsStart, sweeps: usize) -> Vec<f64> {
    let all = all_labels(inputs);
    let weights: Vec<f64> = all.iter().map(|labels| choice(inputs, labels).0.exp()).collect();
    let mut law: Vec<f64> = match start {
        GibbsStart::Independent => all
            .iter()
            .map(|labels| inputs.iter().zip(labels).map(|(input, &i)| input.log_weights()[i].exp()).product())
            .collect(),
        GibbsStart::Sequential => {
            let mut law: HashMap<Vec<usize>, f64> = HashMap::from([(Vec::new(), 1.0)]);
            for l in 0..inputs.len() {
                let mut next = HashMap::new();
                for (labels, mass) in law {
                    let longer: Vec<Vec<usize>> =
                        (0..inputs[l].len()).map(|i| [labels.as_slice(), &[i]].concat()).collect();
                    let logs: Vec<f64> =
                        longer.iter().map(|labels| choice(&inputs[..=l], labels).0.exp()).collect();
                    let total: f64 = logs.iter().sum();
                    next.extend(
                        longer.into_iter().zip(logs).map(|(labels, weight)| (labels, mass * weight / total)),
                    );
                }
                law = next;
            }
            all.iter().map(|labels| law[labels]).collect()
        }
    };
    for _ in 0..sweeps {
        for l in 0..inputs.len() {
            let key = |labels: &[usize]| -> Vec<usize> {
                labels.iter().enumerate().filter(|(k, _)| *k != l).map(|(_, &i)| i).collect()
            };
            let mut groups: HashMap<Vec<usize>, (f64, f64)> = HashMap::new();
            for (labels, (mass, weight)) in all.iter().zip(law.iter().zip(&weights)) {
                let group = groups.entry(key(labels)).or_default();
                group.0 += mass;
                group.1 += weight;
            }
            for (labels, (mass, weight)) in all.iter().zip(law.iter_mut().zip(&weights)) {
                let group = groups[&key(labels)];
                *mass = group.0 * weight / group.1;
            }
        }
    }
    law
}

/// The probability of a deviation from `law` as large as that of `labels`; cells of fewer than eight are pooled.
fn agreement(inputs: &[&Mixture], labels: &[u32], law: &[f64]) -> f64 {
    let mut counts = vec![0.0; law.len()];
    let chains = labels.len() / inputs.len();
    for chain in labels.chunks(inputs.len()) {
        let cell = chain.iter().zip(inputs).fold(0, |cell, (&i, input)| cell * input.len() + i as usize);
        counts[cell] += 1.0;
    }
    let (mut statistic, mut cells, mut pooled) = (0.0, 0.0, (0.0, 0.0));
    for (count, mass) in counts.iter().zip(law) {
        let expected = mass * chains as f64;
        if expected < 8.0 {
            pooled = (pooled.0 + count, pooled.1 + expected);
            continue;
        }
        statistic += (count - expected).powi(2) / expected;
        cells += 1.0;
    }
    if pooled.1 > 8.0 {
        statistic += (pooled.0 - pooled.1).powi(2) / pooled.1;
        cells += 1.0;
    }
    chi_square_tail(statistic, cells - 1.0)
}

/// P(χ² > x) with `degrees` of freedom, by the cube root of Wilson and Hilferty (1931): within 1e-4 for ten degrees
/// and more.
fn chi_square_tail(x: f64, degrees: f64) -> f64 {
    let scale = 2.0 / (9.0 * degrees);
    let z = ((x / degrees).cbrt() - (1.0 - scale)) / scale.sqrt();
    // Abramowitz and Stegun 7.1.26.
    let t = 1.0 / (1.0 + 0.327_591_1 * z.abs() / std::f64::consts::SQRT_2);
    let coefficients = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let series = coefficients.iter().fold(0.0, |sum, coefficient| (sum + coefficient) * t);
    let tail = 0.5 * series * (-0.5 * z * z).exp();
    if z > 0.0 { tail } else { 1.0 - tail }
}

fn families() -> Vec<Vec<Mixture>> {
    vec![
        // Overlapping, disagreeing and narrow; one and two coordinates; one covariance or each its own.
        (0..2).map(|l| mixture(100 + l, 1, 10, 1.0, 0.5, true)).collect(),
        (0..3).map(|l| mixture(110 + l, 1, 8, 1.5, 0.4, false)).collect(),
        (0..2).map(|l| mixture(120 + l, 1, 10, 1.0, 0.15, true)).collect(),
        (0..3).map(|l| mixture(130 + l, 2, 7, 1.0, 0.7, false)).collect(),
        (0..4).map(|l| mixture(140 + l, 2, 4, 1.0, 0.7, true)).collect(),
        (0..2).map(|l| mixture(150 + l, 3, 40, 1.0, 1.0, l == 0)).collect(),
    ]
}

/// Thirty-six tests at 1e-3 each: by chance one fails in three per cent of seeds.
#[test]
fn labels_have_the_exact_law_after_few_sweeps() {
    for (number, family) in families().iter().enumerate() {
        let inputs: Vec<&Mixture> = family.iter().collect();
        for start in [GibbsStart::Sequential, GibbsStart::Independent] {
            for sweeps in [1, 2, 5] {
                let law = law(&inputs, start, sweeps);
                assert!((law.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                let labels = Gibbs { sweeps, start }
                    .labels(&inputs, CHAINS, &mut stream(200 + sweeps as u64))
                    .unwrap();
                let p = agreement(&inputs, &labels, &law);
                assert!(p > 1e-3, "family {number}, {start:?}, {sweeps} sweeps: p = {p:e}");
            }
        }
    }
}

/// The test has teeth: the law of one sweep more is rejected.
#[test]
fn the_law_of_another_number_of_sweeps_is_rejected() {
    let family = &families()[2];
    let inputs: Vec<&Mixture> = family.iter().collect();
    let labels =
        Gibbs { sweeps: 1, start: GibbsStart::Independent }.labels(&inputs, CHAINS, &mut stream(7)).unwrap();
    assert!(agreement(&inputs, &labels, &law(&inputs, GibbsStart::Independent, 2)) < 1e-6);
}

/// From the roots, with sweeps enough at the finest level the coarse levels are forgotten; three families mix well
/// enough for that. Where the finest level is enumerated no sweep is needed.
#[test]
fn multiscale_labels_end_in_the_products_law() {
    for (number, family) in families().iter().enumerate().filter(|(number, _)| [0, 3, 4].contains(number)) {
        let inputs: Vec<&Mixture> = family.iter().collect();
        let all = all_labels(&inputs);
        let weights: Vec<f64> = all.iter().map(|labels| choice(&inputs, labels).0.exp()).collect();
        let total: f64 = weights.iter().sum();
        let law: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
        let labels =
            MultiscaleGibbs { sweeps: 30, enumerate: 1 }.labels(&inputs, CHAINS / 4, &mut stream(9)).unwrap();
        let p = agreement(&inputs, &labels, &law);
        assert!(p > 1e-3, "family {number}: p = {p:e}");
        // The comb is fairer than chance, so that a test of independent draws passes all the more.
        let labels = MultiscaleGibbs { sweeps: 0, enumerate: 10_000 };
        let p = agreement(&inputs, &labels.labels(&inputs, CHAINS, &mut stream(10)).unwrap(), &law);
        assert!(p > 1e-3, "family {number}, enumerated: p = {p:e}");
    }
}
