//! Expectation-maximisation: probabilities of pairs, then field, variance, weights and tails in turn.

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::assign::{Pair, global_nearest};
use super::candidates::Candidates;
use super::error::AssociationError;
use super::expectation::{Expectation, Pull, Residuals, Sums};
use super::settings::{Mixture, Start};
use super::tails::Tails;
use super::tracks::{Tracks, log_volume, scale};

/// How many deviations of the start a pair may be apart to be looked at.
const REACH: f64 = 10.0;

/// What is known beforehand about the displacements of the first tracks.
///
/// The maximisation step asks for the displacements v that maximise
/// −1/(2σ²) Σ_mn P_mn |x_n − y_m − v_m|² − penalty(v), or at least raise it.
pub trait Displacement {
    /// Prepares for these M tracks of D coordinates: fills the displacements (M·D numbers in metres, zero before) with the
    /// prior's mean, and returns the variance that the prior gives a coordinate's displacement (m²), on average. `scale` is
    /// the root mean square of a coordinate about its mean over both sets (m).
    ///
    /// # Errors
    /// Where the field cannot displace such tracks.
    fn start(
        &mut self,
        first: &Tracks,
        scale: f64,
        displacements: &mut [f64],
    ) -> Result<f64, AssociationError>;

    /// Improves the displacements (M·D) at variance σ² of a coordinate.
    ///
    /// # Errors
    /// Where the field's equations cannot be solved.
    fn improve(
        &mut self,
        pull: &Pull,
        variance: f64,
        displacements: &mut [f64],
    ) -> Result<(), AssociationError>;

    /// Minus the log prior density of the current displacements, up to a constant.
    fn penalty(&self) -> f64;

    /// Called once after the last iteration, so that the field can tell its uncertainty.
    ///
    /// # Errors
    /// Where that has no answer.
    fn finish(&mut self, _residuals: &Residuals<'_>) -> Result<(), AssociationError> {
        Ok(())
    }
}

/// Probability that two tracks are the same target's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairProbability {
    /// Index of the first set's track.
    pub first: usize,
    /// Index of the second set's track.
    pub second: usize,
    /// The probability; those of one second track add up to one minus the probability that it has no partner.
    pub probability: f64,
}

/// How the iterations went.
#[derive(Clone, Debug, PartialEq)]
pub struct MixtureReport {
    /// Penalised log likelihood at the start and after each iteration; it never decreases.
    pub objective: Vec<f64>,
    /// The same of the iterations that refine with Gaussian tails; empty where there are none.
    pub refinement: Vec<f64>,
    /// Variance σ² of a coordinate about its displaced track at the end (m²).
    pub variance: f64,
    /// Degrees of freedom at the end; `None` for Gaussian tails.
    pub degrees_of_freedom: Option<f64>,
    /// Whether the gain fell below the tolerance before the iterations were used up.
    pub converged: bool,
    /// Number of pairs that were looked at.
    pub candidates: usize,
}

impl MixtureReport {
    /// Number of iterations.
    pub fn iterations(&self) -> usize {
        self.objective.len().saturating_sub(1) + self.refinement.len().saturating_sub(1)
    }

    /// Largest fall of the objective in one iteration, as a share of its size; 0 where it never fell.
    pub fn largest_fall(&self) -> f64 {
        let steps = self.objective.windows(2).chain(self.refinement.windows(2));
        steps.map(|pair| (pair[0] - pair[1]) / pair[0].abs().max(1.0)).fold(0.0, f64::max)
    }
}

/// Which tracks belong together, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Association {
    /// The decision, by first track: one to one, each pair closer than the gate.
    pub pairs: Vec<Pair>,
    /// Probabilities above 10⁻⁶, by second track.
    pub probabilities: Vec<PairProbability>,
    /// The first tracks where the field puts them.
    pub displaced: Tracks,
    /// How the iterations went.
    pub report: MixtureReport,
}

