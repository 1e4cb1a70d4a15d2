//! Saving a run and taking it up again.

use crate::engine::State;
use crate::{Engine, Factor, FactorGraph, GraphError, Message, Options, Topology};
use serde::{Deserialize, Serialize};

/// The version of the layout below; a checkpoint of another version is refused.
const VERSION: u32 = 1;

/// Everything that changes during a run: messages, beliefs, and the iteration count that, with the seed, gives
/// the position of every random stream.
///
/// The graph itself is rebuilt by the program that resumes; a fingerprint of its structure tells whether it is
/// the same. A resumed run equals the uninterrupted one bit for bit, under every schedule whose iterations are
/// alike; [`crate::schedule::Residual`] starts its queue afresh. Text formats must keep every bit of a number
/// (serde_json does so with its feature `float_roundtrip`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint<M> {
    version: u32,
    fingerprint: u64,
    seed: u64,
    iteration: u64,
    messages: Vec<M>,
    sent: Vec<bool>,
    beliefs: Vec<M>,
    guessed: Vec<bool>,
}

impl<'g, M: Message, F: Factor<M>> Engine<'g, M, F> {
    /// The run as it stands.
    pub fn checkpoint(&self) -> Checkpoint<M> {
        let state = self.state();
        Checkpoint {
            version: VERSION,
            fingerprint: fingerprint(self.graph(), self.topology()),
            seed: self.seed(),
            iteration: state.iteration,
            messages: state.messages.clone(),
            sent: state.sent.clone(),
            beliefs: state.beliefs.clone(),
            guessed: state.guessed.clone(),
        }
    }

    /// An engine that goes on from a checkpoint; the seed is the checkpoint's, not that of `options`.
    ///
    /// # Errors
    ///
    /// [`GraphError::Checkpoint`] where it is of another version or another graph, else as [`Engine::new`].
    pub fn resume(
        graph: &'g FactorGraph<M, F>,
        options: Options,
        checkpoint: Checkpoint<M>,
    ) -> Result<Self, GraphError> {
        let Checkpoint { version, fingerprint: saved, seed, iteration, messages, sent, beliefs, guessed } =
            checkpoint;
        if version != VERSION {
            let reason = format!("its version is {version}, this program reads version {VERSION}");
            return Err(GraphError::Checkpoint(reason));
        }
        let topology = Topology::new(graph);
        let edges = topology.edge_count();
        let sizes = messages.len() == edges && sent.len() == edges;
        let sizes = sizes && beliefs.len() == topology.variable_count() && guessed.len() == beliefs.len();
        if saved != fingerprint(graph, &topology) || !sizes {
            let reason = "it was saved from a graph with other variables, factors or edges".to_owned();
            return Err(GraphError::Checkpoint(reason));
        }
        let mut state = State::new(graph, &topology);
        state.stale.fill(false);
        state = State { iteration, messages, sent, beliefs, guessed, ..state };
        Self::with_state(graph, topology, Options { seed, ..options }, state)
    }
}

/// FNV-1a over the structure: names, dimensions, and who touches whom.
fn fingerprint<M: Message, F: Factor<M>>(graph: &FactorGraph<M, F>, topology: &Topology) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let mut feed = |bytes: &[u8]| {
        for &byte in bytes {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    for variable in graph.variable_ids() {
        feed(graph.variable_name(variable).as_bytes());
        feed(&(graph.space(variable).dimension() as u64).to_le_bytes());
    }
    for edge in topology.edges() {
        feed(&topology.factor_of(edge).0.to_le_bytes());
        feed(&topology.variable_of(edge).0.to_le_bytes());
    }
    hash
}
