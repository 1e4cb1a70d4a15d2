//! Sum-product inference on factor graphs, with any message representation on any edge.
//!
//! This crate is the one to depend on: it re-exports the workspace's crates under short names, and what most
//! programs need in [`prelude`].
//!
//! ```
//! use sumprod::prelude::*;
//!
//! // A position known to 2 m, and a range of 50 m to an anchor at the origin.
//! let mut graph = FactorGraph::<AnyMessage>::new();
//! let space = Space::real(2);
//! let x = graph.variable("x", space.clone())?;
//! graph.set_prior(x, AnyMessage::gaussian(&space, &[40.0, 35.0], &[4.0, 0.0, 0.0, 4.0])?)?;
//! let range = AnchorRange::new(50.0, [0.0, 0.0], 2, [0, 1], Noise::isotropic(1, 0.25)?)?;
//! graph.add("range", range, &[x])?;
//!
//! let mut engine = Engine::new(&graph, Options::default())?;
//! let report = engine.run(&mut Flooding)?;
//! let answer = engine.belief(x).moments()?;
//! assert!(report.converged());
//! assert!((answer.mean[0].hypot(answer.mean[1]) - 50.0).abs() < 0.5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(doctest)]
mod book;

pub use nalgebra;
pub use sumprod_exact as exact;
pub use sumprod_filters as filters;
pub use sumprod_fusion as fusion;
pub use sumprod_graph as graph;
pub use sumprod_messages as messages;
pub use sumprod_models as models;
pub use sumprod_optimizers as optimizers;
pub use sumprod_positioning as positioning;

/// What most programs need.
pub mod prelude {
    pub use sumprod_filters::{Correct, Filter, Kalman, ParticleFilter, Predict, Smooth};
    pub use sumprod_graph::schedule::{
        Coloured, Flooding, ForwardBackward, Residual as ResidualSchedule, Sequential, Sliced,
    };
    pub use sumprod_graph::{
        Coordinate, EdgeId, Engine, Factor, FactorGraph, FactorId, GraphError, Incoming, Message,
        MessageError, Messages, Options, Outgoing, Pass, Port, Purpose, Qualities, Quality, Report, Schedule,
        Space, Stop, Stream, Topology, VariableId, Window, WindowVariable,
    };
    pub use sumprod_messages::{
        AnyForm, AnyMessage, Categorical, CategoricalForm, DynamicGaussian, Gaussian, GaussianForm,
        Linearisation, LogOdds, Mixture, MixtureForm, MixtureMessage, Moments, Particles, ParticlesForm,
        ProductChoice, Proposal,
    };
    pub use sumprod_models::discrete::{Logical, PairOdds, Table};
    pub use sumprod_models::library::*;
    pub use sumprod_models::{
        AddModel, Block, Cluster, Model, Motion, Noise, ProcessNoise, Real, Residual, Transition,
        check_residual,
    };
}
