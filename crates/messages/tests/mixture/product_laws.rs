//! Laws: the product commutes, has a flat message as identity, and agrees with enumeration by the textbook.

use crate::common::{assert_close, enumerated, mixture, stream};
use std::f64::consts::PI;
use sumprod_graph::{Coordinate, Space};
use sumprod_messages::{DynamicGaussian, Exact, Mixture, Pairwise, ProductChoice, ProductMethod};

#[test]
fn enumeration_agrees_with_the_textbook_in_any_order() {
    for (d, sizes) in
        [(1, vec![5, 7]), (1, vec![4, 3, 6, 2]), (2, vec![9, 1, 8]), (3, vec![4, 5]), (4, vec![3, 4, 1])]
    {
        for shared in [true, false] {
            let inputs: Vec<Mixture> = sizes
                .iter()
                .enumerate()
                .map(|(l, &count)| mixture(20 + l as u64, d, count, 1.0, 0.6, shared || l == 0))
                .collect();
            let mut references: Vec<&Mixture> = inputs.iter().collect();
            let (exact_log, exact) = enumerated(&references);
            for _ in 0..references.len() {
                references.rotate_left(1);
                let (product, log_normaliser) = Exact::default().mixture(&references).unwrap();
                let moments = product.moments();
                assert!((log_normaliser - exact_log).abs() < 1e-10 * exact_log.abs().max(1.0));
                assert_close(&moments.mean, &exact.mean, 1e-10);
                assert_close(&moments.covariance, &exact.covariance, 1e-10);
            }
        }
    }
}

#[test]
fn the_density_of_the_product_is_the_product_of_densities() {
    let inputs: Vec<Mixture> = (0..3).map(|l| mixture(30 + l, 2, 6, 1.0, 0.8, l == 1)).collect();
    let references: Vec<&Mixture> = inputs.iter().collect();
    let (product, log_normaliser) = Exact::default().mixture(&references).unwrap();
    for i in 0..50 {
        let x = [0.1 * f64::from(i % 7) - 0.3, 0.1 * f64::from(i / 7) - 0.3];
        let sum: f64 = references.iter().map(|input| input.log_density(&x).unwrap()).sum();
        assert!((product.log_density(&x).unwrap() - (sum - log_normaliser)).abs() < 1e-10);
    }
}

#[test]
fn one_input_is_its_own_product() {
    let only = mixture(40, 2, 12, 1.0, 0.5, true);
    let (product, log_normaliser) = Exact::default().mixture(&[&only]).unwrap();
    assert_eq!(product, only);
    assert_eq!(log_normaliser, 0.0);
    for choice in
        [ProductChoice::Auto, ProductChoice::Gibbs, ProductChoice::Pairwise, ProductChoice::MultiscaleGibbs]
    {
        let product = choice.method().product(&[&only], 500, &mut stream(1)).unwrap();
        assert_eq!(product.mixture.as_ref(), Some(&only), "{choice:?}");
        assert_eq!(product.particles.len(), 500);
    }
}

#[test]
fn a_wide_gaussian_is_nearly_the_identity() {
    let only = mixture(41, 2, 12, 1.0, 0.5, true);
    let wide =
        Mixture::with_shared_covariance(&Space::real(2), vec![0.0], vec![0.0; 2], vec![1e12, 0.0, 0.0, 1e12])
            .unwrap();
    let (product, _) = Exact::default().mixture(&[&wide, &only]).unwrap();
    let (found, exact) = (product.moments(), only.moments());
    assert_close(&found.mean, &exact.mean, 1e-10);
    assert_close(&found.covariance, &exact.covariance, 1e-10);
}

#[test]
fn gaussians_multiply_as_gaussians_do() {
    let space = Space::real(2);
    let gaussians: Vec<Mixture> = (0..4).map(|l| mixture(50 + l, 2, 1, 1.0, 1.0, true)).collect();
    let references: Vec<&Mixture> = gaussians.iter().collect();
    let (product, _) = Exact::default().mixture(&references).unwrap();
    let mut exact = Mixture::from_gaussian(&space, &to_gaussian(&gaussians[0])).unwrap();
    for other in &gaussians[1..] {
        exact = exact.times_gaussian(&to_gaussian(other)).unwrap().0;
    }
    assert_close(product.means(), exact.means(), 1e-12);
    assert_close(product.covariance_of(0), exact.covariance_of(0), 1e-12);
}

