//! Motions: a state's step from one time to the next, and its process noise.
//!
//! x' = f(x) + B z, z ~ N(0, I). The process covariance B B' may be singular: nothing here inverts it.

use crate::moments::{add_product_transposed, linearise_motion, propagate};
use crate::rules::mixture::motion::{Retrodiction, predict};
use crate::rules::particles::{Guided, plain};
use crate::rules::{GaussianDraft, GaussianView, MixtureView, ParticleView, mixture};
use crate::small::{
    Matrix, Proper, Vector, WELL_CONDITIONED, check_symmetric, invert, multiply, multiply_add, proper, solve,
    symmetrise, transpose, zero_vector, zeros,
};
use crate::{Chart, Expansion, Noise, Real, Rules};
use smallvec::SmallVec;
use sumprod_graph::{MessageError, Port, Stream};
use sumprod_messages::{Cholesky, MixtureForm, MixtureMessage, Moments, Particles, ParticlesForm, Proposal};

/// Process noise by a factor B (state by sources, row-major): covariance B B'.
#[derive(Clone, Debug)]
pub struct ProcessNoise {
    dimension: usize,
    sources: usize,
    factor: SmallVec<[f64; 16]>,
    /// B B', of noise that is made once and used at every state; else empty.
    covariance: SmallVec<[f64; 16]>,
}

impl PartialEq for ProcessNoise {
    /// Whether the factors are equal; the covariance follows from them.
    fn eq(&self, other: &Self) -> bool {
        (self.dimension, &self.factor) == (other.dimension, &other.factor)
    }
}

impl ProcessNoise {
    /// Noise that enters through a gain: covariance G Q G', `gain` state by sources and `covariance` of the
    /// sources, both row-major.
    ///
    /// # Errors
    ///
    /// Where the sources' covariance is not symmetric positive definite, a number is not finite, or sizes do not
    /// agree.
    pub fn driven(gain: &[f64], covariance: &[f64]) -> Result<Self, MessageError> {
        let sources = covariance.len().isqrt();
        if sources == 0 || sources * sources != covariance.len() || !gain.len().is_multiple_of(sources) {
            let (found, expected) = (gain.len(), sources);
            return Err(MessageError::Dimension { what: "the gain of the process noise", found, expected });
        }
        if let Some(&value) = gain.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "an entry of the gain", value });
        }
        check_symmetric(covariance, sources, "the covariance of the noise sources")?;
        let dimension = gain.len() / sources;
        let lower = Cholesky::new(covariance, sources, "the process noise")?;
        let mut factor = SmallVec::from_elem(0.0, dimension * sources);
        for column in 0..sources {
            let (mut unit, mut scaled) = (zero_vector(sources), zero_vector(sources));
            unit[column] = 1.0;
            lower.multiply_lower(&unit, &mut scaled);
            for row in 0..dimension {
                factor[row * sources + column] =
                    (0..sources).map(|k| gain[row * sources + k] * scaled[k]).sum();
            }
        }
        Ok(Self::with_covariance(dimension, sources, factor))
    }

    /// Noise of this covariance (row-major), which may be singular.
    ///
    /// # Errors
    ///
    /// Where it is not symmetric positive semidefinite.
    pub fn from_covariance(covariance: &[f64]) -> Result<Self, MessageError> {
        let d = covariance.len().isqrt();
        if d == 0 || d * d != covariance.len() {
            let (found, expected) = (covariance.len(), d * d);
            return Err(MessageError::Dimension { what: "the process noise", found, expected });
        }
        check_symmetric(covariance, d, "the process noise")?;
        let eigen = nalgebra::DMatrix::from_row_slice(d, d, covariance).symmetric_eigen();
        let largest = eigen.eigenvalues.amax();
        let mut factor = SmallVec::from_elem(0.0, d * d);
        for (column, &value) in eigen.eigenvalues.iter().enumerate() {
            if value < -1e-12 * largest {
                return Err(MessageError::NotPositiveDefinite {
                    what: "the process noise",
                    pivot: column,
                    value,
                });
            }
            for row in 0..d {
                factor[row * d + column] = eigen.eigenvectors[(row, column)] * value.max(0.0).sqrt();
            }
        }
        Ok(Self::with_covariance(d, d, factor))
    }

    /// Independent noise of these variances, of which any may be zero.
    ///
    /// # Errors
    ///
    /// Where a variance is negative or not finite.
    pub fn diagonal(variances: &[f64]) -> Result<Self, MessageError> {
        let d = variances.len();
        let mut factor = SmallVec::from_elem(0.0, d * d);
        for (k, &variance) in variances.iter().enumerate() {
            if !(variance >= 0.0 && variance.is_finite()) {
                return Err(MessageError::NotPositiveDefinite {
                    what: "the process noise",
                    pivot: k,
                    value: variance,
                });
            }
            factor[k * d + k] = variance.sqrt();
        }
        Ok(Self::with_covariance(d, d, factor))
    }

    /// Noise of the covariance B B' for this factor B (`dimension` rows, row-major). An empty one is no noise, and
    /// entries short of a last row are zero.
    pub fn from_factor(dimension: usize, factor: &[f64]) -> Self {
        let sources = factor.len().div_ceil(dimension.max(1)).max(1);
        let mut factor = SmallVec::from_slice(factor);
        factor.resize(dimension * sources, 0.0);
        Self { dimension, sources, factor, covariance: SmallVec::new() }
    }

    fn with_covariance(dimension: usize, sources: usize, factor: SmallVec<[f64; 16]>) -> Self {
        let mut covariance = SmallVec::from_elem(0.0, dimension * dimension);
        add_product_transposed(&factor, &factor, sources, &mut covariance);
        Self { dimension, sources, factor, covariance }
    }

    /// Adds the covariance B B' to `out` (row-major).
    #[inline]
    pub fn add_covariance(&self, out: &mut [f64]) {
        if self.covariance.is_empty() {
            add_product_transposed(&self.factor, &self.factor, self.sources, out);
        } else {
            out.iter_mut().zip(&self.covariance).for_each(|(out, own)| *out += own);
        }
    }

    /// Number of state coordinates.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of independent sources.
    pub fn sources(&self) -> usize {
        self.sources
    }

    /// The factor B, row-major.
    pub fn factor(&self) -> &[f64] {
        &self.factor
    }

    /// The covariance B B', row-major.
    pub fn covariance(&self) -> Vec<f64> {
        let mut covariance = vec![0.0; self.dimension * self.dimension];
        self.add_covariance(&mut covariance);
        covariance
    }
}

