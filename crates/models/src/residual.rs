//! Measurements and constraints: a function that should be zero, and its noise.

use crate::dual::{Lanes, differentiate};
use crate::{Noise, Real};
use smallvec::SmallVec;
use sumprod_graph::{FastStream, Port, wrap_angle};

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
        let evaluate = |x: &[Lanes], out: &mut [Lanes]| self.0.residual(&ports(x, dimensions), out);
        differentiate(x, residual, jacobian, evaluate);
        wrap(self.0.angles(), residual);
    }

    fn angles(&self) -> &[usize] {
        self.0.angles()
    }
}