fn to_gaussian(mixture: &Mixture) -> DynamicGaussian {
    DynamicGaussian::from_moments(mixture.mean_of(0), mixture.covariance_of(0)).unwrap()
}

/// The world moved and turned moves the product, its log normaliser staying: a rigid motion for every method whose
/// draws depend on the inputs' own frame, to the noise of 4,000 points (four standard errors).
#[test]
fn a_rigid_motion_moves_the_product_rigidly() {
    let turn = |x: &[f64]| vec![0.6 * x[0] - 0.8 * x[1] + 5.0, 0.8 * x[0] + 0.6 * x[1] - 2.0];
    let inputs: Vec<Mixture> = (0..2).map(|l| mixture(60 + l, 2, 40, 1.0, 0.4, true)).collect();
    let moved: Vec<Mixture> = inputs
        .iter()
        .map(|input| {
            let means = input.means().chunks(2).flat_map(turn).collect();
            let c = input.covariance_of(0);
            let (a, b, e) = (c[0], c[1], c[3]);
            let xx = 0.36 * a - 0.96 * b + 0.64 * e;
            let xy = 0.48 * a - 0.28 * b - 0.48 * e;
            let yy = 0.64 * a + 0.96 * b + 0.36 * e;
            Mixture::with_shared_covariance(
                &input.space(),
                input.log_weights().to_vec(),
                means,
                vec![xx, xy, xy, yy],
            )
            .unwrap()
        })
        .collect();
    let (references, others): (Vec<&Mixture>, Vec<&Mixture>) =
        (inputs.iter().collect(), moved.iter().collect());
    let (here, there) =
        (Exact::default().mixture(&references).unwrap(), Exact::default().mixture(&others).unwrap());
    assert!((here.1 - there.1).abs() < 1e-10);
    assert_close(&there.0.moments().mean, &turn(&here.0.moments().mean), 1e-10);
    let sampled = Pairwise { components: Some(16), ..Pairwise::default() }
        .product(&others, 4000, &mut stream(2))
        .unwrap();
    let (found, exact) = (sampled.particles.moments(), there.0.moments());
    for k in 0..2 {
        let error = (found.mean[k] - exact.mean[k]).abs() / exact.covariance_at(k, k).sqrt();
        assert!(error < 4.0 / sampled.quality.effective_sample_size.sqrt());
    }
}

#[test]
fn headings_multiply_across_the_cut() {
    let space = Space::new([Coordinate::Angle]);
    let build = |centre: f64| {
        let means = (0..8).map(|i| centre + 0.05 * f64::from(i)).collect();
        Mixture::with_shared_covariance(&space, vec![0.0; 8], means, vec![0.04]).unwrap()
    };
    let (before, after) = (build(PI - 0.5), build(-PI + 0.15));
    for choice in
        [ProductChoice::Exact, ProductChoice::Gibbs, ProductChoice::Pairwise, ProductChoice::MultiscaleGibbs]
    {
        let product = choice.method().product(&[&before, &after], 2000, &mut stream(3)).unwrap();
        let mean = product.particles.moments().mean[0];
        // The same inputs a turn back, on the line.
        let line = |mixture: &Mixture| {
            let means = mixture.means().iter().map(|x| if *x < 0.0 { x + 2.0 * PI } else { *x }).collect();
            Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 8], means, vec![0.04]).unwrap()
        };
        let (_, exact) = enumerated(&[&line(&before), &line(&after)]);
        let error = sumprod_graph::wrap_angle(mean - exact.mean[0]).abs();
        assert!(error < 4.0 * (exact.covariance[0] / 2000.0).sqrt(), "{choice:?}: {error}");
    }
}

#[test]
fn the_same_stream_gives_the_same_bits() {
    let inputs: Vec<Mixture> = (0..3).map(|l| mixture(70 + l, 2, 300, 1.0, 0.3, true)).collect();
    let references: Vec<&Mixture> = inputs.iter().collect();
    for choice in [
        ProductChoice::Auto,
        ProductChoice::Gibbs,
        ProductChoice::MultiscaleGibbs,
        ProductChoice::MixtureImportance,
    ] {
        let run = || choice.method().product(&references, 200, &mut stream(4)).unwrap();
        assert_eq!(run(), run(), "{choice:?}");
    }
}
