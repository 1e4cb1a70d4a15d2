//! System `product`: the product of the mixtures in a file, by several methods side by side.
//!
//! A file holds mixtures of Gaussians over one variable; their normalised product is the belief of a variable whose
//! incoming messages they are. Where the file records the exact answer, each method is held against it.
//!
//! | reported | is |
//! |---|---|
//! | `log_evidence` | log of the integral of the product, exact or estimated |
//! | `n_eff`, `divergence`, `label_change` | of the method's [quality](sumprod_messages::ProductQuality) |
//! | `modes` | number of local maxima found |
//! | `error.mean` | largest error of the mean along a coordinate, in exact standard deviations |
//! | `error.covariance` | largest error of an entry of the covariance, over the exact deviations of its row and column |
//! | `error.log_evidence` | size of the error of `log_evidence` |
//! | `error.mode_mass` | largest error of the mass about a recorded mode, found modes counted to the nearest |
//!
//! Run 0 leaves `product-ID.json` (mean, covariance, mode masses, the method chosen, its quality) and
//! `samples-ID.csv` (a coordinate a column, points of equal weight).

mod file;
pub mod method;
mod record;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};
use sumprod_messages::{Exact, Mixture, ProductChoice};

use crate::error::PositioningError;
use crate::results::{MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use file::Recorded;
use method::MethodSettings;
use record::Found;

/// Sum of the inputs' components, times points that climb to modes, up to which all of a method's points climb.
const CLIMBS: usize = 500_000;

/// Fewest points that climb.
const FEWEST: usize = 100;

/// A scenario of system `product`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Product {
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

/// The mixtures of one file.
#[derive(Clone, Debug)]
pub struct Prepared {
    path: PathBuf,
    inputs: Vec<Mixture>,
    recorded: Option<Recorded>,
}

impl Prepared {
    fn choices(&self) -> f64 {
        self.inputs.iter().map(|input| input.len() as f64).product()
    }
}

impl Product {
    fn method(&self, id: &str, prepared: &Prepared) -> Result<&MethodSettings, PositioningError> {
        let method = self.method.named(id)?;
        let (choices, limit) = (prepared.choices(), Exact::default().limit);
        if method.product == ProductChoice::Exact && choices > limit as f64 {
            let problem = format!(
                "is \"exact\", which enumerates at most {limit} label choices, and {} has {choices:.1e}; name the other methods with --method, or choose another product",
                prepared.path.display()
            );
            return Err(PositioningError::setting(format!("method.{id}.product"), problem));
        }
        Ok(method)
    }
}

impl Scenario for Product {
    const SYSTEM: &'static str = "product";
    const READS_DATA: bool = true;
    type Prepared = Prepared;

    fn validate(&self) -> Result<(), PositioningError> {
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Prepared, PositioningError> {
        let path = data.unwrap_or(Path::new("")).to_path_buf();
        let (inputs, recorded) = file::read(&path)?;
        Ok(Prepared { path, inputs, recorded })
    }

    fn run(&self, prepared: &Prepared, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let chosen: Vec<&MethodSettings> =
            request.methods.iter().map(|id| self.method(id, prepared)).collect::<Result<_, _>>()?;
        let mut result = RunResult { run: request.run, ..RunResult::default() };
        for (id, method) in request.methods.iter().zip(chosen) {
            let (done, found) = multiply(id, method, prepared, request.method_seed(id))?;
            let mut done = done;
            found.report(prepared.recorded.as_ref(), &mut done);
            if request.run == 0 {
                done.notes.extend(found.notes());
                result.files.extend(found.files(id)?);
            }
            result.methods.push(done);
        }
        Ok(result)
    }

    fn check(
        &self,
        prepared: &Prepared,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let count = prepared.inputs.len();
        let mut sizes: Vec<usize> = prepared.inputs.iter().map(Mixture::len).collect();
        sizes.sort_unstable();
        sizes.dedup();
        let with = |id: &String, size: &usize| -> Result<FormUse, PositioningError> {
            let product = self.method(id, prepared)?.name();
            let edges = prepared.inputs.iter().filter(|input| input.len() == *size).count();
            let form = format!("mixture {size} (product {product})");
            Ok(FormUse { kind: "input".to_owned(), form, edges })
        };
        let summary = |id: &String| {
            Ok(GraphSummary {
                method: id.clone(),
                extent: format!("one variable of dimension {}", prepared.inputs[0].dimension()),
                variables: 1,
                factors: count,
                edges: count,
                components: 1,
                loops: 0,
                forms: sizes.iter().map(|size| with(id, size)).collect::<Result<_, _>>()?,
                unconstrained: Vec::new(),
            })
        };
        methods.iter().map(summary).collect()
    }
}

/// One product, timed, with its modes, which are not.
fn multiply(
    id: &str,
    method: &MethodSettings,
    prepared: &Prepared,
    seed: u64,
) -> Result<(MethodRun, Found), PositioningError> {
    // Whatever goes wrong is the file's doing: mixtures that contradict each other, or numbers at the edge of f64.
    let failed = |error: sumprod_graph::MessageError| {
        PositioningError::data(&prepared.path, None, format!("method `{id}`: {error}"))
    };
    let inputs: Vec<&Mixture> = prepared.inputs.iter().collect();
    let stream = |entity| Stream::new(seed, 0, Purpose::User(0), entity);
    let chosen = method.method();
    let mut product = None;
    let layout = StateLayout::default();
    let done = MethodRun::timed(id, layout, |_| {
        product = Some(chosen.product(&inputs, method.samples, &mut stream(0)).map_err(failed)?);
        Ok(())
    })?;
    let Some(mut product) = product else {
        return Err(PositioningError::method(id, "it left no product"));
    };
    let size: usize = inputs.iter().map(|input| input.len()).sum();
    let climbing = method.samples.min((CLIMBS / size).max(FEWEST));
    let modes = product.find_modes(&inputs, climbing, &mut stream(1)).map_err(failed)?;
    let points = product.equally_weighted(method.samples, &mut stream(2)).map_err(failed)?;
    Ok((done, Found { product, modes, points }))
}

#[cfg(test)]
mod tests;