/// Associates the second tracks with the first ones, displaced by a field that is found on the way.
///
/// O(pairs within reach) an iteration, plus the field's own work; the assignment as [`global_nearest`].
///
/// # Errors
/// [`AssociationError`] for parameters that mean nothing, sets of different shape, a field that cannot be solved for,
/// and a crowded gate.
pub fn associate<F: Displacement + ?Sized>(
    first: &Tracks,
    second: &Tracks,
    field: &mut F,
    mixture: &Mixture,
) -> Result<Association, AssociationError> {
    mixture.validate()?;
    first.agree(second)?;
    let mut fit = Fit::new(first, second, field, mixture)?;
    let report = fit.run()?;
    let displaced = first.displaced(&fit.displacements);
    let probabilities = fit.model.candidates.pairs().zip(&fit.probabilities);
    let probabilities = probabilities
        .filter(|(_, probability)| **probability > 1e-6)
        .map(|((_, first, second), &probability)| PairProbability { first, second, probability })
        .collect();
    let pairs = global_nearest(&displaced, second, fit.gate())?;
    Ok(Association { pairs, probabilities, displaced, report })
}

/// The state of the iterations.
struct Fit<'a, F: Displacement + ?Sized> {
    first: &'a Tracks,
    field: &'a mut F,
    mixture: &'a Mixture,
    model: Expectation<'a>,
    probabilities: Vec<f64>,
    pull: Pull,
    memberships: Vec<f64>,
    displacements: Vec<f64>,
    least_variance: f64,
}

impl<'a, F: Displacement + ?Sized> Fit<'a, F> {
    fn new(
        first: &'a Tracks,
        second: &'a Tracks,
        field: &'a mut F,
        mixture: &'a Mixture,
    ) -> Result<Self, AssociationError> {
        let count = first.len();
        let scale = if first.is_empty() && second.is_empty() { 1.0 } else { scale(first, second) };
        let mut displacements = vec![0.0; count * first.width()];
        let prior = field.start(first, scale, &mut displacements)?;
        let displaced = first.displaced(&displacements);
        let deviation = match mixture.start {
            Start::Prior => prior.sqrt(),
            Start::Spread => root_mean_square_distance(&displaced, second),
            Start::Deviation(deviation) => deviation,
        };
        // Below a billionth of the sets' scale differences of coordinates are rounding.
        let least_variance = mixture.least_deviation.max(1e-9 * scale).powi(2);
        let all = mixture.neighbours.saturating_mul(second.len()).max(mixture.dense_pairs);
        let dense = count.saturating_mul(second.len()) <= mixture.dense_pairs;
        let whole = dense || mixture.start == Start::Spread;
        // What may be declared a pair is looked at, however much the prior knows.
        let radius = if whole { f64::INFINITY } else { mixture.gate.max(REACH * deviation) };
        let candidates = Candidates::within(&displaced, second, radius, all)?;
        let outliers = mixture.outlier_weight;
        let log_weight = ((1.0 - outliers) / count.max(1) as f64).ln();
        Ok(Self {
            probabilities: vec![0.0; candidates.len()],
            pull: Pull { weight: vec![0.0; count], force: vec![0.0; count * first.width()] },
            memberships: vec![0.0; count],
            displacements,
            model: Expectation {
                candidates,
                second,
                places: displaced.coordinates().to_vec(),
                tails: mixture.tails,
                variance: (deviation * deviation).max(least_variance),
                log_weights: vec![log_weight; count],
                log_uniform: outliers.ln() - log_volume(first, second, mixture.gate),
            },
            least_variance,
            first,
            field,
            mixture,
        })
    }

    fn run(&mut self) -> Result<MixtureReport, AssociationError> {
        let (objective, mut converged) = self.iterate()?;
        let mut refinement = Vec::new();
        if self.mixture.refine && self.model.tails != Tails::Gaussian {
            self.model.tails = Tails::Gaussian;
            let (values, ended) = self.iterate()?;
            refinement = values;
            converged &= ended;
        }
        self.field.finish(&self.model.residuals(&self.probabilities))?;
        Ok(MixtureReport {
            objective,
            refinement,
            variance: self.model.variance,
            degrees_of_freedom: self.model.tails.degrees(),
            converged,
            candidates: self.model.candidates.len(),
        })
    }

