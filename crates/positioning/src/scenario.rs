//! The seam between scenario files and systems.
//!
//! A scenario file is a TOML document. The keys of [`Settings`] are common to all; the others (`[world]`,
//! `[method.ID]`, …) belong to the system that `system` names, and are read into that system's [`Scenario`] type.
//! Whoever adds a system implements [`Scenario`] and adds one arm to the program's list of systems.
//!
//! Derive `Deserialize` with `deny_unknown_fields` on every struct and leave `flatten` and untagged enums alone:
//! with them serde loses the path of the key that is wrong, and the message to the user loses its line.

use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

use serde::de::{DeserializeOwned, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sumprod_graph::{Factor, FactorGraph, Message, Purpose, Stream};

use crate::error::PositioningError;
use crate::results::RunResult;

/// Keys that every scenario file may have at its top level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Name of the system, for instance `p-mpa`.
    pub system: String,
    /// Name of the scenario, which the report repeats.
    #[serde(default)]
    pub name: String,
    /// One line for `sumprod list`.
    #[serde(default)]
    pub description: String,
    /// Number of Monte-Carlo runs; 1 for recorded data.
    #[serde(default = "one")]
    pub runs: u32,
    /// Seed of all random draws.
    #[serde(default = "one_u64")]
    pub seed: u64,
    /// The recording's place below the folder of data sets, for instance `mrclam/dataset6`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<String>,
    /// What is written to the output folder.
    #[serde(default)]
    pub output: Output,
}

impl Settings {
    /// The keys, in the order in which messages list them.
    pub const KEYS: [&'static str; 7] = ["system", "name", "description", "runs", "seed", "data", "output"];

    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for zero runs.
    pub fn validate(&self) -> Result<(), PositioningError> {
        if self.runs == 0 {
            return Err(PositioningError::setting("runs", "is 0; at least 1 run is needed"));
        }
        Ok(())
    }
}

fn one() -> u32 {
    1
}

fn one_u64() -> u64 {
    1
}

/// What is written to the output folder besides the metrics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Whether every estimate is written to `estimates.csv`.
    pub estimates: bool,
    /// Whether plots are drawn.
    pub plots: bool,
    /// Run whose trajectories are drawn, from 0.
    pub plotted_run: u32,
    /// Number of 95 % ellipses along each drawn trajectory.
    pub ellipses: u32,
}

impl Default for Output {
    fn default() -> Self {
        Self { estimates: true, plots: true, plotted_run: 0, ellipses: 12 }
    }
}

/// The `[method.ID]` tables of a scenario, in the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Methods<M>(Vec<(String, M)>);

impl<M> Methods<M> {
    /// Methods by id; later ones of the same id are kept as they are, so ids should differ.
    pub fn new(methods: Vec<(String, M)>) -> Self {
        Self(methods)
    }

    /// The settings of one method.
    pub fn get(&self, id: &str) -> Option<&M> {
        self.0.iter().find(|(name, _)| name == id).map(|(_, method)| method)
    }

    /// The settings of a method that must be there.
    ///
    /// # Errors
    /// [`PositioningError::UnknownMethod`].
    pub fn named(&self, id: &str) -> Result<&M, PositioningError> {
        self.get(id)
            .ok_or_else(|| PositioningError::UnknownMethod { method: id.to_owned(), known: self.ids() })
    }

    /// Ids in order.
    pub fn ids(&self) -> Vec<String> {
        self.0.iter().map(|(id, _)| id.clone()).collect()
    }

    /// Ids and settings in order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &M)> {
        self.0.iter().map(|(id, method)| (id.as_str(), method))
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Number of methods.
    pub fn len(&self) -> usize {
        self.0.len()
    }
}

impl<M: Serialize> Serialize for Methods<M> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (id, method) in &self.0 {
            map.serialize_entry(id, method)?;
        }
        map.end()
    }
}

impl<'de, M: Deserialize<'de>> Deserialize<'de> for Methods<M> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Tables<M>(PhantomData<M>);
        impl<'de, M: Deserialize<'de>> Visitor<'de> for Tables<M> {
            type Value = Methods<M>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("tables [method.ID]")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut methods = Vec::with_capacity(map.size_hint().unwrap_or(0));
                while let Some(entry) = map.next_entry()? {
                    methods.push(entry);
                }
                Ok(Methods(methods))
            }
        }
        deserializer.deserialize_map(Tables(PhantomData))
    }
}

/// Which run is wanted, of which methods.
#[derive(Clone, Copy, Debug)]
pub struct RunRequest<'a> {
    /// Seed of the whole campaign.
    pub seed: u64,
    /// Index of the run, from 0. Streams are named by (`seed`, `run`, …), so a run does not depend on the others.
    pub run: u32,
    /// Ids of the methods to run, in order, each known to the scenario.
    pub methods: &'a [String],
}

