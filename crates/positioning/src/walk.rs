//! System `wsn-walk`: a person who carries nothing, tracked by how they disturb the links of a recorded radio network.
//!
//! The state is the walker's position [x, y]; it wanders as a Gaussian random walk within the network's bounding box
//! and a margin. What a position does to a link is read from a [profile](links::Profile) over the excess path length
//!
//! λ = |x − a| + |x − b| − |a − b|
//!
//! of the link's ends a and b: ellipses around them. The profile is learnt from the links alone: the room is empty up
//! to a known time, and from then on positions are unknown and the profile is that of largest likelihood (expectation
//! maximisation over the whole recording, on the grid). The true path scores the estimates and is nothing that the
//! tracker reads.
//!
//! | method | algorithm |
//! |---|---|
//! | `grid` | the exact posterior of this model on a grid |
//! | `pf` | bootstrap particle filter |
//! | `qgpf-mh` | quantum genetic proposals of Metropolis-Hastings chains |
//! | `kcpf` | the knowledge-board swarm as a proposal |
//!
//! Source of the model: Wilson, Patwari, "See-through walls: motion tracking using variance-based radio tomography
//! networks" (2011), for the variance by excess path length; Kaltiokallio, Bocca, Patwari, "Enhancing the accuracy of
//! radio tomographic imaging using channel diversity" (2012), for the channels' fade levels and the recording.

mod area;
mod grid;
pub mod links;
mod path;
mod recording;
mod settings;
mod track;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use area::Area;
use links::Calibration;
use path::TruePath;
use recording::Recording;

pub use settings::{Algorithm, MethodSettings, ModelSettings, WorldSettings};

/// A scenario of system `wsn-walk`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// What is known of the recording.
    pub world: WorldSettings,
    /// What the tracker assumes.
    #[serde(default)]
    pub model: ModelSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

/// What all methods share.
pub struct Prepared {
    recording: Recording,
    path: TruePath,
    area: Area,
    calibration: Calibration,
}

impl Walk {}

impl Scenario for Walk {
    const SYSTEM: &'static str = "wsn-walk";
    const READS_DATA: bool = true;
    type Prepared = Prepared;

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.model.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Prepared, PositioningError> {
        let folder = data.unwrap_or_else(|| Path::new("."));
        let recording = Recording::read(folder)?;
        let path = TruePath::read(folder, &self.world)?;
        let area = Area::around(&recording.nodes, self.model.margin, self.model.cell);
        let calibration = Calibration::learn(&recording, &area, &self.world, &self.model)?;
        Ok(Prepared { recording, path, area, calibration })
    }

    fn run(&self, prepared: &Prepared, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let mut methods = Vec::with_capacity(request.methods.len());
        for id in request.methods {
            let (method, seed) = (self.method.named(id)?, request.method_seed(id));
            methods.push(MethodRun::timed(id, StateLayout::planar_position(), |out| {
                track::run(prepared, &self.model, method, seed, out)?;
                out.diagnose("independent_share", prepared.calibration.independent_share());
                Ok::<(), PositioningError>(())
            })?);
        }
        let anchors = prepared.recording.nodes.iter().enumerate();
        Ok(RunResult {
            run: request.run,
            nodes: vec!["walker".to_owned()],
            anchors: anchors
                .map(|(node, place)| Anchor { name: format!("node {node}"), position: place.to_vec() })
                .collect(),
            methods,
            ..RunResult::default()
        })
    }

    fn check(
        &self,
        prepared: &Prepared,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let links = prepared.recording.pairs().len();
        let summary = |id: &String| {
            let form = self.method.named(id)?.form(&prepared.area);
            let of = |kind: &str, edges| FormUse { kind: kind.to_owned(), form: form.clone(), edges };
            Ok(GraphSummary {
                method: id.clone(),
                extent: "one sweep and the position before it".to_owned(),
                variables: 2,
                factors: 1 + links,
                edges: 2 + links,
                components: 1,
                loops: 0,
                forms: vec![of("prediction", 2), of("links", links)],
                unconstrained: Vec::new(),
            })
        };
        methods.iter().map(summary).collect()
    }
}

#[cfg(test)]
mod tests;
