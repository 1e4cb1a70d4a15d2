//! A problem made linear at a point, as a graph for message passing.

use crate::{ExactError, Problem, Values};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::LinearGaussian;
use sumprod_models::{AddModel, Expansion, Noise};

impl Problem<'_> {
    /// The linear graph of the steps from these values: variables keep their numbers, factors too, and every variable is
    /// real, of as many coordinates as it had degrees of freedom. Its exact mean is the next step of Gauss-Newton.
    ///
    /// # Errors
    ///
    /// Where a factor cannot be linearised.
    pub fn linear_graph(&self, values: &Values) -> Result<FactorGraph<DynamicGaussian>, ExactError> {
        let mut graph = FactorGraph::new();
        let mut handles: Vec<VariableId> = Vec::with_capacity(self.variable_count());
        for index in 0..self.variable_count() {
            handles.push(
                graph.variable(
                    self.variable_name(index),
                    Space::real(self.space(index).degrees_of_freedom()),
                )?,
            );
        }
        let (mut question, mut chained) = (Expansion::default(), Vec::new());
        for factor in 0..self.factor_count() {
            self.expand(factor, &values.numbers, true, &mut question, &mut chained)?;
            let rows = question.residual.len();
            let wide = question.jacobian.len() / rows.max(1);
            let failed = |source| ExactError::Factor { factor: self.factor_name(factor), source };
            let mut start = 0;
            let mut matrices: Vec<Vec<f64>> = Vec::new();
            let ports: Vec<VariableId> = self.ports(factor).iter().map(|&v| handles[v as usize]).collect();
            for &variable in self.ports(factor) {
                let d = self.layout().freedoms(variable as usize).len();
                matrices.push(
                    (0..rows)
                        .flat_map(|row| question.jacobian[row * wide + start..][..d].iter().copied())
                        .collect(),
                );
                start += d;
            }
            let slices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
            let target: Vec<f64> = question.residual.iter().map(|r| -r).collect();
            let noise = Noise::isotropic(rows, 1.0)
                .map_err(|error| failed(sumprod_graph::MessageError::Unsupported(error.to_string())))?;
            let linear = LinearGaussian::new(&slices, &target, noise).map_err(failed)?;
            graph.add("linearised", linear, &ports)?;
        }
        Ok(graph)
    }
}