impl RunRequest<'_> {
    /// Seed of a method's own draws: the same whichever other methods run beside it.
    pub fn method_seed(&self, method: &str) -> u64 {
        // FNV-1a, whose value is fixed for all platforms and versions.
        let hash = method.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        Stream::new(self.seed, u64::from(self.run), Purpose::User(0), hash).id()
    }
}

/// What a system implements so that scenario files can be run on it.
pub trait Scenario: DeserializeOwned + Serialize + Send + Sync {
    /// The value of `system` in scenario files.
    const SYSTEM: &'static str;

    /// Whether the system reads recorded data.
    const READS_DATA: bool;

    /// What is computed or read once and shared by all runs: a data set, a network's layout.
    type Prepared: Send + Sync;

    /// Checks every value, so that a wrong one is found before anything is computed or written.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] with the key's dotted path, the number, and what it must be.
    fn validate(&self) -> Result<(), PositioningError>;

    /// Ids of the methods, in the order of the file.
    fn methods(&self) -> Vec<String>;

    /// Prepares what all runs share. `data` is a folder or a file, and is given exactly if
    /// [`READS_DATA`](Self::READS_DATA) says so; whether it exists is for this method to find out.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming the file and line, or [`PositioningError::Unconstrained`].
    fn prepare(&self, seed: u64, data: Option<&Path>) -> Result<Self::Prepared, PositioningError>;

    /// Runs the methods on one draw of the world, the same for all of them.
    ///
    /// # Errors
    /// [`PositioningError::Method`] when a method fails, [`PositioningError::Estimate`] when it yields numbers
    /// that are not finite.
    fn run(&self, prepared: &Self::Prepared, request: RunRequest<'_>) -> Result<RunResult, PositioningError>;

    /// Describes the graph that each of the methods would run on, without running it.
    ///
    /// # Errors
    /// As [`prepare`](Self::prepare); directions that nothing constrains are reported in the summary, not as errors.
    fn check(
        &self,
        prepared: &Self::Prepared,
        seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError>;
}

/// Size and shape of one method's graph.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GraphSummary {
    /// The method's id.
    pub method: String,
    /// What the counts cover, for instance `one slice` or `the whole recording`.
    pub extent: String,
    /// Number of variables.
    pub variables: usize,
    /// Number of factors.
    pub factors: usize,
    /// Number of edges.
    pub edges: usize,
    /// Number of connected components.
    pub components: usize,
    /// Number of independent loops: edges − (variables + factors) + components.
    pub loops: usize,
    /// The forms of the edges, by kind of edge.
    pub forms: Vec<FormUse>,
    /// One sentence for each set of directions that no factor constrains, and what would.
    pub unconstrained: Vec<String>,
}

impl GraphSummary {
    /// Size and shape of the graph of method `id`, in which nothing is unconstrained.
    pub fn new<M: Message, F: Factor<M>>(
        id: &str,
        extent: impl Into<String>,
        graph: &FactorGraph<M, F>,
        forms: Vec<FormUse>,
    ) -> Self {
        Self {
            method: id.to_owned(),
            extent: extent.into(),
            variables: graph.variable_count(),
            factors: graph.factor_count(),
            edges: graph.edge_count(),
            components: graph.components().len(),
            loops: graph.loop_count(),
            forms,
            unconstrained: Vec::new(),
        }
    }
}

/// How one kind of edge holds its messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FormUse {
    /// Kind of edge, as in `[method.ID.form]`.
    pub kind: String,
    /// The form, for instance `gaussian` or `particles 1000`.
    pub form: String,
    /// Number of edges of this kind.
    pub edges: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_keep_the_order_of_the_file() {
        let methods: Methods<u32> = serde_json::from_str(r#"{"z": 1, "a": 2, "m": 3}"#).unwrap();
        assert_eq!(methods.ids(), ["z", "a", "m"]);
        assert_eq!(methods.get("m"), Some(&3));
        assert_eq!(methods.get("q"), None);
        assert_eq!(serde_json::to_string(&methods).unwrap(), r#"{"z":1,"a":2,"m":3}"#);
    }

    #[test]
    fn the_listed_keys_are_the_ones_serde_knows() {
        let settings: Settings = serde_json::from_str(r#"{"system": "s", "data": "d"}"#).unwrap();
        let value = serde_json::to_value(&settings).unwrap();
        let mut known: Vec<_> = value.as_object().unwrap().keys().cloned().collect();
        let mut listed = Settings::KEYS.to_vec();
        known.sort();
        listed.sort();
        assert_eq!(known, listed);
    }

    #[test]
    fn zero_runs_are_refused() {
        let settings: Settings = serde_json::from_str(r#"{"system": "s", "runs": 0}"#).unwrap();
        assert!(settings.validate().unwrap_err().to_string().contains("`runs`"));
    }
}
