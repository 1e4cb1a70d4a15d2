//! The physical field: the biases of two sensors displace all tracks together.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2x4, Matrix4, Vector2, Vector4};

use super::biased_sensors::{Sensors, planar};
use super::em::Displacement;
use super::error::AssociationError;
use super::expectation::{Pull, Residuals};
use super::information::covariance;
use super::tracks::Tracks;

/// Number of biases of two sensors.
pub(super) const BIASES: usize = 4;

/// Halvings of a step before the biases are left where they are.
const HALVINGS: u32 = 20;

/// What is known of the biases beforehand: their mean and covariance in the first scan, and how they wander.
#[derive(Clone, Debug, PartialEq)]
pub struct BiasPrior {
    /// Mean: range offset of the first sensor (m), its azimuth offset (rad), the same of the second.
    pub mean: Vector4<f64>,
    /// Covariance (m², m rad, rad²).
    pub covariance: Matrix4<f64>,
    /// Covariance of their change from one scan to the next; zero where they stand still.
    pub walk: Matrix4<f64>,
}

impl BiasPrior {
    /// Independent biases of zero mean that stand still, with these deviations of ranges (m) and azimuths (rad).
    pub fn independent(range_deviation: f64, azimuth_deviation: f64) -> Self {
        let [range, azimuth] = [range_deviation.powi(2), azimuth_deviation.powi(2)];
        let covariance = Matrix4::from_diagonal(&Vector4::new(range, azimuth, range, azimuth));
        Self { mean: Vector4::zeros(), covariance, walk: Matrix4::zeros() }
    }

    /// The same prior with independent changes of these variances from scan to scan.
    pub fn with_walk(self, range_variance: f64, azimuth_variance: f64) -> Self {
        let walk = Vector4::new(range_variance, azimuth_variance, range_variance, azimuth_variance);
        Self { walk: Matrix4::from_diagonal(&walk), ..self }
    }
}

/// The biases after association, scan by scan.
#[derive(Clone, Debug, PartialEq)]
pub struct BiasPosterior {
    /// Mean: four biases a scan, in the order and units of [`BiasPrior::mean`].
    pub mean: DVector<f64>,
    /// Joint covariance of all scans (m², m rad, rad²).
    pub covariance: DMatrix<f64>,
    scans: usize,
}

impl BiasPosterior {
    /// Mean and covariance in one scan, from 0; `None` beyond the last.
    pub fn scan(&self, scan: usize) -> Option<(Vector4<f64>, Matrix4<f64>)> {
        let start = BIASES * scan;
        let inside = scan < self.scans;
        inside.then(|| {
            (
                self.mean.fixed_rows::<BIASES>(start).into_owned(),
                self.covariance.fixed_view::<BIASES, BIASES>(start, start).into_owned(),
            )
        })
    }

    /// The prior for tracks of later scans, when the biases have changed by a walk of covariance `walk` since the last.
    pub fn next_prior(&self, walk: Matrix4<f64>) -> Option<BiasPrior> {
        let (mean, covariance) = self.scan(self.scans.checked_sub(1)?)?;
        Some(BiasPrior { mean, covariance: covariance + walk, walk })
    }
}

/// Displacements made by the range and azimuth biases of two sensors in the plane.
///
/// Biases that change from scan to scan are as many unknowns as there are scans, tied by the prior's walk.
#[derive(Clone, Debug)]
pub struct BiasField {
    sensors: Sensors,
    prior: BiasPrior,
    first: Vec<Vector2<f64>>,
    /// Number of sets of biases: one, or one a scan where they wander.
    sets: usize,
    scans: usize,
    mean: DVector<f64>,
    precision: DMatrix<f64>,
    biases: DVector<f64>,
    posterior: Option<BiasPosterior>,
}

