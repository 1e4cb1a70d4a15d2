//! Prior messages pinned to variables, as factors.

use crate::ExactError;
use crate::solve::dot;
use sumprod_graph::{Factor, FactorGraph, Space, VariableId};
use sumprod_messages::{Cholesky, GaussianFamily};
use sumprod_models::{Chart, Expansion};

/// A prior pinned to a variable, as a factor: W (x - μ) with W'W the information.
#[derive(Clone, Debug)]
pub(crate) struct Pinned {
    pub(crate) variable: u32,
    pub(crate) mean: Vec<f64>,
    /// Upper triangular, row-major.
    whitening: Vec<f64>,
    log_peak: f64,
}

impl Pinned {
    /// Answers as a factor of the graph does.
    pub(crate) fn expand(&self, space: &Space, out: &mut Expansion) {
        let d = self.mean.len();
        let mut offset: Vec<f64> = out.point.iter().zip(&self.mean).map(|(x, mean)| x - mean).collect();
        space.wrap(&mut offset);
        out.residual.clear();
        out.residual.extend(self.whitening.chunks_exact(d).map(|row| dot(row, &offset)));
        out.loss = 0.5 * out.residual.iter().map(|r| r * r).sum::<f64>();
        out.log_peak = self.log_peak;
        out.chart = Chart::Coordinates;
        if out.derivative {
            out.jacobian.clear();
            out.jacobian.extend_from_slice(&self.whitening);
        }
    }
}

/// The mean of a message, where it has one.
pub(crate) fn mean_of<M: GaussianFamily>(message: &M) -> Option<Vec<f64>> {
    let d = message.dimension();
    let (mut information, mut vector) = (vec![0.0; d * d], vec![0.0; d]);
    message.read_information(&mut information, &mut vector).ok()?;
    Cholesky::new(&information, d, "the start").ok()?.solve(&mut vector);
    Some(vector)
}

/// A prior as a factor.
pub(crate) fn pinned<M: GaussianFamily, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    variable: VariableId,
    prior: &M,
    space: &Space,
) -> Result<Pinned, ExactError> {
    let named = |source| ExactError::Prior { variable: graph.variable_name(variable), source };
    let d = prior.dimension();
    if d != space.dimension() || *space == Space::Se3 {
        let reason =
            "a prior message suits real and angular coordinates; give a pose in space a PosePrior factor";
        return Err(named(sumprod_graph::MessageError::Unsupported(reason.into())));
    }
    let (mut information, mut mean) = (vec![0.0; d * d], vec![0.0; d]);
    prior.read_information(&mut information, &mut mean).map_err(named)?;
    let factor = Cholesky::new(&information, d, "its information").map_err(named)?;
    factor.solve(&mut mean);
    let mut whitening = vec![0.0; d * d];
    for column in 0..d {
        let mut unit = vec![0.0; d];
        unit[column] = 1.0;
        factor.multiply_lower(&unit, &mut whitening[column * d..][..d]);
    }
    let log_peak = 0.5 * (factor.log_determinant() - d as f64 * std::f64::consts::TAU.ln());
    Ok(Pinned { variable: variable.index() as u32, mean, whitening, log_peak })
}
