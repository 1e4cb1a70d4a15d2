//! What noise models accept, and what they say of what they do not.

use crate::support::{Draw, assert_close, rows, square};
use nalgebra::DMatrix;
use sumprod_graph::MessageError;
use sumprod_models::{Noise, NoiseError, ProcessNoise};

#[test]
fn every_wrong_noise_names_what_is_wrong() {
    let said = |error: NoiseError| error.to_string();
    for value in [0.0, -0.5, f64::INFINITY] {
        let error = Noise::diagonal(&[1.0, value]).unwrap_err();
        assert_eq!(error, NoiseError::Variance { index: 1, value });
        assert!(said(error).contains("variance 1 is"));
        let error = Noise::isotropic(1, 1.0).unwrap().student_t(value).unwrap_err();
        assert_eq!(error, NoiseError::DegreesOfFreedom(value));
    }
    assert!(matches!(Noise::diagonal(&[f64::NAN]), Err(NoiseError::Variance { index: 0, .. })));
    assert!(Noise::isotropic(2, f64::NAN).is_err());
    assert!(Noise::isotropic(1, 1.0).unwrap().student_t(f64::NAN).is_err());
    for size in [0, 2, 3, 5] {
        assert_eq!(Noise::gaussian(&vec![1.0; size]), Err(NoiseError::NotSquare { found: size }));
    }
    assert_eq!(Noise::isotropic(0, 1.0), Err(NoiseError::NotSquare { found: 0 }));
    let error = Noise::gaussian(&[1.0, 2.0, 2.0, 1.0]).unwrap_err();
    assert!(matches!(error, NoiseError::Covariance(MessageError::NotPositiveDefinite { pivot: 1, .. })));
    assert!(said(error).contains("the noise covariance is not positive definite"));
    for entry in 0..4 {
        let mut covariance = [2.0, 0.5, 0.5, 2.0];
        covariance[entry] = f64::NAN;
        assert!(Noise::gaussian(&covariance).is_err(), "NaN at {entry}");
    }
}

#[test]
fn a_covariance_must_be_symmetric() {
    let error = Noise::gaussian(&[2.0, 0.4, -0.4, 2.0]).unwrap_err();
    assert!(error.to_string().contains("symmetric"), "{error}");
    assert!(ProcessNoise::from_covariance(&[2.0, 0.4, -0.4, 2.0]).is_err());
    assert!(ProcessNoise::driven(&[1.0, 0.0, 0.0, 1.0], &[2.0, 0.4, -0.4, 2.0]).is_err());
    // Rounding is no asymmetry.
    let nearly = 0.4 * (1.0 + 1e-15);
    assert!(Noise::gaussian(&[2.0, 0.4, nearly, 2.0]).is_ok());
    assert!(ProcessNoise::from_covariance(&[2.0, 0.4, nearly, 2.0]).is_ok());
}

#[test]
fn noise_keeps_its_numbers() {
    let mut draw = Draw::new(900);
    let covariance = draw.covariance(3);
    let noise = Noise::gaussian(&rows(&covariance)).unwrap();
    assert_eq!((noise.dimension(), noise.degrees_of_freedom()), (3, None));
    assert_eq!(noise.covariance(), rows(&covariance));
    let inverse = covariance.clone().try_inverse().unwrap();
    assert_close(&square(noise.information(), 3), &inverse, 1e-12, "information");
    let residual = draw.vector(3);
    let squared = (residual.transpose() * &inverse * &residual)[0];
    assert!((noise.squared_length(residual.as_slice()) - squared).abs() < 1e-12);
    let determinant = covariance.determinant();
    let exact = -0.5 * (squared + determinant.ln() + 3.0 * std::f64::consts::TAU.ln());
    assert!((noise.log_density(residual.as_slice()) - exact).abs() < 1e-12);
    assert_eq!(noise.weight(1e9), 1.0);
    // One degree of freedom in one dimension is Cauchy's distribution.
    let cauchy = Noise::isotropic(1, 4.0).unwrap().student_t(1.0).unwrap();
    for x in [0.0_f64, 0.7, -30.0] {
        let exact = -(std::f64::consts::PI * 2.0 * (1.0 + x * x / 4.0)).ln();
        assert!((cauchy.log_density(&[x]) - exact).abs() < 1e-12);
    }
}

#[test]
fn process_noise_by_each_constructor() {
    let mut draw = Draw::new(901);
    let (gain, covariance) = (draw.matrix(4, 2), draw.covariance(2));
    let exact = &gain * &covariance * gain.transpose();
    let driven = ProcessNoise::driven(&rows(&gain), &rows(&covariance)).unwrap();
    assert_eq!((driven.dimension(), driven.sources()), (4, 2));
    assert_close(&square(&driven.covariance(), 4), &exact, 1e-12, "driven");
    let singular = ProcessNoise::from_covariance(&rows(&exact)).unwrap();
    assert_close(&square(&singular.covariance(), 4), &exact, 1e-12, "from a singular covariance");
    let factored = ProcessNoise::from_factor(4, driven.factor());
    assert_eq!(factored, driven);
    let diagonal = ProcessNoise::diagonal(&[2.0, 0.0, 3.0]).unwrap();
    let expected = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![2.0, 0.0, 3.0]));
    assert_close(&square(&diagonal.covariance(), 3), &expected, 1e-15, "diagonal");
    assert_eq!(ProcessNoise::from_covariance(&[0.0; 9]).unwrap().covariance(), vec![0.0; 9]);

    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(ProcessNoise::diagonal(&[1.0, bad]).is_err());
        assert!(ProcessNoise::from_covariance(&[1.0, 0.0, 0.0, bad]).is_err());
        assert!(ProcessNoise::driven(&[1.0, 1.0], &[bad]).is_err());
    }
    assert!(ProcessNoise::driven(&[1.0, f64::NAN], &[1.0]).is_err());
    assert!(ProcessNoise::from_covariance(&[1.0, 2.0, 2.0, 1.0]).is_err());
    for wrong in [&[][..], &[1.0; 3]] {
        let error = ProcessNoise::from_covariance(wrong);
        assert!(matches!(error, Err(MessageError::Dimension { what: "the process noise", .. })));
    }
    assert!(ProcessNoise::driven(&[1.0; 3], &[1.0, 0.0, 0.0, 1.0]).is_err());
    assert!(ProcessNoise::driven(&[1.0; 3], &[]).is_err());
}
