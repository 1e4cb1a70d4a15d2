//! Predictions and retrodictions against dense formulas, and the noise of constant velocity.

use crate::support::{
    Draw, assert_close, assert_moments, gaussian, information_of, moments_of, rows, send_gaussian, square,
};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::MessageError;
use sumprod_messages::Moments;
use sumprod_models::library::ConstantVelocity;
use sumprod_models::{Model, Motion, ProcessNoise, Real, Transition};

/// x' = F x + c + B z.
pub struct Affine {
    pub matrix: DMatrix<f64>,
    pub offset: DVector<f64>,
    pub noise: ProcessNoise,
}

impl Motion for Affine {
    fn dimension(&self) -> usize {
        self.offset.len()
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        for (row, next) in next.iter_mut().enumerate() {
            *next = T::from(self.offset[row]);
            for (column, x) in state.iter().enumerate() {
                *next += *x * self.matrix[(row, column)];
            }
        }
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.noise.clone()
    }
}

struct Case {
    f: DMatrix<f64>,
    c: DVector<f64>,
    b: DMatrix<f64>,
    model: Model<Transition<Affine>>,
}

impl Case {
    fn new(f: DMatrix<f64>, c: DVector<f64>, b: DMatrix<f64>) -> Self {
        let noise = ProcessNoise::from_factor(c.len(), &rows(&b));
        let model = Model(Transition::new(Affine { matrix: f.clone(), offset: c.clone(), noise }));
        Self { f, c, b, model }
    }

    /// A motion of this rank of noise; F invertible, or without its last row's and column's part.
    fn random(draw: &mut Draw, d: usize, rank: usize, singular: bool) -> Self {
        let mut f = loop {
            let f = draw.matrix(d, d) * 0.4 + DMatrix::identity(d, d);
            let values = f.clone().svd(false, false).singular_values;
            if values.max() < 20.0 * values.min() {
                break f;
            }
        };
        if singular {
            let last = f.column(0).into_owned();
            f.set_column(d - 1, &last);
        }
        Self::new(f, draw.vector(d), draw.matrix(d, rank))
    }

    /// The factor as exp(-½ (x; z)'J(x; z)) with y = F x + c + B z put into a message (Λ, η) on y, z summed out.
    fn retrodiction(
        &self,
        information: &DMatrix<f64>,
        vector: &DVector<f64>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let centred = vector - information * &self.c;
        let inner =
            self.b.transpose() * information * &self.b + DMatrix::identity(self.b.ncols(), self.b.ncols());
        let inverse = inner.cholesky().unwrap().inverse();
        let cross = self.f.transpose() * information * &self.b;
        let gain = &cross * inverse;
        let own = self.f.transpose() * information * &self.f - &gain * cross.transpose();
        let eta = self.f.transpose() * &centred - gain * self.b.transpose() * centred;
        (own, eta)
    }

    /// With x = F⁻¹ (y - c - B z) in a message (Λ, η) on x, z summed out.
    fn improper_prediction(
        &self,
        information: &DMatrix<f64>,
        vector: &DVector<f64>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let back = self.f.clone().try_inverse().unwrap();
        let moved = back.transpose() * information * &back;
        let centred = back.transpose() * vector + &moved * &self.c;
        let inner = self.b.transpose() * &moved * &self.b + DMatrix::identity(self.b.ncols(), self.b.ncols());
        let inverse = inner.cholesky().unwrap().inverse();
        let gain = &moved * &self.b * inverse * self.b.transpose();
        (&moved - &gain * &moved, &centred - gain * &centred)
    }
}

fn column(vector: DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(vector.len(), 1, vector.as_slice())
}

#[test]
fn predictions_of_proper_messages() {
    let mut draw = Draw::new(1);
    for round in 0..200 {
        let d = 1 + round % 6;
        let rank = draw.below(d + 1).max(1);
        let case = Case::random(&mut draw, d, rank, false);
        let (mean, covariance) = (draw.vector(d) * 10.0, draw.covariance(d));
        let message = moments_of(&mean, &covariance);
        let predicted =
            send_gaussian(&case.model, 1, &[message.clone(), message]).unwrap().moments().unwrap();
        let exact = &case.f * covariance * case.f.transpose() + &case.b * case.b.transpose();
        assert_moments(&predicted, &(&case.f * mean + &case.c), &exact, 1e-9);
    }
}