    /// Iterates with the present tails: the objective of each iteration, and whether it came to rest.
    fn iterate(&mut self) -> Result<(Vec<f64>, bool), AssociationError> {
        let enough = self.mixture.tolerance * self.model.second.len() as f64;
        let mut objective: Vec<f64> = Vec::with_capacity(self.mixture.iterations + 1);
        loop {
            let sums = self.expect();
            let value = sums.log_likelihood - self.field.penalty();
            let gain = objective.last().map_or(f64::INFINITY, |last| value - last);
            objective.push(value);
            // Without a pair within reach there is nothing to learn.
            if gain <= enough || sums.membership <= 0.0 {
                return Ok((objective, true));
            }
            if objective.len() > self.mixture.iterations {
                return Ok((objective, false));
            }
            self.maximise(&sums)?;
        }
    }

    /// Farthest that the tracks of a declared pair may be apart.
    fn gate(&self) -> f64 {
        let Mixture { gate, miss_probability, .. } = *self.mixture;
        if self.model.tails != Tails::Gaussian || miss_probability == 0.0 {
            return gate;
        }
        let quantile = ChiSquared::new(self.first.width() as f64)
            .map_or(f64::INFINITY, |law| law.inverse_cdf(1.0 - miss_probability));
        (self.model.variance * quantile / self.first.scans() as f64).sqrt().min(gate)
    }

    fn expect(&mut self) -> Sums {
        self.model.run(&mut self.probabilities, &mut self.pull, &mut self.memberships)
    }

    fn maximise(&mut self, sums: &Sums) -> Result<(), AssociationError> {
        let width = self.first.width();
        self.field.improve(&self.pull, self.model.variance, &mut self.displacements)?;
        // The square about the new places: from the old ones by the change of place.
        let mut square = sums.square;
        let rows = self.pull.weight.iter().zip(self.pull.force.chunks_exact(width));
        let places = self.model.places.chunks_exact_mut(width).zip(self.first.iter());
        let moves = self.displacements.chunks_exact(width);
        for (((weight, force), (place, start)), displacement) in rows.zip(places).zip(moves) {
            for (i, place) in place.iter_mut().enumerate() {
                let new = start[i] + displacement[i];
                let change = new - *place;
                square += change * (weight * change - 2.0 * force[i]);
                *place = new;
            }
        }
        self.model.variance = (square / (width as f64 * sums.membership)).max(self.least_variance);
        if self.mixture.estimate_weights {
            let share = (1.0 - self.mixture.outlier_weight) / sums.membership;
            for (log_weight, membership) in self.model.log_weights.iter_mut().zip(&self.memberships) {
                *log_weight = (share * membership).ln();
            }
        }
        self.model.tails = self.model.tails.reestimated(sums.log_scale / sums.membership, width);
        Ok(())
    }
}

/// √(mean over all pairs of |x − y|² / D), from the sets' moments.
fn root_mean_square_distance(first: &Tracks, second: &Tracks) -> f64 {
    if first.is_empty() || second.is_empty() {
        return 1.0;
    }
    let width = first.width();
    let moments = |tracks: &Tracks, i: usize| {
        let count = tracks.len() as f64;
        let mean = tracks.iter().map(|track| track[i]).sum::<f64>() / count;
        (mean, tracks.iter().map(|track| (track[i] - mean).powi(2)).sum::<f64>() / count)
    };
    let square: f64 = (0..width)
        .map(|i| {
            let ((a, spread), (b, other)) = (moments(first, i), moments(second, i));
            (a - b).powi(2) + spread + other
        })
        .sum();
    (square / width as f64).sqrt()
}
