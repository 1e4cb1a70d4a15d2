//! What a problem keeps of its graph besides the factors themselves. It grows with the graph.

use crate::ExactError;
use crate::kernel::Kernel;
use crate::layout::Layout;
use crate::prior::{Pinned, mean_of, pinned};
use std::sync::Arc;
use sumprod_graph::{Factor, FactorGraph, FactorId, Space, VariableId};
use sumprod_messages::GaussianFamily;
use sumprod_models::Manifold;

/// Spaces, the variables of every factor, priors and starts.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    pub(crate) layout: Arc<Layout>,
    pub(crate) variables: Vec<VariableId>,
    pub(crate) factors: Vec<FactorId>,
    /// Variables of every factor, one factor after the other, and where each one's end.
    port_variable: Vec<u32>,
    port_end: Vec<u32>,
    pub(crate) priors: Vec<Pinned>,
    /// Where every variable starts, in stored coordinates.
    pub(crate) start: Vec<f64>,
    kernels: Vec<(String, Kernel)>,
    /// Of every factor, where any was set.
    pub(crate) kernel_of: Vec<Kernel>,
}

impl Shape {
    /// Takes in the variables and factors that the graph has beyond those known; linear in these.
    ///
    /// # Errors
    ///
    /// Where a variable is finite, or a prior is no proper Gaussian; what came before it is kept.
    pub(crate) fn grow<M: GaussianFamily, F: Factor<M>>(
        &mut self,
        graph: &FactorGraph<M, F>,
    ) -> Result<(), ExactError> {
        let layout = Arc::make_mut(&mut self.layout);
        for variable in graph.variable_ids().skip(self.variables.len()) {
            let space = graph.space(variable);
            if let Space::Finite(states) = *space {
                return Err(ExactError::Finite { variable: graph.variable_name(variable), states });
            }
            let prior =
                graph.prior(variable).map(|prior| pinned(graph, variable, prior, space)).transpose()?;
            let first = self.start.len();
            self.start.resize(first + space.dimension(), 0.0);
            let own = &mut self.start[first..];
            space.origin(own);
            let given = graph.start(variable).and_then(|start| mean_of(start));
            if let Some(mean) = given.as_ref().or(prior.as_ref().map(|prior| &prior.mean)) {
                own.copy_from_slice(mean);
            }
            layout.push(space);
            self.variables.push(variable);
            self.priors.extend(prior);
        }
        for factor in graph.factor_ids().skip(self.factors.len()) {
            self.port_variable.extend(graph.ports(factor).map(|variable| variable.index() as u32));
            self.port_end.push(self.port_variable.len() as u32);
            self.factors.push(factor);
            if !self.kernels.is_empty() {
                let kernel = self.kernel_for(graph.factor_kind(factor));
                self.kernel_of.push(kernel);
            }
        }
        Ok(())
    }

    /// Sets the kernel of a kind of factors: of those that come, and where `kind_of` is asked again of all.
    pub(crate) fn add_kernel(&mut self, kind: &str, kernel: Kernel) {
        self.kernels.push((kind.to_owned(), kernel));
        self.kernel_of.resize(self.factors.len(), Kernel::None);
    }

    /// The kernel of a kind of factors.
    pub(crate) fn kernel_for(&self, kind: &str) -> Kernel {
        let last = self.kernels.iter().rev().find(|(name, _)| name == kind);
        last.map_or(Kernel::None, |(_, kernel)| *kernel)
    }

    /// The variables at a factor's ports; priors come after the graph's factors.
    pub(crate) fn ports(&self, factor: usize) -> &[u32] {
        match self.port_end.get(factor) {
            Some(&end) => {
                let start = factor.checked_sub(1).map_or(0, |before| self.port_end[before]);
                &self.port_variable[start as usize..end as usize]
            }
            None => std::slice::from_ref(&self.priors[factor - self.factors.len()].variable),
        }
    }

    /// Number of factors, priors included.
    pub(crate) fn factor_count(&self) -> usize {
        self.factors.len() + self.priors.len()
    }

    /// Number of edges, those to priors included.
    pub(crate) fn port_count(&self) -> usize {
        self.port_variable.len() + self.priors.len()
    }
}
