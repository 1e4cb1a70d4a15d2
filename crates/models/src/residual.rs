//! Measurements and constraints: a function that should be zero, and its noise.

use crate::dual::{Lanes, differentiate};
use crate::{Expansion, Noise, Real};
use smallvec::SmallVec;
use sumprod_graph::{FastStream, MessageError, Port, wrap_angle};

/// Draws one port's variable given the others: a ring around an anchor, a relative step.
pub trait PortSampler: Send + Sync {
    /// Writes a draw for the sampled port; `others` are the variables at all ports, in order, of which the sampled
    /// port's own is arbitrary.
    fn sample(&self, others: &[&[f64]], out: &mut [f64], random: &mut FastStream);
}

/// A residual that is the distance between two points of the plane less a radius: seen from one point, a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// The radius, in the unit of the coordinates.
    pub radius: f64,
    /// The receiver's coordinates that make its point.
    pub position: [usize; 2],
    /// The other point.
    pub centre: RingCentre,
}

/// The middle of a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RingCentre {
    /// A point that is known.
    Fixed([f64; 2]),
    /// The variable at a port, its point being at these coordinates.
    Port(Port, [usize; 2]),
}

/// What a user writes of a measurement or constraint.
///
/// The factor is the noise's density at the residual: f(x) = p(r(x)).
///
/// ```
/// use sumprod_models::{Noise, Real, Residual};
///
/// struct Altitude { metres: f64, noise: Noise }
///
/// impl Residual for Altitude {
///     fn dimensions(&self) -> &[usize] { &[3] }
///     fn noise(&self) -> &Noise { &self.noise }
///     fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) { out[0] = x[0][2] - self.metres; }
/// }
/// ```
pub trait Residual: Send + Sync {
    /// The dimension of each port.
    fn dimensions(&self) -> &[usize];

    /// Writes the residual at `x`, one slice per port; `out` has the noise's dimension.
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]);

    /// The residual's noise.
    fn noise(&self) -> &Noise;

    /// Components of the residual that are angles: they are wrapped into (-π, π].
    fn angles(&self) -> &[usize] {
        &[]
    }

    /// Degrees of freedom of each port: fewer than its dimension where it is a pose in space.
    fn degrees_of_freedom(&self) -> &[usize] {
        self.dimensions()
    }

    /// Writes the residual and its derivative (row-major, one column per coordinate or degree of freedom of the
    /// ports, one after the other) in closed form, and says which; none where dual numbers are to find it.
    fn closed_form(&self, _x: &[&[f64]], _residual: &mut [f64], _jacobian: &mut [f64]) -> Option<Chart> {
        None
    }

    /// A known place that the residual refers to (m), for instance an anchor's: what tells a world from its mirror
    /// image.
    fn known_place(&self) -> Option<&[f64]> {
        None
    }

    /// A sampler for a port, used where the receiver has no particles yet.
    fn sampler(&self, _port: Port) -> Option<&dyn PortSampler> {
        None
    }

    /// The ring that this residual is for a port, where it is one: mixture messages then are rings of kernels, and
    /// need no belief of the receiver.
    fn ring(&self, _port: Port) -> Option<Ring> {
        None
    }
}

impl<R: Residual> Residual for &R {
    fn dimensions(&self) -> &[usize] {
        (**self).dimensions()
    }

    #[inline(always)]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        (**self).residual(x, out);
    }

    fn noise(&self) -> &Noise {
        (**self).noise()
    }

    fn angles(&self) -> &[usize] {
        (**self).angles()
    }

    fn sampler(&self, port: Port) -> Option<&dyn PortSampler> {
        (**self).sampler(port)
    }

    fn degrees_of_freedom(&self) -> &[usize] {
        (**self).degrees_of_freedom()
    }

    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        (**self).closed_form(x, residual, jacobian)
    }

    fn known_place(&self) -> Option<&[f64]> {
        (**self).known_place()
    }

    fn ring(&self, port: Port) -> Option<Ring> {
        (**self).ring(port)
    }
}

/// What the columns of a derivative stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Chart {
    /// The stored coordinates of the ports' variables.
    #[default]
    Coordinates,
    /// Steps in the local coordinates of the ports' variables; of a pose, in its own frame.
    Local,
}

