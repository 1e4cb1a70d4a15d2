use nalgebra::{Matrix4, Vector4};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::super::{BiasField, BiasPrior, Mixture, associate};
use super::{DEGREE, SENSORS, Scene, by_bias, prior};

/// The biases of 200 scenes, drawn from the prior with deviations of 600 m and a degree. NEES has mean 4; its mean over
/// 200 has the standard error 0.2 if Gaussian, and somewhat more with an estimated variance. Five of these, 1.1, bound an
/// error probability of one in a million.
#[test]
fn the_covariance_of_the_biases_is_as_large_as_their_errors() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let (mut sum, mut inside) = (0.0, 0);
    for seed in 0..200 {
        let mut normal = |deviation: f64| -> f64 {
            let draw: f64 = StandardNormal.sample(&mut random);
            deviation * draw
        };
        let truth = [normal(600.0), normal(DEGREE), normal(600.0), normal(DEGREE)];
        let scene = Scene::new(100 + seed, 30, 3, &[truth]);
        let (_, field) = by_bias(&scene, &Mixture::default());
        let (mean, covariance) = field.posterior().unwrap().scan(0).unwrap();
        let error = mean - Vector4::from(truth);
        let nees = error.dot(&(covariance.try_inverse().unwrap() * error));
        sum += nees;
        // The 95 % point of four degrees of freedom.
        inside += usize::from(nees < 9.488);
    }
    assert!((sum / 200.0 - 4.0).abs() < 1.1, "NEES {}", sum / 200.0);
    assert!(inside >= 178, "{inside} of 200 inside the 95 % region");
}

#[test]
fn several_scans_tell_biases_that_wander() {
    // Four scans whose biases move by 100 m and a tenth of a degree each.
    let biases: Vec<[f64; 4]> = (0..4)
        .map(|scan| {
            let steps = f64::from(scan);
            [500.0 + 100.0 * steps, DEGREE * (0.5 - 0.1 * steps), -400.0, DEGREE * (-0.5 + 0.1 * steps)]
        })
        .collect();
    let scene = Scene::new(9, 25, 5, &biases);
    let still = BiasField::new(SENSORS, prior()).unwrap();
    let walking = BiasField::new(SENSORS, prior().with_walk(1e4, (0.1 * DEGREE).powi(2))).unwrap();
    let mut errors = Vec::new();
    for mut field in [still, walking] {
        let found = associate(&scene.first, &scene.second, &mut field, &Mixture::default()).unwrap();
        assert!(found.report.largest_fall() <= 1e-9);
        assert!(scene.correct(&found) > 0.9);
        let posterior = field.posterior().unwrap();
        let mut nees = 0.0;
        for (scan, truth) in biases.iter().enumerate() {
            let (mean, covariance) = posterior.scan(scan).unwrap();
            let error = mean - Vector4::from(*truth);
            nees += error.dot(&(covariance.try_inverse().unwrap() * error)) / 4.0;
        }
        assert!(posterior.scan(4).is_none());
        errors.push(nees / 4.0);
    }
    // Per degree of freedom about 1; biases held still are many deviations off.
    assert!(errors[1] < 3.0 && errors[0] > 5.0, "{errors:?}");
}

#[test]
fn a_posterior_is_the_prior_of_the_next_scan() {
    let truth = [500.0, -0.8 * DEGREE, -300.0, 0.6 * DEGREE];
    let walk = Matrix4::from_diagonal(&Vector4::new(25.0, 1e-8, 25.0, 1e-8));
    let mut knowledge = prior();
    let mut spreads = Vec::new();
    for scan in 0..3 {
        let scene = Scene::new(40 + scan, 30, 3, &[truth]);
        let mut field = BiasField::new(SENSORS, knowledge.clone()).unwrap();
        associate(&scene.first, &scene.second, &mut field, &Mixture::default()).unwrap();
        let posterior = field.posterior().unwrap();
        spreads.push(posterior.covariance[(0, 0)]);
        knowledge = posterior.next_prior(walk).unwrap();
    }
    assert!(spreads[2] < 0.6 * spreads[0], "{spreads:?}");
    let error = knowledge.mean - Vector4::from(truth);
    let nees = error.dot(&(knowledge.covariance.try_inverse().unwrap() * error));
    // Above 25 with a probability below 1e-4.
    assert!(nees < 25.0, "{nees}");
}

/// Biases known to a few metres displace tracks by kilometres: partners are sought where the prior puts them.
#[test]
fn a_tight_prior_far_from_zero_is_where_partners_are_sought() {
    let truth = [3000.0, -4.0 * DEGREE, -2500.0, 3.5 * DEGREE];
    let scene = Scene::new(77, 40, 4, &[truth]);
    let mut prior = BiasPrior::independent(5.0, 1e-4);
    prior.mean = Vector4::from(truth);
    for dense_pairs in [0, 1_000_000] {
        let mut field = BiasField::new(SENSORS, prior.clone()).unwrap();
        let mixture = Mixture { dense_pairs, ..Mixture::default() };
        let found = associate(&scene.first, &scene.second, &mut field, &mixture).unwrap();
        assert!(found.report.largest_fall() <= 1e-9, "{}", found.report.largest_fall());
        assert!(scene.correct(&found) > 0.95, "{dense_pairs}: {}", scene.correct(&found));
        // The first places are the prior's, so that nothing is left to be found in the first steps.
        assert!(found.report.iterations() < 40, "{}", found.report.iterations());
        let (mean, covariance) = field.posterior().unwrap().scan(0).unwrap();
        let error = mean - Vector4::from(truth);
        assert!(error.dot(&(covariance.try_inverse().unwrap() * error)) < 25.0);
    }
}
