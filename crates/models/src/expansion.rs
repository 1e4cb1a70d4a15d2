//! What joint solves ask of a factor: its residual and derivative at a point, whitened.

use crate::{Chart, Noise};
use sumprod_graph::MessageError;

/// A question to a factor, by [`sumprod_graph::Factor::answer`], and its answer.
///
/// The answer is W r(x) and W J with W'W = R⁻¹, both scaled by the root of the weight that heavy-tailed noise gives the
/// residual, so that the factor's information is J'W'W J. Storage is reused from one question to the next.
#[derive(Clone, Debug, Default)]
pub struct Expansion {
    /// Asked: the stored coordinates of all ports, one after the other.
    pub point: Vec<f64>,
    /// Asked: whether the derivative is wanted too.
    pub derivative: bool,
    /// The whitened residual.
    pub residual: Vec<f64>,
    /// Its derivative, row-major; as many columns as the ports have coordinates or degrees of freedom.
    pub jacobian: Vec<f64>,
    /// Which of the two.
    pub chart: Chart,
    /// The negative log density less its least: half the squared whitened residual of Gaussian noise.
    pub loss: f64,
    /// The largest log density there is.
    pub log_peak: f64,
    /// Known places that the factor refers to (m).
    pub places: Vec<Vec<f64>>,
    /// Why the factor has no residual here.
    pub refusal: Option<MessageError>,
}

impl Expansion {
    /// Clears the last answer, and asks anew; the caller fills [`Expansion::point`].
    pub fn ask(&mut self, derivative: bool) {
        self.point.clear();
        self.places.clear();
        (self.derivative, self.loss, self.log_peak, self.refusal) = (derivative, 0.0, 0.0, None);
    }

    /// Refuses a point of the wrong size.
    pub(crate) fn expect(&self, expected: usize) -> Result<(), MessageError> {
        let found = self.point.len();
        if found == expected {
            return Ok(());
        }
        Err(MessageError::Dimension { what: "the point of a factor", found, expected })
    }

    /// Whitens a residual and its derivative, and weights them.
    pub(crate) fn close(&mut self, noise: &Noise) {
        noise.whiten(&mut self.residual);
        if self.derivative {
            noise.whiten(&mut self.jacobian);
        }
        self.log_peak += noise.log_peak();
        let squared: f64 = self.residual.iter().map(|r| r * r).sum();
        match noise.degrees_of_freedom() {
            None => self.loss += 0.5 * squared,
            Some(nu) => {
                self.loss += 0.5 * (nu + noise.dimension() as f64) * (squared / nu).ln_1p();
                let root = noise.weight(squared).sqrt();
                self.residual.iter_mut().for_each(|r| *r *= root);
                if self.derivative {
                    self.jacobian.iter_mut().for_each(|entry| *entry *= root);
                }
            }
        }
    }
}