/// What a user writes of a motion.
pub trait Motion: Send + Sync {
    /// Number of state coordinates.
    fn dimension(&self) -> usize;

    /// Writes the next state without noise.
    fn step<T: Real>(&self, state: &[T], next: &mut [T]);

    /// The process noise at a state.
    fn noise(&self, state: &[f64]) -> ProcessNoise;

    /// The process noise, where it is the same at every state: particles are then moved many at a time.
    fn constant_noise(&self) -> Option<&ProcessNoise> {
        None
    }

    /// Writes F (row-major) and returns true where the step is x' = F x at every state: no derivative is taken then.
    fn constant_transition(&self, _transition: &mut [f64]) -> bool {
        false
    }
}

impl<T: Motion> Motion for &T {
    fn dimension(&self) -> usize {
        (**self).dimension()
    }

    fn step<N: Real>(&self, state: &[N], next: &mut [N]) {
        (**self).step(state, next);
    }

    fn noise(&self, state: &[f64]) -> ProcessNoise {
        (**self).noise(state)
    }

    fn constant_noise(&self) -> Option<&ProcessNoise> {
        (**self).constant_noise()
    }

    fn constant_transition(&self, transition: &mut [f64]) -> bool {
        (**self).constant_transition(transition)
    }
}

/// A motion as a factor of two ports: from the state (port 0) to the next (port 1).
pub struct Transition<T> {
    motion: T,
    dimensions: [usize; 2],
}

impl<T: Motion> Transition<T> {
    /// The factor of a motion.
    pub fn new(motion: T) -> Self {
        let d = motion.dimension();
        Self { motion, dimensions: [d, d] }
    }

    /// The motion.
    pub fn motion(&self) -> &T {
        &self.motion
    }

    /// The next state f(x) and the Jacobian F at `x`.
    pub(crate) fn linearise(&self, x: &[f64]) -> (Vector, Matrix) {
        let d = x.len();
        let (mut next, mut jacobian) = (zero_vector(d), zeros(d * d));
        linearise_motion(&self.motion, x, &mut next, &mut jacobian);
        (next, jacobian)
    }

    /// The mean f(x̄) + F (m - x̄) and the covariance F P F' + B B' of the next state, for a state of mean m and
    /// covariance P.
    pub(crate) fn ahead(&self, at: &[f64], mean: &[f64], covariance: &[f64]) -> (Vector, Matrix) {
        let d = at.len();
        let (mut ahead, jacobian) = self.linearise(at);
        let (mut cross, mut predicted) = (zeros(d * d), zeros(d * d));
        propagate(&jacobian, covariance, d, &mut cross, &mut predicted);
        self.motion.noise(at).add_covariance(&mut predicted);
        symmetrise(&mut predicted, d);
        let offset: Vector = mean.iter().zip(at).map(|(mean, at)| mean - at).collect();
        multiply_add(&jacobian, &offset, d, 1, &mut ahead);
        (ahead, predicted)
    }

