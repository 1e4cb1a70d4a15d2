//! What users may do wrong, and the sentence that tells them.

use crate::support::Track;
use sumprod_filters::{Correct, Filter, FilterError, Kalman, ParticleFilter, Predict, Recovery};
use sumprod_graph::Space;
use sumprod_messages::Moments;
use sumprod_models::cloud::LogLikelihood;
use sumprod_models::library::{AnchorOffset, AnchorRange, ConstantVelocity, Range};
use sumprod_models::{Motion, Noise, ProcessNoise, Real};

fn prior() -> Moments {
    Moments::diagonal(&[0.0; 4], &[1.0; 4])
}

fn filter() -> ParticleFilter {
    ParticleFilter::new(&Space::real(4), &prior(), 600, 1).unwrap()
}

fn far() -> AnchorOffset {
    Track::fix(&[1e4, 0.0])
}

#[test]
fn priors_that_are_no_distribution_are_refused() {
    let refuse = |moments: &Moments| Kalman::<4>::new(moments).unwrap_err().to_string();
    let mut wrong = prior();
    wrong.covariance[5] = -1.0;
    assert!(refuse(&wrong).contains("the covariance is not positive definite"), "{}", refuse(&wrong));
    wrong = prior();
    wrong.mean[2] = f64::NAN;
    assert_eq!(refuse(&wrong), "the prior cannot be used: an entry of the mean is NaN");
    wrong = prior();
    wrong.covariance[1] = 0.5;
    assert!(refuse(&wrong).contains("not symmetric"));
    assert!(refuse(&Moments::diagonal(&[0.0; 3], &[1.0; 3])).contains("dimension 3, expected 4"));
    let error = ParticleFilter::new(&Space::real(4), &prior(), 0, 1).err().unwrap();
    assert!(error.to_string().contains("the number of particles is 0"));
    assert!(ParticleFilter::new(&Space::Finite(3), &prior(), 5, 1).is_err());
}

#[test]
fn what_does_not_fit_the_state_is_refused_and_changes_nothing() {
    let motion = ConstantVelocity::white_acceleration(3, 1.0, 1.0).unwrap();
    let noise = || Noise::isotropic(1, 1.0).unwrap();
    let small = AnchorRange::new(1.0, [0.0; 2], 2, [0, 1], noise()).unwrap();
    let pair = Range::new(1.0, [4, 4], [[0, 2], [0, 2]], noise()).unwrap();
    let (mut kalman, mut particles) = (Kalman::<4>::new(&prior()).unwrap(), filter());
    let before = (kalman.clone(), particles.moments());
    for error in [kalman.predict(&motion).unwrap_err(), particles.predict(&motion).unwrap_err()] {
        assert_eq!(error.to_string(), "step 0: the motion has dimension 6, expected 4");
    }
    for error in [kalman.correct(&small).unwrap_err(), particles.correct(&small).unwrap_err()] {
        assert_eq!(error.to_string(), "step 0: the measured state has dimension 2, expected 4");
    }
    assert!(kalman.correct(&pair).is_err() && particles.correct(&pair).is_err());
    assert_eq!(before, (kalman, particles.moments()));
}

#[test]
fn a_measurement_that_no_particle_explains_is_told() {
    let mut filter = filter();
    let before = filter.moments();
    let error = filter.correct(&far()).unwrap_err();
    let FilterError::Unexplained { step: 0, count: 600, .. } = error else { panic!("{error}") };
    assert!(error.to_string().contains("standard deviations"), "{error}");
    assert_eq!(filter.moments(), before);
    let impossible = LogLikelihood(|_: &[f64]| f64::NEG_INFINITY);
    assert!(filter.correct(&impossible).unwrap_err().to_string().contains("zero at each"));
}

#[test]
fn each_recovery_does_what_it_says() {
    let mut keep = filter().recovering_by(Recovery::KeepPrediction);
    let before = keep.moments();
    let correction = keep.correct(&far()).unwrap();
    assert!(correction.recovered && correction.log_likelihood == f64::NEG_INFINITY);
    assert_eq!(keep.moments(), before);

    let elsewhere = Moments::diagonal(&[1e4, 0.0, 0.0, 0.0], &[4.0, 1.0, 4.0, 1.0]);
    let mut redraw = filter().recovering_by(Recovery::Redraw(elsewhere));
    assert!(redraw.correct(&far()).unwrap().recovered);
    assert!((redraw.mean()[0] - 1e4).abs() < 1.0);

    let mut widen = filter().recovering_by(Recovery::Widen(1e4));
    assert!(widen.correct(&Track::fix(&[150.0, 0.0])).unwrap().recovered);
    assert!((widen.mean()[0] - 150.0).abs() < 40.0);
    let mut narrow = filter().recovering_by(Recovery::Widen(2.0));
    let before = narrow.moments();
    assert!(narrow.correct(&far()).unwrap_err().to_string().contains("make it wider"));
    assert_eq!(narrow.moments(), before);
}

#[test]
fn a_log_likelihood_that_is_no_number_names_its_particle() {
    for value in [f64::NAN, f64::INFINITY] {
        let mut filter = filter();
        let wrong = LogLikelihood(move |x: &[f64]| if x[0] > 1.0 { value } else { 0.0 });
        let error = filter.correct(&wrong).unwrap_err().to_string();
        assert!(
            error.starts_with("step 0: the log likelihood of particle ") && error.contains("must be finite")
        );
    }
}

/// A motion that leaves the numbers.
struct Explosion;

impl Motion for Explosion {
    fn dimension(&self) -> usize {
        4
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next.copy_from_slice(state);
        next[1] = (state[1] * 1e6).exp();
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        ProcessNoise::from_factor(4, &[])
    }
}

#[test]
fn a_motion_that_leaves_the_numbers_is_told() {
    let mut particles = filter();
    let error = particles.predict(&Explosion).unwrap_err().to_string();
    assert_eq!(error, "step 0: a coordinate of a predicted particle is inf");
    let mut kalman = Kalman::<4>::new(&Moments::diagonal(&[1.0; 4], &[1.0; 4])).unwrap();
    let error = kalman.predict(&Explosion).unwrap_err().to_string();
    assert!(error.starts_with("step 0: the predicted covariance is"), "{error}");
}
