//! Every sampler against enumeration: mean, covariance and mode masses within noise, or the bias that it states.

use crate::common::{enumerated, mixture, stream};
use sumprod_graph::Space;
use sumprod_messages::{
    Gibbs, GibbsStart, Literal, Mixture, MultiscaleGibbs, Pairwise, Pointwise, Product, ProductChoice,
    ProductMethod, modes,
};

const SAMPLES: usize = 4000;

/// Mean and variances within four standard errors at the effective sample size; over the axes and methods of one
/// test a failure by chance once in 400 seeds.
fn assert_moments(product: &Product, inputs: &[&Mixture], what: &str) {
    let (_, exact) = enumerated(inputs);
    let found = product.particles.moments();
    let effective = product.quality.effective_sample_size.min(product.particles.len() as f64);
    for k in 0..exact.dimension() {
        let variance = exact.covariance_at(k, k);
        let error = (found.mean[k] - exact.mean[k]).abs() / (variance / effective).sqrt();
        assert!(error < 4.0, "{what}: mean {k} is {error} standard errors off");
        let error = (found.covariance_at(k, k) / variance - 1.0).abs() / (2.5 / effective).sqrt();
        assert!(error < 4.0, "{what}: variance {k} is {error} standard errors off");
    }
}

#[test]
fn every_sampler_is_right_where_messages_overlap() {
    for d in [1, 2] {
        let inputs: Vec<Mixture> = (0..3).map(|l| mixture(80 + l, d, 15, 0.7, 1.0, l != 1)).collect();
        let references: Vec<&Mixture> = inputs.iter().collect();
        for choice in [
            ProductChoice::Exact,
            ProductChoice::Gibbs,
            ProductChoice::AnnealedGibbs,
            ProductChoice::MultiscaleGibbs,
            ProductChoice::MixtureImportance,
            ProductChoice::GaussianImportance,
            ProductChoice::Pairwise,
            ProductChoice::Auto,
        ] {
            let product = choice.method().product(&references, SAMPLES, &mut stream(1)).unwrap();
            assert_moments(&product, &references, &format!("{choice:?}, d = {d}"));
            assert!(product.quality.divergence.unwrap() < 1.0, "{choice:?}: {:?}", product.quality);
            let (log_normaliser, _) = enumerated(&references);
            assert!((product.log_normaliser.unwrap() - log_normaliser).abs() < 0.15, "{choice:?}");
        }
    }
}

/// Two modes each, far apart, one pair lined up well and one badly: the masses of the product's modes.
fn two_modes() -> Vec<Mixture> {
    let space = Space::real(1);
    let build = |offset: f64, share: f64| {
        let mut means = Vec::new();
        let mut log_weights = Vec::new();
        for i in 0..20 {
            let place = 0.15 * f64::from(i) - 1.5;
            means.extend([-6.0 + place, 6.0 + place * 0.7 + offset]);
            log_weights.extend([share.ln(), (1.0 - share).ln()]);
        }
        Mixture::with_shared_covariance(&space, log_weights, means, vec![0.3]).unwrap()
    };
    vec![build(0.0, 0.3), build(0.8, 0.6), build(0.4, 0.5)]
}

#[test]
fn mode_masses_are_right_but_for_the_samplers_that_cannot_know_them() {
    let inputs = two_modes();
    let references: Vec<&Mixture> = inputs.iter().collect();
    let (_, exact) = enumerated(&references);
    // Two clusters far apart: the mean gives the mass of the left one.
    let reference = ProductChoice::Exact.method().product(&references, 20_000, &mut stream(2)).unwrap();
    let found = modes(&references, &reference.particles).unwrap();
    let left = |product: &Product| {
        let particles = &product.particles;
        let weights = particles.weights();
        (0..particles.len()).filter(|&i| particles.point(i)[0] < 0.0).map(|i| weights[i]).sum::<f64>()
    };
    let mass = left(&reference);
    assert!((0.1..0.9).contains(&mass) && found.len() >= 2, "{mass} {exact:?}");
    for choice in [
        ProductChoice::Pairwise,
        ProductChoice::MixtureImportance,
        ProductChoice::MultiscaleGibbs,
        ProductChoice::Auto,
    ] {
        let product = choice.method().product(&references, SAMPLES, &mut stream(3)).unwrap();
        let effective = product.quality.effective_sample_size.min(SAMPLES as f64);
        let error = (left(&product) - mass).abs() / (mass * (1.0 - mass) / effective).sqrt();
        assert!(error < 4.0, "{choice:?}: the left mode's mass is {error} standard errors off");
    }
    // Stated bias: single labels cannot cross, so masses are those of the start, and independent starts that
    // disagree end anywhere; from the roots of the trees it is the roots that decide.
    let independent = Gibbs { start: GibbsStart::Independent, ..Gibbs::default() };
    let roots = MultiscaleGibbs { sweeps: 1, enumerate: 1 };
    for biased in [&independent as &dyn ProductMethod, &roots] {
        let error = (left(&biased.product(&references, SAMPLES, &mut stream(4)).unwrap()) - mass).abs();
        assert!((0.03..0.3).contains(&error), "{}: {error}", biased.name());
    }
}

