//! The mixture as a family: moments, samples, modes, closed-form products with Gaussians, and its written form.

use crate::common::{assert_close, choice, mixture, stream};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::PI;
use sumprod_graph::{Coordinate, Space};
use sumprod_messages::{DynamicGaussian, Mixture, Moments};

#[test]
fn moments_of_two_components() {
    let space = Space::real(1);
    let mixture =
        Mixture::new(&space, vec![0.25f64.ln(), 0.75f64.ln()], vec![0.0, 4.0], vec![1.0, 2.0]).unwrap();
    let moments = mixture.moments();
    assert_close(&moments.mean, &[3.0], 1e-15);
    assert_close(&moments.covariance, &[0.25 + 1.5 + 3.0], 1e-15);
}

#[test]
fn the_mean_of_an_angle_lies_across_the_cut() {
    let space = Space::new([Coordinate::Angle]);
    let means = vec![PI - 0.1, -PI + 0.3];
    let mixture = Mixture::with_shared_covariance(&space, vec![0.0; 2], means, vec![0.01]).unwrap();
    let moments = mixture.moments();
    assert!((sumprod_graph::wrap_angle(moments.mean[0] - PI) - 0.1).abs() < 1e-12);
    assert_close(&moments.covariance, &[0.01 + 0.04], 1e-12);
}

/// Four standard errors for each of five numbers: a failure once in 3,000 seeds. Systematic draws do better.
#[test]
fn samples_have_the_moments() {
    let mixture = mixture(3, 2, 20, 2.0, 0.7, false);
    let exact = mixture.moments();
    let count = 20_000;
    let independent = mixture.sample(count, &mut stream(1)).unwrap();
    let systematic = mixture.sample_systematic(count, &mut stream(2)).unwrap();
    for sample in [independent, systematic] {
        let found = sample.moments();
        for k in 0..2 {
            let deviation = exact.covariance_at(k, k).sqrt();
            let error = (found.mean[k] - exact.mean[k]).abs() / deviation * (count as f64).sqrt();
            assert!(error < 4.0, "mean {k} is {error} standard errors off");
            // The fourth moment of a mixture with these spreads is below that of a Gaussian.
            let error = (found.covariance_at(k, k) / exact.covariance_at(k, k) - 1.0).abs();
            assert!(error < 4.0 * (2.0 / count as f64).sqrt(), "variance {k} is {error} off");
        }
        let error = (found.covariance_at(0, 1) - exact.covariance_at(0, 1)).abs();
        let scale = (exact.covariance_at(0, 0) * exact.covariance_at(1, 1)).sqrt();
        assert!(error < 4.0 * scale * (2.0 / count as f64).sqrt());
    }
}

#[test]
fn a_gaussian_message_multiplies_in_closed_form() {
    for shared in [true, false] {
        let prior = mixture(4, 3, 6, 1.0, 1.0, shared);
        let (mean, covariance) = ([0.3, -0.4, 1.0], [1.0, 0.2, 0.1, 0.2, 2.0, -0.3, 0.1, -0.3, 0.5]);
        let gaussian = DynamicGaussian::from_moments(&mean, &covariance).unwrap();
        let single = Mixture::from_gaussian(&Space::real(3), &gaussian).unwrap();
        let (product, log_normaliser) = prior.times_gaussian(&gaussian).unwrap();
        assert_eq!(product.shared_covariance().is_some(), shared);
        // The message is the density without its constant.
        let zero = single.log_density(&[0.0; 3]).unwrap();
        let mut logs = Vec::new();
        for i in 0..prior.len() {
            let (log, mean, covariance) = choice(&[&prior, &single], &[i, 0]);
            assert_close(product.mean_of(i), mean.as_slice(), 1e-12);
            assert_close(product.covariance_of(i), covariance.as_slice(), 1e-12);
            assert!((product.log_weights()[i] + log_normaliser - (log - zero)).abs() < 1e-10);
            logs.push(log);
        }
    }
}