    /// Mean and covariance of the next state, linearised at the mean: what an estimate between two slices is.
    ///
    /// # Errors
    ///
    /// Where the dimension is not the motion's.
    pub fn predict_moments(&self, state: &Moments) -> Result<Moments, MessageError> {
        let (found, expected) = (state.dimension(), self.dimensions[0]);
        if found != expected {
            return Err(MessageError::Dimension { what: "the state", found, expected });
        }
        let (mean, covariance) = self.ahead(&state.mean, &state.mean, &state.covariance);
        Ok(Moments { mean: mean.to_vec(), covariance: covariance.to_vec() })
    }

    /// Prediction. A proper message by its moments, mean f(x̄) + F (m - x̄) and covariance F P F' + B B'; an
    /// improper one, or one nearly so, as (I + M B B')⁻¹ M, M = F⁻ᵀ Λ F⁻¹, for invertible F.
    fn predict(&self, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        let d = self.dimensions[0];
        let (mut information, mut vector) = (zeros(d * d), zero_vector(d));
        let loss = view.message(0, &mut information, &mut vector)?;
        let moments = proper(&information, &vector);
        let Some(Proper { mean, covariance, inflation }) = moments else {
            return self.predict_improper(view, &information, &vector, loss);
        };
        if inflation > WELL_CONDITIONED {
            // A step that cannot be inverted has no information form, and moments must do.
            if let Ok(draft) = self.predict_improper(view, &information, &vector, loss) {
                return Ok(draft);
            }
        }
        let at = point(view, 0, d)?.unwrap_or_else(|| mean.clone());
        let (ahead, predicted) = self.ahead(&at, &mean, &covariance);
        let information = invert(&predicted, d, "the predicted covariance")?;
        let vector = multiply(&information, &ahead, d, 1).into_iter().collect();
        Ok(GaussianDraft { information, vector, loss })
    }

    fn predict_improper(
        &self,
        view: &dyn GaussianView,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<GaussianDraft, MessageError> {
        let d = self.dimensions[0];
        if information.iter().all(|&entry| entry == 0.0) {
            return Ok(GaussianDraft { information: zeros(d * d), vector: zero_vector(d), loss });
        }
        let at = point(view, 0, d)?.unwrap_or_else(|| zero_vector(d));
        let (next, jacobian) = self.linearise(&at);
        // With y = f(x̄) + F (x - x̄): Λ in y is F⁻ᵀ Λ F⁻¹, and η follows from η - Λ x̄ at y = f(x̄).
        let mut both = zeros(d * (d + 1));
        let centred: Vector = {
            let pulled = multiply(information, &at, d, 1);
            vector.iter().zip(&pulled).map(|(eta, pull)| eta - pull).collect()
        };
        for row in 0..d {
            both[row * (d + 1)..][..d].copy_from_slice(&information[row * d..][..d]);
            both[row * (d + 1) + d] = centred[row];
        }
        let what = "the Jacobian of the motion";
        solve(&mut transpose(&jacobian, d, d), d, &mut both, d + 1, what)?;
        let left: Matrix = (0..d).flat_map(|row| both[row * (d + 1)..][..d].to_vec()).collect();
        let mut moved = transpose(&left, d, d);
        solve(&mut transpose(&jacobian, d, d), d, &mut moved, d, what)?;
        let mut eta: Vector = (0..d).map(|row| both[row * (d + 1) + d]).collect();
        symmetrise(&mut moved, d);
        multiply_add(&moved, &next, d, 1, &mut eta);
        let noise = self.motion.noise(&at);
        let (information, vector) = blur(&noise, &moved, &eta)?;
        Ok(GaussianDraft { information, vector, loss })
    }

    /// Retrodiction: the next state's message blurred by the process noise, F' (I + Λ B B')⁻¹ Λ F.
    fn retrodict(&self, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        let d = self.dimensions[0];
        let (mut information, mut vector) = (zeros(d * d), zero_vector(d));
        let loss = view.message(1, &mut information, &mut vector)?;
        if information.iter().all(|&entry| entry == 0.0) {
            return Ok(GaussianDraft { information, vector, loss });
        }
        let at = point(view, 0, d)?.unwrap_or_else(|| zero_vector(d));
        let (next, jacobian) = self.linearise(&at);
        let noise = self.motion.noise(&at);
        let (blurred, eta) = blur(&noise, &information, &vector)?;
        let back = transpose(&jacobian, d, d);
        let weighted = multiply(&back, &blurred, d, d);
        let mut out = multiply(&weighted, &jacobian, d, d);
        symmetrise(&mut out, d);
        // Linear in x: next state f(x̄) - F x̄ + F x.
        let mut offset = next;
        let moved = multiply(&jacobian, &at, d, 1);
        offset.iter_mut().zip(&moved).for_each(|(next, moved)| *next -= moved);
        let pulled = multiply(&blurred, &offset, d, 1);
        let centred: Vector = eta.iter().zip(&pulled).map(|(eta, pull)| eta - pull).collect();
        let vector = multiply(&back, &centred, d, 1).into_iter().collect();
        Ok(GaussianDraft { information: out, vector, loss })
    }
}

/// The mean of the belief at a port, where it has one.
fn point(view: &dyn GaussianView, port: Port, dimension: usize) -> Result<Option<Vector>, MessageError> {
    let (mut information, mut mean) = (zeros(dimension * dimension), zero_vector(dimension));
    view.belief(port, &mut information, &mut mean)?;
    Ok(proper(&information, &mean).map(|belief| belief.mean))
}

/// A message convolved with zero-mean noise of covariance Q = B B': (I + Λ Q)⁻¹ (Λ, η), for any rank of either.
fn blur(noise: &ProcessNoise, information: &[f64], vector: &[f64]) -> Result<(Matrix, Vector), MessageError> {
    let d = vector.len();
    let mut covariance = zeros(d * d);
    noise.add_covariance(&mut covariance);
    let mut system = multiply(information, &covariance, d, d);
    for k in 0..d {
        system[k * d + k] += 1.0;
    }
    let mut both = zeros(d * (d + 1));
    for row in 0..d {
        both[row * (d + 1)..][..d].copy_from_slice(&information[row * d..][..d]);
        both[row * (d + 1) + d] = vector[row];
    }
    solve(&mut system, d, &mut both, d + 1, "the message blurred by the process noise")?;
    let mut blurred: Matrix = (0..d).flat_map(|row| both[row * (d + 1)..][..d].to_vec()).collect();
    symmetrise(&mut blurred, d);
    Ok((blurred, (0..d).map(|row| both[row * (d + 1) + d]).collect()))
}

impl<T: Motion> Rules for Transition<T> {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn gaussian(&self, to: Port, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        if to == 1 { self.predict(view) } else { self.retrodict(view) }
    }