impl BiasField {
    /// A field under this prior.
    ///
    /// # Errors
    /// [`AssociationError::Parameter`] for sensors or a mean that are not finite, a covariance that is not positive
    /// definite, and a walk that is neither zero nor positive definite.
    pub fn new(sensors: Sensors, prior: BiasPrior) -> Result<Self, AssociationError> {
        let places = sensors.first.iter().chain(&sensors.second).chain(prior.mean.iter());
        if let Some(value) = places.into_iter().find(|value| !value.is_finite()) {
            return Err(AssociationError::parameter(
                "sensors",
                format!("and the prior's mean hold {value}; they must be finite"),
            ));
        }
        let precision = inverse("prior.covariance", &prior.covariance)?;
        if prior.walk != Matrix4::zeros() {
            inverse("prior.walk", &prior.walk)?;
        }
        Ok(Self {
            sensors,
            mean: DVector::from_column_slice(prior.mean.as_slice()),
            precision: DMatrix::from_column_slice(BIASES, BIASES, precision.as_slice()),
            prior,
            first: Vec::new(),
            sets: 1,
            scans: 1,
            biases: DVector::zeros(BIASES),
            posterior: None,
        })
    }

    /// The biases with their covariance, after [`associate`](super::associate).
    ///
    /// The covariance is the inverse of the observed information of the penalised likelihood: what is not known of the
    /// associations widens it, and so does the variance that is estimated from the same tracks.
    pub fn posterior(&self) -> Option<&BiasPosterior> {
        self.posterior.as_ref()
    }

    /// Joint prior of the biases of all scans.
    fn chain(&mut self) -> Result<(), AssociationError> {
        let size = BIASES * self.sets;
        let first = inverse("prior.covariance", &self.prior.covariance)?;
        self.precision = DMatrix::zeros(size, size);
        self.precision.fixed_view_mut::<BIASES, BIASES>(0, 0).copy_from(&first);
        if self.sets > 1 {
            let walk = inverse("prior.walk", &self.prior.walk)?;
            for set in 1..self.sets {
                let (before, here) = (BIASES * (set - 1), BIASES * set);
                for (row, column, sign) in
                    [(before, before, 1.0), (here, here, 1.0), (before, here, -1.0), (here, before, -1.0)]
                {
                    let mut block = self.precision.fixed_view_mut::<BIASES, BIASES>(row, column);
                    block += sign * walk;
                }
            }
        }
        self.mean = DVector::from_fn(size, |i, _| self.prior.mean[i % BIASES]);
        self.biases = self.mean.clone();
        Ok(())
    }

    /// Where the biases of scan `place % scans` put a first track's position, and the derivative.
    fn transfer(&self, place: usize, biases: &DVector<f64>) -> (Vector2<f64>, Matrix2x4<f64>, usize) {
        let set = if self.sets == 1 { 0 } else { place % self.scans };
        let own = Vector4::from_iterator(biases.rows(BIASES * set, BIASES).iter().copied());
        let (moved, derivative) = self.sensors.transfer(self.first[place], &own);
        (moved, derivative, set)
    }

    fn penalty_of(&self, biases: &DVector<f64>) -> f64 {
        let off = biases - &self.mean;
        0.5 * off.dot(&(&self.precision * &off))
    }

    fn places(&self, biases: &DVector<f64>, displacements: &mut [f64]) {
        for (place, displacement) in displacements.chunks_exact_mut(2).enumerate() {
            let change = self.transfer(place, biases).0 - self.first[place];
            displacement.copy_from_slice(change.as_slice());
        }
    }

    /// −Σ P |x − T|²/2σ² − penalty, relative to the places that the pull was taken at.
    fn gain(&self, pull: &Pull, variance: f64, biases: &DVector<f64>, old: &[f64], new: &[f64]) -> f64 {
        let width = 2 * self.scans;
        let mut gain = 0.0;
        let rows = pull.weight.iter().zip(pull.force.chunks_exact(width));
        for ((weight, force), (old, new)) in rows.zip(old.chunks_exact(width).zip(new.chunks_exact(width))) {
            for ((force, old), new) in force.iter().zip(old).zip(new) {
                let change = new - old;
                gain += change * (force - 0.5 * weight * change);
            }
        }
        gain / variance - self.penalty_of(biases)
    }
}