#[test]
fn a_singular_step_is_predicted_where_the_noise_fills_it() {
    let mut draw = Draw::new(2);
    for d in 2..6 {
        let case = Case::random(&mut draw, d, d, true);
        let (mean, covariance) = (draw.vector(d), draw.covariance(d));
        let message = moments_of(&mean, &covariance);
        let predicted =
            send_gaussian(&case.model, 1, &[message.clone(), message.clone()]).unwrap().moments().unwrap();
        let exact = &case.f * covariance * case.f.transpose() + &case.b * case.b.transpose();
        assert_moments(&predicted, &(&case.f * mean + &case.c), &exact, 1e-9);
        // Without noise the prediction lies on a plane, which has no information form.
        let case = Case::new(case.f, case.c, DMatrix::zeros(d, 1));
        let error = send_gaussian(&case.model, 1, &[message.clone(), message]).unwrap_err();
        assert!(matches!(error, MessageError::NotPositiveDefinite { what: "the predicted covariance", .. }));
        // An improper message cannot be carried over either.
        let flat_once = gaussian(&draw.semidefinite(d, 1), &DVector::zeros(d));
        let error = send_gaussian(&case.model, 1, &[flat_once.clone(), flat_once]).unwrap_err();
        assert!(error.to_string().contains("Jacobian of the motion is singular"), "{error}");
    }
}

#[test]
fn predictions_of_improper_messages() {
    let mut draw = Draw::new(3);
    for round in 0..300 {
        let d = 2 + round % 5;
        let noise = draw.below(d + 1).max(1);
        let case = Case::random(&mut draw, d, noise, false);
        let rank = draw.below(d);
        let information = draw.semidefinite(d, rank);
        let vector = &information * draw.vector(d);
        let message = gaussian(&information, &vector);
        let predicted = send_gaussian(&case.model, 1, &[message.clone(), message]).unwrap();
        let (exact, exact_vector) = case.improper_prediction(&information, &vector);
        let (found, found_vector) = information_of(&predicted);
        assert_close(&found, &exact, 1e-9, "information");
        assert_close(&column(found_vector), &column(exact_vector), 1e-9, "information vector");
    }
}

/// Weak directions are information too: their share survives however strong the others are.
#[test]
fn predictions_of_nearly_improper_messages() {
    let mut draw = Draw::new(4);
    for round in 0..100 {
        let d = 2 + round % 3;
        let case = Case::random(&mut draw, d, 1, false);
        let strong = draw.semidefinite(d, 1);
        let weak = draw.covariance(d) * 10.0_f64.powi(-(round as i32 % 16));
        let information = strong + weak;
        let vector = &information * draw.vector(d);
        let message = gaussian(&information, &vector);
        let predicted = send_gaussian(&case.model, 1, &[message.clone(), message]).unwrap();
        let (exact, exact_vector) = case.improper_prediction(&information, &vector);
        let (found, found_vector) = information_of(&predicted);
        assert_close(&found, &exact, 1e-9, "information");
        assert_close(&column(found_vector), &column(exact_vector), 1e-9, "information vector");
    }
}

#[test]
fn retrodictions_of_messages_of_any_rank() {
    let mut draw = Draw::new(5);
    for round in 0..300 {
        let d = 1 + round % 6;
        let (noise, rank, singular) = (draw.below(d + 1).max(1), draw.below(d + 1), round % 3 == 0);
        let case = Case::random(&mut draw, d, noise, singular);
        let information = draw.semidefinite(d, rank);
        let vector = &information * draw.vector(d);
        let message = gaussian(&information, &vector);
        let back = send_gaussian(&case.model, 0, &[message.clone(), message]).unwrap();
        let (exact, exact_vector) = case.retrodiction(&information, &vector);
        let (found, found_vector) = information_of(&back);
        assert_close(&found, &exact, 1e-9, "information");
        assert_close(&column(found_vector), &column(exact_vector), 1e-9, "information vector");
    }
}