/// A residual behind a pointer: what the Gaussian rules need of it.
pub trait Linearised: Send + Sync {
    /// The dimension of each port.
    fn dimensions(&self) -> &[usize];

    /// The residual's noise.
    fn noise(&self) -> &Noise;

    /// Writes the residual at `x`, all ports' variables one after the other; angles wrapped.
    fn evaluate(&self, x: &[f64], residual: &mut [f64]);

    /// Writes the residual (m) and its Jacobian (m by n, row-major) at `x` (n).
    fn linearise(&self, x: &[f64], residual: &mut [f64], jacobian: &mut [f64]);

    /// Components of the residual that are angles.
    fn angles(&self) -> &[usize];
}

/// A residual with the rules that follow from it.
pub struct ResidualModel<R>(pub R);

/// Cuts one slice into the ports' variables.
fn ports<'a, T>(x: &'a [T], dimensions: &[usize]) -> SmallVec<[&'a [T]; 4]> {
    let mut rest = x;
    dimensions
        .iter()
        .map(|&dimension| {
            let (own, others) = rest.split_at(dimension);
            rest = others;
            own
        })
        .collect()
}

#[inline]
fn wrap(angles: &[usize], residual: &mut [f64]) {
    for &angle in angles {
        residual[angle] = wrap_angle(residual[angle]);
    }
}

impl<R: Residual> ResidualModel<R> {
    /// Writes the residual at these variables, one slice per port; angles wrapped.
    #[inline(always)]
    pub(crate) fn residual_at(&self, x: &[&[f64]], residual: &mut [f64]) {
        self.0.residual(x, residual);
        wrap(self.0.angles(), residual);
    }
}

impl<R: Residual> Linearised for ResidualModel<R> {
    fn dimensions(&self) -> &[usize] {
        self.0.dimensions()
    }

    fn noise(&self) -> &Noise {
        self.0.noise()
    }

    fn evaluate(&self, x: &[f64], residual: &mut [f64]) {
        self.0.residual(&ports(x, self.0.dimensions()), residual);
        wrap(self.0.angles(), residual);
    }

    fn linearise(&self, x: &[f64], residual: &mut [f64], jacobian: &mut [f64]) {
        let dimensions = self.0.dimensions();
        let known = self.0.degrees_of_freedom() == dimensions
            && self.0.closed_form(&ports(x, dimensions), residual, jacobian) == Some(Chart::Coordinates);
        if known {
            return wrap(self.0.angles(), residual);
        }
        self.differentiate(x, residual, jacobian);
    }

    fn angles(&self) -> &[usize] {
        self.0.angles()
    }
}

impl<R: Residual> ResidualModel<R> {
    fn differentiate(&self, x: &[f64], residual: &mut [f64], jacobian: &mut [f64]) {
        let dimensions = self.0.dimensions();
        let evaluate = |x: &[Lanes], out: &mut [Lanes]| self.0.residual(&ports(x, dimensions), out);
        differentiate(x, residual, jacobian, evaluate);
        wrap(self.0.angles(), residual);
    }

    /// The answer to a joint solve's question.
    pub(crate) fn expand(&self, question: &mut Expansion) -> Result<(), MessageError> {
        let (dimensions, freedoms) = (self.0.dimensions(), self.0.degrees_of_freedom());
        let noise = self.0.noise();
        let m = noise.dimension();
        let (wide, narrow) = (dimensions.iter().sum::<usize>(), freedoms.iter().sum::<usize>());
        question.expect(wide)?;
        let Expansion { point, derivative, residual, jacobian, chart, places, .. } = &mut *question;
        residual.resize(m, 0.0);
        if let Some(place) = self.0.known_place() {
            places.push(place.to_vec());
        }
        if !*derivative {
            self.evaluate(point, residual);
            question.close(noise);
            return Ok(());
        }
        jacobian.resize(m * wide.max(narrow), 0.0);
        match self.0.closed_form(&ports(point, dimensions), residual, jacobian) {
            Some(found) => {
                *chart = found;
                wrap(self.0.angles(), residual);
            }
            None => {
                *chart = Chart::Coordinates;
                self.differentiate(point, residual, jacobian);
            }
        }
        jacobian.truncate(m * if *chart == Chart::Local { narrow } else { wide });
        question.close(noise);
        Ok(())
    }
}