impl Displacement for BiasField {
    fn start(
        &mut self,
        first: &Tracks,
        _scale: f64,
        displacements: &mut [f64],
    ) -> Result<f64, AssociationError> {
        planar(first)?;
        self.scans = first.scans();
        self.sets = if self.prior.walk == Matrix4::zeros() { 1 } else { self.scans };
        self.first = first.coordinates().chunks_exact(2).map(|y| Vector2::new(y[0], y[1])).collect();
        self.posterior = None;
        self.chain()?;
        self.places(&self.mean, displacements);
        let spread: f64 = (0..self.first.len())
            .map(|place| {
                let (_, derivative, _) = self.transfer(place, &self.mean);
                (derivative * self.prior.covariance * derivative.transpose()).trace()
            })
            .sum();
        Ok(if self.first.is_empty() { 1.0 } else { spread / (2.0 * self.first.len() as f64) })
    }

    fn improve(
        &mut self,
        pull: &Pull,
        variance: f64,
        displacements: &mut [f64],
    ) -> Result<(), AssociationError> {
        let mut information = self.precision.clone();
        let mut gradient = &self.precision * (&self.mean - &self.biases);
        for (place, force) in pull.force.chunks_exact(2).enumerate() {
            let weight = pull.weight[place / self.scans];
            if weight == 0.0 {
                continue;
            }
            let (_, derivative, set) = self.transfer(place, &self.biases);
            let turned = derivative.transpose() / variance;
            let mut block = information.fixed_view_mut::<BIASES, BIASES>(BIASES * set, BIASES * set);
            block += weight * turned * derivative;
            let mut part = gradient.fixed_rows_mut::<BIASES>(BIASES * set);
            part += turned * Vector2::new(force[0], force[1]);
        }
        let factors = Cholesky::new(information).ok_or_else(|| AssociationError::Field {
            problem: format!("the biases' information is not positive definite at variance {variance}"),
        })?;
        let mut step = factors.solve(&gradient);
        let mut old = vec![0.0; displacements.len()];
        self.places(&self.biases, &mut old);
        let before = -self.penalty_of(&self.biases);
        for _ in 0..HALVINGS {
            let tried = &self.biases + &step;
            self.places(&tried, displacements);
            if self.gain(pull, variance, &tried, &old, displacements) >= before {
                self.biases = tried;
                return Ok(());
            }
            step *= 0.5;
        }
        displacements.copy_from_slice(&old);
        Ok(())
    }

    fn penalty(&self) -> f64 {
        self.penalty_of(&self.biases)
    }

    fn finish(&mut self, residuals: &Residuals<'_>) -> Result<(), AssociationError> {
        let size = BIASES * self.sets;
        let derivative = |place: usize| {
            let (_, derivative, set) = self.transfer(place, &self.biases);
            (derivative, set)
        };
        let covariance = covariance(residuals, &self.precision, self.scans, derivative).ok_or_else(|| {
            AssociationError::Field { problem: "the biases' information is singular at the end".to_owned() }
        })?;
        let wanted = BIASES * self.scans;
        let spread = |i: usize| if size == wanted { i } else { i % BIASES };
        self.posterior = Some(BiasPosterior {
            mean: DVector::from_fn(wanted, |i, _| self.biases[spread(i)]),
            covariance: DMatrix::from_fn(wanted, wanted, |i, j| covariance[(spread(i), spread(j))]),
            scans: self.scans,
        });
        Ok(())
    }
}

fn inverse(name: &'static str, covariance: &Matrix4<f64>) -> Result<Matrix4<f64>, AssociationError> {
    let symmetric = (covariance - covariance.transpose()).amax() <= 1e-9 * covariance.amax();
    let factors =
        Cholesky::new(*covariance).filter(|_| symmetric && covariance.iter().all(|x| x.is_finite()));
    let inverse = factors.map(|factors| factors.inverse()).filter(|m| m.iter().all(|x| x.is_finite()));
    inverse.ok_or_else(|| {
        let diagonal = covariance.diagonal();
        AssociationError::parameter(
            name,
            format!("with variances {:?} is not a positive definite covariance", diagonal.as_slice()),
        )
    })
}
