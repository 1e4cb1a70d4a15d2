//! The clique's messages in the forms of its edges.

use super::RangeClique;
use crate::rules::{GaussianDraft, GaussianView, MixtureView, ParticleView, Rules};
use crate::small::{zero_vector, zeros};
use sumprod_graph::{MessageError, Port, Stream};
use sumprod_messages::{DynamicGaussian, Mixture, MixtureForm, MixtureMessage, Particles, ParticlesForm};

impl Rules for RangeClique {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn gaussian(&self, to: Port, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        let start = self.landmark(view)?;
        let message = match to {
            0 => self.gaussian_to_trajectory(&mean_at(self, view, 0)?, start)?,
            _ => as_message(&self.gaussian(&self.trajectory(view)?, start)?.0)?,
        };
        let d = self.dimensions[to];
        let mut information = zeros(d * d);
        message.write_matrix(&mut information);
        Ok(GaussianDraft { information, vector: message.information_vector().into(), loss: 0.0 })
    }

    fn mixture(
        &self,
        to: Port,
        view: &dyn MixtureView,
        form: &MixtureForm,
        _stream: &mut Stream,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let message = match to {
            0 => {
                let message = self.to_trajectory(&mean_at(self, view, 0)?)?;
                MixtureMessage::from_gaussian(view.coordinates(0), &message)
            }
            _ => self.mixture(&self.trajectory(view)?, form.components)?.0.into(),
        };
        Ok((message, 0.0))
    }

    fn particles(
        &self,
        _to: Port,
        _view: &dyn ParticleView,
        _form: &ParticlesForm,
        _stream: &mut Stream,
        _out: &mut Particles,
    ) -> Result<f64, MessageError> {
        let reason = "a clique of ranges has no particle messages; hold its edges as mixtures or Gaussians";
        Err(MessageError::Unsupported(reason.into()))
    }
}

impl RangeClique {
    /// The message from the trajectory.
    fn trajectory<V: GaussianView + ?Sized>(&self, view: &V) -> Result<DynamicGaussian, MessageError> {
        let n = self.dimensions[0];
        let (mut information, mut vector) = (zeros(n * n), zero_vector(n));
        view.message(0, &mut information, &mut vector)?;
        DynamicGaussian::from_information(&information, &vector)
    }

    /// Where the clique's belief has the landmark.
    fn landmark(&self, view: &dyn GaussianView) -> Result<[f64; 2], MessageError> {
        let clique = mean_at(self, view, 1).map_err(|_| {
            let reason = "a Gaussian clique needs a point to climb from; give its variable a start";
            MessageError::Unsupported(reason.into())
        })?;
        let own = self.positions.len();
        Ok([clique[own], clique[own + 1]])
    }
}

/// The mean of the belief at a port.
fn mean_at<V: GaussianView + ?Sized>(
    clique: &RangeClique,
    view: &V,
    port: Port,
) -> Result<Vec<f64>, MessageError> {
    let d = clique.dimensions[port];
    let (mut information, mut vector) = (zeros(d * d), zero_vector(d));
    view.belief(port, &mut information, &mut vector)?;
    let mut mean = vec![0.0; d];
    DynamicGaussian::from_information(&information, &vector)?.mean_into(&mut mean)?;
    Ok(mean)
}

/// The one component of a mixture.
fn as_message(single: &Mixture) -> Result<DynamicGaussian, MessageError> {
    DynamicGaussian::from_moments(single.mean_of(0), single.covariance_of(0))
}
