//! How far a distribution is from the Gaussian of its moments, by cumulants of whitened coordinates.
//!
//! To fourth order in Edgeworth's expansion the negentropy is, in nats,
//!
//! J = Σ κᵢⱼₖ² / 12 + Σ κᵢⱼₖₗ² / 48
//!
//! over all indices (Comon 1994, "Independent component analysis, a new concept?"), which no rotation changes: modes are
//! seen along whatever direction they lie apart. Over n draws of a Gaussian 2nJ is χ² with as many degrees of freedom
//! as there are different cumulants.

/// Weighted third and fourth moments of whitened coordinates, each set of indices once.
pub(crate) struct Cumulants {
    dimension: usize,
    third: Vec<f64>,
    fourth: Vec<f64>,
}

/// Number of orders in which indices that are sorted can stand.
fn orders(sorted: &[usize]) -> f64 {
    let (mut orders, mut repeats) = (1.0, 0.0);
    for (position, index) in sorted.iter().enumerate() {
        repeats = if position > 0 && sorted[position - 1] == *index { repeats + 1.0 } else { 1.0 };
        orders *= (position + 1) as f64 / repeats;
    }
    orders
}

impl Cumulants {
    pub(crate) fn new(dimension: usize) -> Self {
        let d = dimension;
        let third = vec![0.0; d * (d + 1) * (d + 2) / 6];
        let fourth = vec![0.0; third.len() * (d + 3) / 4];
        Self { dimension, third, fourth }
    }

    /// Number of different cumulants.
    pub(crate) fn count(&self) -> usize {
        self.third.len() + self.fourth.len()
    }

    /// Adds a point of this weight.
    pub(crate) fn add_point(&mut self, weight: f64, z: &[f64]) {
        let (mut third, mut fourth) = (self.third.iter_mut(), self.fourth.iter_mut());
        for i in 0..z.len() {
            for j in 0..=i {
                let pair = weight * z[i] * z[j];
                for k in 0..=j {
                    let triple = pair * z[k];
                    if let Some(sum) = third.next() {
                        *sum += triple;
                    }
                    for x in &z[..=k] {
                        if let Some(sum) = fourth.next() {
                            *sum += triple * x;
                        }
                    }
                }
            }
        }
    }

    /// Adds a Gaussian of this weight, mean and covariance (row-major).
    pub(crate) fn add_gaussian(&mut self, weight: f64, mean: &[f64], covariance: &[f64]) {
        let (m, d) = (mean, self.dimension);
        let c = |row: usize, column: usize| covariance[row * d + column];
        let (mut third, mut fourth) = (self.third.iter_mut(), self.fourth.iter_mut());
        for i in 0..d {
            for j in 0..=i {
                for k in 0..=j {
                    let triple = m[i] * m[j] * m[k] + m[i] * c(j, k) + m[j] * c(i, k) + m[k] * c(i, j);
                    if let Some(sum) = third.next() {
                        *sum += weight * triple;
                    }
                    for l in 0..=k {
                        let pairs = m[i] * m[j] * c(k, l) + m[i] * m[k] * c(j, l) + m[j] * m[k] * c(i, l);
                        let own = c(i, j) * c(k, l) + c(i, k) * c(j, l) + c(i, l) * c(j, k);
                        if let Some(sum) = fourth.next() {
                            *sum += weight * (triple * m[l] + pairs + own);
                        }
                    }
                }
            }
        }
    }

    /// The negentropy of what was added, of total weight one, mean zero and unit covariance.
    pub(crate) fn negentropy(&self) -> f64 {
        let same = |a: usize, b: usize| f64::from(u8::from(a == b));
        let (mut third, mut fourth) = (self.third.iter(), self.fourth.iter());
        let mut sum = 0.0;
        for i in 0..self.dimension {
            for j in 0..=i {
                for k in 0..=j {
                    let skew = third.next().copied().unwrap_or(0.0);
                    sum += orders(&[k, j, i]) * skew * skew / 12.0;
                    for l in 0..=k {
                        let gaussian =
                            same(i, j) * same(k, l) + same(i, k) * same(j, l) + same(i, l) * same(j, k);
                        let excess = fourth.next().copied().unwrap_or(0.0) - gaussian;
                        sum += orders(&[l, k, j, i]) * excess * excess / 48.0;
                    }
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_points(turn: f64) -> Cumulants {
        let (sine, cosine) = turn.sin_cos();
        let mut cumulants = Cumulants::new(2);
        // Two modes at ±1 along one axis, a Gaussian along the other, the whole turned.
        let across = [sine * sine, -sine * cosine, -sine * cosine, cosine * cosine];
        for side in [1.0, -1.0] {
            cumulants.add_gaussian(0.5, &[side * cosine, side * sine], &across);
        }
        cumulants
    }

    #[test]
    fn modes_count_whatever_their_direction() {
        // κ₄ = -2 along one axis alone.
        for turn in [0.0, 0.4, std::f64::consts::FRAC_PI_4, 2.0] {
            assert!((two_points(turn).negentropy() - 4.0 / 48.0).abs() < 1e-12, "{turn}");
        }
        assert_eq!(two_points(0.0).count(), 4 + 5);
    }

    #[test]
    fn a_gaussian_has_none_and_points_are_narrow_gaussians() {
        let mut gaussian = Cumulants::new(3);
        gaussian.add_gaussian(1.0, &[0.0; 3], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert!(gaussian.negentropy() < 1e-24);
        let (mut points, mut narrow) = (Cumulants::new(2), Cumulants::new(2));
        for (weight, z) in [(0.2, [1.0, -2.0]), (0.8, [-0.5, 0.3])] {
            points.add_point(weight, &z);
            narrow.add_gaussian(weight, &z, &[0.0; 4]);
        }
        assert!((points.negentropy() - narrow.negentropy()).abs() < 1e-12);
    }
}