    /// r = x' - f(x) with the process noise at x; directions that it leaves exact get a little noise.
    fn expand(&self, question: &mut Expansion) -> Result<(), MessageError> {
        let d = self.dimensions[0];
        question.expect(2 * d)?;
        let (before, after) = question.point.split_at(d);
        let noise = Noise::held(self.motion.noise(before).covariance())?;
        let (next, jacobian) = self.linearise(before);
        let residual = after.iter().zip(&next).map(|(after, next)| after - next);
        question.residual.clear();
        question.residual.extend(residual);
        question.chart = Chart::Coordinates;
        question.jacobian.clear();
        for row in 0..d {
            question.jacobian.extend(jacobian[row * d..][..d].iter().map(|entry| -entry));
            question.jacobian.extend((0..d).map(|column| f64::from(u8::from(row == column))));
        }
        question.close(&noise);
        Ok(())
    }

    fn particles(
        &self,
        to: Port,
        view: &dyn ParticleView,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<f64, MessageError> {
        if to == 0 {
            let reason = "a motion sends no particles back in time; hold this edge as a Gaussian to smooth";
            return Err(MessageError::Unsupported(reason.into()));
        }
        let (sample, loss) = view.message(0, form.count, stream)?;
        let guide =
            view.gaussian(1).filter(|guide| !guide.is_flat() && form.proposal != Proposal::Prediction);
        let linear = |x: &[f64]| self.linearise(x);
        let step = |x: &[f64], next: &mut [f64]| self.motion.step(x, next);
        let noise = |x: &[f64]| self.motion.noise(x);
        let prediction =
            Guided { step: &step, linearise: &linear, noise: &noise, coordinates: view.coordinates(1) };
        match guide {
            Some(guide) => prediction.guided(&sample, guide, form, stream, out)?,
            None => plain(&self.motion, view.coordinates(1), &sample, form.count, stream, out)?,
        }
        Ok(loss)
    }

    fn mixture(
        &self,
        to: Port,
        view: &dyn MixtureView,
        form: &MixtureForm,
        _stream: &mut Stream,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let linear = |x: &[f64]| self.linearise(x);
        let noise = |x: &[f64]| self.motion.noise(x);
        let (message, loss) = view.mixture(1 - to, form)?;
        if message.is_flat() {
            return Ok((MixtureMessage::flat(view.coordinates(to)), loss));
        }
        if to == 0 {
            let back = Retrodiction { linearise: &linear, noise: &noise, guide: view.guide(0, None) };
            return Ok((back.message(&message.to_potential())?, loss));
        }
        match message.to_density() {
            Ok(density) => {
                let ahead = |mean: &[f64], covariance: &[f64]| self.ahead(mean, mean, covariance);
                Ok((predict(&density, ahead)?, loss))
            }
            Err(_) if message.len() == 1 => mixture::gaussian(self, to, view),
            Err(error) => Err(error),
        }
    }
}
