//! The rules that follow from a residual or a motion, one module per family.

mod exponential;
pub(crate) mod linearised;
pub(crate) mod mixture;
pub(crate) mod particles;
mod selection;

use crate::Expansion;
use crate::small::{multiply_add, proper, zero_vector, zeros};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use sumprod_graph::{Coordinate, Incoming, MessageError, Port, Stream};
use sumprod_messages::{
    BandwidthChoice, DynamicGaussian, GaussianFamily, GaussianForm, Mixture, MixtureFamily, MixtureForm,
    MixtureMessage, Moments, ParticleFamily, Particles, ParticlesForm, floor_diagonal,
};

/// What a Gaussian rule sees of the messages and beliefs at a factor's ports, whatever their family.
pub trait GaussianView {
    /// The message from a port: writes information (row-major) and information vector, returns what reading it as
    /// a Gaussian cost (nats).
    ///
    /// # Errors
    ///
    /// Where it cannot be read as a Gaussian.
    fn message(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError>;

    /// The belief at a port, likewise.
    ///
    /// # Errors
    ///
    /// As [`GaussianView::message`].
    fn belief(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError>;

    /// How the edge makes nonlinear factors linear.
    fn form(&self) -> GaussianForm;
}

/// A Gaussian message on its way out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianDraft {
    /// Row-major.
    pub information: SmallVec<[f64; 36]>,
    /// The information vector.
    pub vector: SmallVec<[f64; 6]>,
    /// What conversions cost (nats).
    pub loss: f64,
}

/// What a particle rule sees at a factor's ports.
pub trait ParticleView {
    /// The message from a port as particles, at most `count` where they must be drawn, and the cost (nats).
    ///
    /// # Errors
    ///
    /// Where the message cannot be drawn from.
    fn message(
        &self,
        port: Port,
        count: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError>;

    /// The belief at a port, where it is held by particles.
    fn particles(&self, port: Port) -> Option<&Particles>;

    /// The belief at a port, where it is held by a Gaussian.
    fn gaussian(&self, port: Port) -> Option<&DynamicGaussian>;

    /// The coordinates of the variable at a port.
    fn coordinates(&self, port: Port) -> &[Coordinate];
}

/// What a mixture rule sees at a factor's ports.
pub trait MixtureView: GaussianView {
    /// The message from a port as a mixture of at most what `form` holds, and the cost (nats).
    ///
    /// # Errors
    ///
    /// Where it is the values of a likelihood.
    fn mixture(&self, port: Port, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError>;

    /// The same on the coordinates `read` alone; none where the others cannot be summed out.
    ///
    /// # Errors
    ///
    /// As [`MixtureView::mixture`].
    fn marginal(
        &self,
        port: Port,
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError>;

    /// Mean and covariance of the belief at a port, where it is a distribution.
    fn moments(&self, port: Port) -> Option<Moments>;

    /// The belief at a port, where it is a distribution, on the coordinates `read` if given: where a rule spends its
    /// components.
    fn guide(&self, port: Port, read: Option<&[usize]>) -> Option<Mixture>;

    /// The coordinates of the variable at a port.
    fn coordinates(&self, port: Port) -> &[Coordinate];
}

/// A factor's rules, written once for all families.
pub trait Rules: Send + Sync {
    /// The dimension of each port.
    fn dimensions(&self) -> &[usize];

    /// The Gaussian message to port `to`.
    ///
    /// # Errors
    ///
    /// Where linearisation has no point, or a matrix cannot be inverted.
    fn gaussian(&self, to: Port, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError>;

    /// The particle message to port `to`, into `out`; returns what conversions cost (nats).
    ///
    /// # Errors
    ///
    /// Where there is nothing to sample from, or every weight vanishes.
    fn particles(
        &self,
        to: Port,
        view: &dyn ParticleView,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<f64, MessageError>;

    /// The mixture message to port `to`, and what reading the senders as mixtures cost (nats); the Gaussian rule's
    /// message where a factor has no other.
    ///
    /// # Errors
    ///
    /// Where there is no point to linearise at, or a sender's distribution is not known.
    fn mixture(
        &self,
        to: Port,
        view: &dyn MixtureView,
        _form: &MixtureForm,
        _stream: &mut Stream,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        mixture::gaussian(self, to, view)
    }

    /// The residual and its derivative, for joint solves.
    ///
    /// # Errors
    ///
    /// Where the factor has none.
    fn expand(&self, _question: &mut Expansion) -> Result<(), MessageError> {
        let reason = "it has rules for messages alone; give it a residual to solve it jointly with others";
        Err(MessageError::Unsupported(reason.into()))
    }

    /// Whether a message to a single port never changes.
    fn is_constant(&self) -> bool {
        false
    }
}

/// Messages and beliefs at a factor's ports, with the form of the edge the message is for.
pub(crate) struct View<'a, 'i, M> {
    pub(crate) incoming: &'a Incoming<'i, M>,
    pub(crate) form: GaussianForm,
    /// The coordinates of a message whose angles are read in (-π, π] and not on a turn of its own; none of others.
    pub(crate) wrapped: fn(&M) -> &[Coordinate],
}

impl<M: GaussianFamily> View<'_, '_, M> {
    /// Moves a message to the turn of the belief, where rules linearise.
    fn align(&self, port: Port, information: &[f64], vector: &mut [f64]) -> Result<(), MessageError> {
        let (message, belief) = (self.incoming.message(port), self.incoming.belief(port));
        let coordinates = match (self.wrapped)(message) {
            [] => (self.wrapped)(belief),
            coordinates => coordinates,
        };
        if !coordinates.contains(&Coordinate::Angle) {
            return Ok(());
        }
        let d = coordinates.len();
        let (mut own, mut own_vector) = (zeros(d * d), zero_vector(d));
        belief.read_information(&mut own, &mut own_vector)?;
        let (Some(at), Some(from)) = (proper(&own, &own_vector), proper(information, vector)) else {
            return Ok(());
        };
        let mut turns = zero_vector(d);
        for (k, turn) in turns.iter_mut().enumerate().filter(|(k, _)| coordinates[*k] == Coordinate::Angle) {
            *turn = TAU * ((at.mean[k] - from.mean[k]) / TAU).round();
        }
        multiply_add(information, &turns, d, 1, vector);
        Ok(())
    }
}

impl<M: GaussianFamily> GaussianView for View<'_, '_, M> {
    fn message(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        let loss = self.incoming.message(port).read_information(information, vector)?;
        self.align(port, information, vector)?;
        Ok(loss)
    }

    fn belief(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        self.incoming.belief(port).read_information(information, vector)
    }

    fn form(&self) -> GaussianForm {
        self.form
    }
}

impl<M: ParticleFamily> ParticleView for View<'_, '_, M> {
    fn message(
        &self,
        port: Port,
        count: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError> {
        self.incoming.message(port).read_particles(count, stream)
    }

    fn particles(&self, port: Port) -> Option<&Particles> {
        self.incoming.belief(port).as_particles().filter(|particles| !particles.is_empty())
    }

    fn gaussian(&self, port: Port) -> Option<&DynamicGaussian> {
        self.incoming.belief(port).as_gaussian()
    }

    fn coordinates(&self, port: Port) -> &[Coordinate] {
        self.incoming.belief(port).coordinates()
    }
}

/// A view of messages that can be read as mixtures, with the form to read beliefs in.
pub(crate) struct WithForm<'a, 'i, M> {
    pub(crate) view: View<'a, 'i, M>,
    pub(crate) form: &'a MixtureForm,
    pub(crate) coordinates: fn(&M) -> &[Coordinate],
}

impl<M: GaussianFamily> GaussianView for WithForm<'_, '_, M> {
    fn message(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        GaussianView::message(&self.view, port, information, vector)
    }

    fn belief(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        self.view.belief(port, information, vector)
    }

    fn form(&self) -> GaussianForm {
        self.view.form
    }
}

impl<M: GaussianFamily + MixtureFamily> MixtureView for WithForm<'_, '_, M> {
    fn mixture(&self, port: Port, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError> {
        self.view.incoming.message(port).read_mixture(form)
    }

    fn marginal(
        &self,
        port: Port,
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        self.view.incoming.message(port).read_marginal(read, form)
    }

    fn moments(&self, port: Port) -> Option<Moments> {
        let belief = self.view.incoming.belief(port);
        let mut moments = if belief.is_proper() { belief.known_moments() } else { None }?;
        floor_diagonal(&mut moments.covariance, moments.mean.len());
        Some(moments)
    }

    fn guide(&self, port: Port, read: Option<&[usize]>) -> Option<Mixture> {
        let belief = self.view.incoming.belief(port);
        if !belief.is_proper() {
            return None;
        }
        // Kernels of a simple rule will do to say where components are worth spending.
        let form = MixtureForm { bandwidth: BandwidthChoice::Silverman, ..*self.form };
        let belief = match read {
            Some(read) => belief.read_marginal(read, &form).ok().flatten(),
            None => belief.read_mixture(&form).ok(),
        };
        belief.and_then(|(belief, _)| belief.to_density().ok())
    }

    fn coordinates(&self, port: Port) -> &[Coordinate] {
        (self.coordinates)(self.view.incoming.belief(port))
    }
}
