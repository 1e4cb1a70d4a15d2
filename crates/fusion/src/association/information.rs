//! Uncertainty of the biases at the maximum of the penalised likelihood.
//!
//! With e = x − T, Φ = ∂T/∂b and g = u Φᵀe/σ², second track n has the score s_n = Σ_m τ_mn g_mn and the information
//!
//! H_n = Σ_m τ (u ΦᵀΦ/σ² − 2u/(ν + δ) Φᵀe eᵀΦ/σ⁴ − g gᵀ) + s sᵀ (Louis 1982),
//!
//! what the pairs would tell if they were known, less what is lost because they are not.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2x4, Matrix4, Vector2, Vector4};

use super::bias::BIASES;
use super::expectation::Residuals;

/// The inverse of Λ + c Σ H_n, where c = 1 − (p + 2)/k for p biases that k coordinates have told: σ² is estimated from the
/// same coordinates, which makes it too small by 1 − p/k, and the biases' posterior a t distribution of k − p degrees of
/// freedom, whose covariance is wider by as many over two fewer. `derivative` gives ∂T/∂b and the set of biases of the position with this index, tracks by scans.
///
/// The information is used where it is positive definite, else that of known pairs, which always is. `None` where
/// neither can be inverted.
pub(super) fn covariance(
    residuals: &Residuals<'_>,
    precision: &DMatrix<f64>,
    scans: usize,
    derivative: impl Fn(usize) -> (Matrix2x4<f64>, usize),
) -> Option<DMatrix<f64>> {
    let size = precision.nrows();
    let variance = residuals.variance();
    let mut known = DMatrix::<f64>::zeros(size, size);
    let mut lost = DMatrix::<f64>::zeros(size, size);
    let mut shown = DMatrix::<f64>::zeros(size, size);
    let mut score = DVector::<f64>::zeros(size);
    let mut own = DVector::<f64>::zeros(size);
    let mut effective = 0.0;
    for n in 0..residuals.len() {
        score.fill(0.0);
        for pair in residuals.of(n) {
            own.fill(0.0);
            effective += pair.probability * (2 * scans) as f64;
            for scan in 0..scans {
                let (phi, set) = derivative(pair.first * scans + scan);
                let start = BIASES * set;
                let e = |i: usize| pair.second[2 * scan + i] - pair.place[2 * scan + i];
                let pulled: Vector4<f64> = phi.transpose() * Vector2::new(e(0), e(1)) / variance;
                let mut part = own.fixed_rows_mut::<BIASES>(start);
                part += pulled;
                let told: Matrix4<f64> = phi.transpose() * phi * (pair.probability * pair.scale / variance);
                let mut block = known.fixed_view_mut::<BIASES, BIASES>(start, start);
                block += told;
            }
            let weight = pair.probability * pair.scale;
            score.axpy(weight, &own, 1.0);
            lost.ger(weight * (2.0 * pair.slope + pair.scale), &own, &own, 1.0);
        }
        shown.ger(1.0, &score, &score, 1.0);
    }
    let told = &known - lost + shown;
    let inverse = |told: &DMatrix<f64>, share: f64| {
        let factors = Cholesky::new(precision + told * share)?;
        let inverse = factors.inverse();
        inverse.iter().all(|value| value.is_finite()).then_some(inverse)
    };
    let share = |inverse: &DMatrix<f64>| {
        let taken = size as f64 - (inverse * precision).trace();
        // With as many biases as coordinates nothing is left to tell the variance.
        (1.0 - (taken + 2.0) / effective.max(1.0)).max(0.5)
    };
    let whole = |told: &DMatrix<f64>| inverse(told, share(&inverse(told, 1.0)?));
    whole(&told).or_else(|| whole(&known))
}
