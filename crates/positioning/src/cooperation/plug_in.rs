//! A neighbour taken for an anchor at the mean of its belief: what many deployed schemes do, and what forgets that the
//! neighbour is uncertain too.

use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{AnyForm, AnyMessage};
use sumprod_models::library::AnchorRange;
use sumprod_models::{Model, Noise, ResidualModel};

use super::network::{DIMENSION, POSITION};

/// A range between two agents, each of which sees the other as a known point.
pub(super) struct PlugInRange {
    measured: f64,
    noise: Noise,
}

impl PlugInRange {
    pub(super) fn new(measured: f64, noise: Noise) -> Self {
        Self { measured, noise }
    }
}

impl Factor<AnyMessage> for PlugInRange {
    fn dimensions(&self) -> &[usize] {
        &[DIMENSION; 2]
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        form: &AnyForm,
        stream: &mut Stream,
    ) -> Result<AnyMessage, MessageError> {
        let neighbour = incoming.message(1 - to).moments()?.mean;
        let at = POSITION.map(|coordinate| neighbour[coordinate]);
        let range = AnchorRange::new(self.measured, at, DIMENSION, POSITION, self.noise.clone())?;
        let own = [incoming.belief(to).clone()];
        Model(ResidualModel(range)).message(0, &Incoming::new(&own, &own, &[0]), form, stream)
    }
}
