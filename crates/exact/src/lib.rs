//! Exact answers on factor graphs: what every approximate answer is held against.
//!
//! A [`Problem`] is any graph of Gaussian messages whose factors have residuals. [`Problem::solve`] finds the minimum of its
//! cost, which for a linear graph is its mean, by sparse Cholesky factors; the [`Solution`] then gives the covariance of any
//! variables ([`Solution::marginals`] of all, [`Solution::joint`] of a few together) and the evidence
//! ([`Solution::log_evidence`]). [`observability`] says why a graph cannot be solved.
//!
//! A [`JunctionTree`] does the same for variables of finitely many states: marginals, evidence, and the most probable state.
//!
//! ```
//! use sumprod_exact::{Problem, SolveOptions};
//! use sumprod_graph::{FactorGraph, Space};
//! use sumprod_messages::DynamicGaussian;
//! use sumprod_models::library::LinearGaussian;
//! use sumprod_models::{AddModel, Noise};
//!
//! // x ~ N(1, 4), y - x ~ N(2, 1).
//! let mut graph = FactorGraph::<DynamicGaussian>::new();
//! let (x, y) = (graph.variable("x", Space::real(1))?, graph.variable("y", Space::real(1))?);
//! graph.add("prior", LinearGaussian::new(&[&[1.0]], &[1.0], Noise::isotropic(1, 4.0)?)?, &[x])?;
//! graph.add("step", LinearGaussian::new(&[&[-1.0], &[1.0]], &[2.0], Noise::isotropic(1, 1.0)?)?, &[x, y])?;
//!
//! let problem = Problem::new(&graph)?;
//! let mut solution = problem.solve(problem.start(), &SolveOptions::default())?;
//! let answer = solution.marginal(y)?;
//! assert!((answer.mean[0] - 3.0).abs() < 1e-12 && (answer.covariance[0] - 5.0).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod answer;
mod belief;
mod bethe;
mod cholesky;
mod chordal;
mod compare;
mod components;
mod discrete_evidence;
mod error;
mod incremental;
mod junction;
mod kernel;
mod layout;
mod linear_graph;
mod normal;
pub mod observability;
mod prior;
mod problem;
pub mod read;
mod selected;
mod shape;
mod solution;
mod solve;
mod structure;
mod values;

pub use answer::{Answer, Deviation};
pub use belief::{BeliefOptions, Beliefs};
pub use bethe::bethe_log_evidence;
pub use chordal::chordal_start;
pub use compare::{Comparison, ComparisonRow, compare};
pub use discrete_evidence::{discrete_log_evidence, factor_probabilities};
pub use error::ExactError;
pub use incremental::{Incremental, IncrementalOptions, UpdateReport};
pub use junction::{JunctionAnswer, JunctionOptions, JunctionTree, MostProbable};
pub use kernel::Kernel;
pub use problem::Problem;
pub use solution::{Marginals, Solution};
pub use solve::{Optimizer, SolveOptions, SolveReport, Solver};
pub use structure::Ordering;
pub use values::Values;
