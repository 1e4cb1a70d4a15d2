//! Putting models into graphs.

use crate::{Cluster, Model, Motion, Residual, ResidualModel, Transition};
use sumprod_graph::{Factor, FactorGraph, FactorId, GraphError, Message, VariableId};

/// Adds residuals, motions and clusters to a graph of boxed factors.
pub trait AddModel<M: Message> {
    /// Adds a residual over `variables`, one per port.
    ///
    /// # Errors
    ///
    /// As [`FactorGraph::factor`].
    fn add<R: Residual + 'static>(
        &mut self,
        name: impl Into<String>,
        residual: R,
        variables: &[VariableId],
    ) -> Result<FactorId, GraphError>
    where
        Model<ResidualModel<R>>: Factor<M>;

    /// Adds a motion from one state to the next.
    ///
    /// # Errors
    ///
    /// As [`FactorGraph::factor`].
    fn add_motion<T: Motion + 'static>(
        &mut self,
        name: impl Into<String>,
        motion: T,
        from: VariableId,
        to: VariableId,
    ) -> Result<FactorId, GraphError>
    where
        Model<Transition<T>>: Factor<M>;

    /// Adds many residuals on blocks of one variable.
    ///
    /// # Errors
    ///
    /// As [`FactorGraph::factor`].
    fn add_cluster(
        &mut self,
        name: impl Into<String>,
        cluster: Cluster,
        variable: VariableId,
    ) -> Result<FactorId, GraphError>
    where
        Model<Cluster>: Factor<M>;
}

impl<M: Message> AddModel<M> for FactorGraph<M> {
    fn add<R: Residual + 'static>(
        &mut self,
        name: impl Into<String>,
        residual: R,
        variables: &[VariableId],
    ) -> Result<FactorId, GraphError>
    where
        Model<ResidualModel<R>>: Factor<M>,
    {
        self.factor(name, Box::new(Model(ResidualModel(residual))), variables)
    }

    fn add_motion<T: Motion + 'static>(
        &mut self,
        name: impl Into<String>,
        motion: T,
        from: VariableId,
        to: VariableId,
    ) -> Result<FactorId, GraphError>
    where
        Model<Transition<T>>: Factor<M>,
    {
        self.factor(name, Box::new(Model(Transition::new(motion))), &[from, to])
    }

    fn add_cluster(
        &mut self,
        name: impl Into<String>,
        cluster: Cluster,
        variable: VariableId,
    ) -> Result<FactorId, GraphError>
    where
        Model<Cluster>: Factor<M>,
    {
        self.factor(name, Box::new(Model(cluster)), &[variable])
    }
}