#[test]
fn modes_are_counted_before_and_after() {
    let inputs = two_modes();
    let references: Vec<&Mixture> = inputs.iter().collect();
    let mut product = ProductChoice::Auto.method().product(&references, 1000, &mut stream(5)).unwrap();
    assert_eq!(product.quality.modes_after, None);
    let found = product.find_modes(&references, 300, &mut stream(6)).unwrap();
    assert_eq!(product.quality.modes_before, Some(vec![2, 2, 2]));
    assert_eq!(product.quality.modes_after, Some(2));
    assert!((found.iter().map(|mode| mode.mass).sum::<f64>() - 1.0).abs() < 1e-12);
}

#[test]
fn pointwise_products_keep_the_points() {
    let prior = mixture(90, 2, 30, 1.0, 0.4, true);
    let inputs = [mixture(91, 2, 30, 1.0, 0.4, true), mixture(92, 2, 1, 0.3, 1.0, true)];
    let carrier = prior.sample(SAMPLES, &mut stream(7)).unwrap();
    let points = carrier.points().to_vec();
    let method = Pointwise { carrier };
    let product = method.product(&[&inputs[0], &inputs[1]], 1, &mut stream(8)).unwrap();
    assert_eq!(product.particles.points(), points);
    assert_moments(&product, &[&prior, &inputs[0], &inputs[1]], "pointwise");
}

#[test]
fn a_pairwise_product_says_when_it_is_exact_and_grows_when_it_must() {
    let small: Vec<Mixture> = (0..2).map(|l| mixture(93 + l, 2, 8, 1.0, 0.3, true)).collect();
    let references: Vec<&Mixture> = small.iter().collect();
    let product = Pairwise { components: Some(64), ..Pairwise::default() }
        .product(&references, 100, &mut stream(9))
        .unwrap();
    assert_eq!(product.quality.divergence, Some(0.0));
    assert!(product.mixture.is_some());
    let narrow: Vec<Mixture> = (0..3).map(|l| mixture(95 + l, 2, 200, 1.0, 0.1, true)).collect();
    let references: Vec<&Mixture> = narrow.iter().collect();
    let start = Pairwise { components: Some(8), ..Pairwise::default() };
    let few = Pairwise { most: 8, ..start }.product(&references, 1000, &mut stream(10)).unwrap();
    let many = start.product(&references, 1000, &mut stream(10)).unwrap();
    assert!(few.quality.effective_sample_size < 500.0, "{:?}", few.quality);
    assert!(many.quality.effective_sample_size > 500.0, "{:?}", many.quality);
}

/// The printed conditional counts a component twice, which narrows the product (by 10 to 20 per cent in variance
/// where messages overlap); its leave-one-out form does not.
#[test]
fn the_literal_conditional_is_too_confident() {
    // Sixty-four kernels have the printed variance of 64^(1/6) = 2.
    let inputs: Vec<Mixture> = (0..2)
        .map(|l| {
            let means = mixture(97 + l, 1, 64, 2.0, 1.0, true).means().to_vec();
            Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 64], means, vec![2.0]).unwrap()
        })
        .collect();
    let references: Vec<&Mixture> = inputs.iter().collect();
    let (_, exact) = enumerated(&references);
    let variance = |counted_twice: bool| {
        let literal = Literal { sweeps: 20, start: GibbsStart::Independent, counted_twice };
        let product = literal.product(&references, 20_000, &mut stream(11)).unwrap();
        product.particles.moments().covariance[0] / exact.covariance[0]
    };
    assert!((variance(false) - 1.0).abs() < 4.0 * (2.0f64 / 20_000.0).sqrt());
    assert!(variance(true) < 0.97, "{}", variance(true));
}

#[test]
fn chains_that_mix_say_so() {
    let inputs: Vec<Mixture> = (0..2).map(|l| mixture(85 + l, 2, 50, 0.5, 1.0, true)).collect();
    let references: Vec<&Mixture> = inputs.iter().collect();
    let product = Gibbs::default().product(&references, 500, &mut stream(12)).unwrap();
    assert!(product.quality.label_change.unwrap() > 0.9);
    assert!(product.quality.warnings.is_empty());
}
