//! The rules that follow from a residual or a motion, one module per family.

pub(crate) mod linearised;
pub(crate) mod particles;

use smallvec::SmallVec;
use sumprod_graph::{Coordinate, Incoming, MessageError, Port, Stream};
use sumprod_messages::{
    DynamicGaussian, GaussianFamily, GaussianForm, ParticleFamily, Particles, ParticlesForm,
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

    /// Whether a message to a single port never changes.
    fn is_constant(&self) -> bool {
        false
    }
}

/// Messages and beliefs at a factor's ports, with the form of the edge the message is for.
pub(crate) struct View<'a, 'i, M> {
    pub(crate) incoming: &'a Incoming<'i, M>,
    pub(crate) form: GaussianForm,
}

impl<M: GaussianFamily> GaussianView for View<'_, '_, M> {
    fn message(&self, port: Port, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        self.incoming.message(port).read_information(information, vector)
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