#[test]
fn an_improper_message_constrains_what_it_knows() {
    let prior = mixture(5, 2, 10, 1.0, 0.5, true);
    let (unchanged, log) = prior.times_gaussian(&DynamicGaussian::flat(2)).unwrap();
    assert_close(unchanged.means(), prior.means(), 1e-12);
    assert_close(unchanged.log_weights(), prior.log_weights(), 1e-12);
    assert!(log.abs() < 1e-12);
    // x + y = 3 with variance 1e-6.
    let ray = DynamicGaussian::from_information(&[1e6, 1e6, 1e6, 1e6], &[3e6, 3e6]).unwrap();
    let (product, _) = prior.times_gaussian(&ray).unwrap();
    let Moments { mean, covariance } = product.moments();
    assert!((mean[0] + mean[1] - 3.0).abs() < 1e-3);
    let along = DVector::from_vec(vec![1.0, 1.0]);
    let variance = along.dot(&(DMatrix::from_row_slice(2, 2, &covariance) * &along));
    assert!((variance / 1e-6 - 1.0).abs() < 1e-3);
    // Information below zero that no component can bear.
    let negative = DynamicGaussian::from_information(&[-1e3, 0.0, 0.0, 0.0], &[0.0, 0.0]).unwrap();
    assert!(prior.times_gaussian(&negative).is_err());
}

#[test]
fn headings_meet_on_the_nearest_branch() {
    let space = Space::new([Coordinate::Angle]);
    let prior = Mixture::with_shared_covariance(&space, vec![0.0], vec![PI - 0.1], vec![0.1]).unwrap();
    let message = DynamicGaussian::from_moments(&[-PI + 0.1], &[0.1]).unwrap();
    let (product, _) = prior.times_gaussian(&message).unwrap();
    assert!((product.mean_of(0)[0].abs() - PI).abs() < 1e-12);
    assert_close(product.covariance_of(0), &[0.05], 1e-12);
}

#[test]
fn modes_and_their_masses() {
    let space = Space::real(2);
    let log_weights = vec![0.2f64.ln(), 0.5f64.ln(), 0.3f64.ln()];
    let means = vec![-4.0, 0.0, 4.0, 0.0, 0.0, 5.0];
    let mixture =
        Mixture::with_shared_covariance(&space, log_weights, means, vec![1.0, 0.3, 0.3, 0.5]).unwrap();
    let modes = mixture.modes(1000, &mut stream(3)).unwrap();
    assert_eq!(modes.len(), 3);
    for (mode, (mass, location)) in
        modes.iter().zip([(0.5, [4.0, 0.0]), (0.3, [0.0, 5.0]), (0.2, [-4.0, 0.0])])
    {
        // Systematic draws place all but what lies nearer to another mode.
        assert!((mode.mass - mass).abs() < 0.01);
        assert_close(&mode.location, &location, 0.01);
        assert!((mode.log_density - mixture.log_density(&mode.location).unwrap()).abs() < 1e-12);
    }
    // Two kernels closer than two standard deviations have one mode.
    let close =
        Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 2], vec![0.0, 1.5], vec![1.0]).unwrap();
    assert_eq!(close.modes(200, &mut stream(4)).unwrap().len(), 1);
}

#[test]
fn written_and_read_again_to_the_bit() {
    for shared in [true, false] {
        let mixture = mixture(6, 2, 9, 1.0, 0.3, shared);
        let text = serde_json::to_string(&mixture).unwrap();
        assert_eq!(serde_json::from_str::<Mixture>(&text).unwrap(), mixture);
    }
    let broken =
        r#"{"coordinates":["Real"],"log_weights":[0.0],"means":[0.0],"covariances":[-1.0],"shared":true}"#;
    assert!(
        serde_json::from_str::<Mixture>(broken).unwrap_err().to_string().contains("not positive definite")
    );
}