#[test]
fn flat_messages_stay_flat() {
    let case = Case::random(&mut Draw::new(6), 3, 2, false);
    let flat = sumprod_messages::DynamicGaussian::flat(3);
    for to in 0..2 {
        assert!(send_gaussian(&case.model, to, &[flat.clone(), flat.clone()]).unwrap().is_flat());
    }
}

#[test]
fn a_motion_without_noise_moves_messages_both_ways() {
    let mut draw = Draw::new(7);
    for empty in [true, false] {
        let mut case = Case::random(&mut draw, 3, 1, false);
        let noise = if empty {
            ProcessNoise::from_factor(3, &[])
        } else {
            ProcessNoise::diagonal(&[0.0; 3]).unwrap()
        };
        assert_eq!(noise.covariance(), vec![0.0; 9]);
        case.model = Model(Transition::new(Affine { matrix: case.f.clone(), offset: case.c.clone(), noise }));
        let (mean, covariance) = (draw.vector(3), draw.covariance(3));
        let message = moments_of(&mean, &covariance);
        let ahead = send_gaussian(&case.model, 1, &[message.clone(), message.clone()]).unwrap();
        let exact = &case.f * &covariance * case.f.transpose();
        assert_moments(&ahead.moments().unwrap(), &(&case.f * &mean + &case.c), &exact, 1e-9);
        let back = send_gaussian(&case.model, 0, &[message, ahead]).unwrap();
        assert_moments(&back.moments().unwrap(), &mean, &covariance, 1e-9);
    }
}

#[test]
fn moments_are_predicted_without_a_graph() {
    let mut draw = Draw::new(8);
    let case = Case::random(&mut draw, 4, 2, false);
    let (mean, covariance) = (draw.vector(4), draw.covariance(4));
    let state = Moments { mean: mean.as_slice().to_vec(), covariance: rows(&covariance) };
    let predicted = case.model.0.predict_moments(&state).unwrap();
    let exact = &case.f * covariance * case.f.transpose() + &case.b * case.b.transpose();
    assert_moments(&predicted, &(&case.f * mean + &case.c), &exact, 1e-12);
    let short = Moments { mean: vec![0.0], covariance: vec![1.0] };
    assert_eq!(
        case.model.0.predict_moments(&short),
        Err(MessageError::Dimension { what: "the state", found: 1, expected: 4 })
    );
}

#[test]
fn constant_velocity_has_the_covariances_of_its_two_forms() {
    let (t, q) = (0.7_f64, 2.5);
    let white = ConstantVelocity::white_acceleration(2, t, q).unwrap();
    let held = ConstantVelocity::held_acceleration(2, t, q).unwrap();
    let axis_white = [t.powi(3) / 3.0, t * t / 2.0, t * t / 2.0, t].map(|x| q * x);
    let axis_held = [t.powi(4) / 4.0, t.powi(3) / 2.0, t.powi(3) / 2.0, t * t].map(|x| q * x);
    for (motion, axis, rank) in [(&white, axis_white, 4), (&held, axis_held, 2)] {
        let own = square(&motion.noise(&[0.0; 4]).covariance(), 4);
        let exact =
            DMatrix::from_fn(
                4,
                4,
                |row, column| {
                    if row / 2 == column / 2 { axis[row % 2 * 2 + column % 2] } else { 0.0 }
                },
            );
        assert_close(&own, &exact, 1e-15, "process noise");
        assert_eq!(own.rank(1e-12), rank);
        let mut next = [0.0; 4];
        motion.step(&[1.0, 2.0, -3.0, 0.5], &mut next);
        assert_eq!(next, [1.0 + 2.0 * t, 2.0, -3.0 + 0.5 * t, 0.5]);
    }
    assert_eq!(ConstantVelocity::held_acceleration(3, t, q).unwrap().dimension(), 6);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(ConstantVelocity::white_acceleration(2, bad, q).is_err());
        assert!(ConstantVelocity::white_acceleration(2, t, bad).is_err());
        assert!(ConstantVelocity::held_acceleration(2, bad, q).is_err());
        assert!(ConstantVelocity::held_acceleration(2, t, bad).is_err());
    }
    assert!(ConstantVelocity::white_acceleration(0, t, q).is_err());
}
