//! Families of messages, their products, and the graph that mixes them.
//!
//! | family | holds | product | quotient |
//! |---|---|---|---|
//! | [`Gaussian`] | information form, dimension fixed at compile time | addition | subtraction |
//! | [`DynamicGaussian`] | the same, dimension chosen at run time; no heap up to five | addition | subtraction |
//! | [`Particles`] | points with log weights | on one support, else by kernels | on one support |
//! | [`MixtureMessage`] | a [`Mixture`] of Gaussians, or a [`Potential`] that leaves directions open | by a [`ProductMethod`] | by one Gaussian |
//! | [`LatticeMessage`] | values on cells of the plane, or a Gaussian, by the form of each edge | on the belief's cells | where both can |
//! | [`Categorical`] | values of finitely many states, in the log domain | addition | where no state is ruled out |
//! | [`LogOdds`] | two states as one number | addition | subtraction |
//! | [`AnyMessage`] | any of these, by the form of each edge | in the form of the belief | where both can |
//!
//! Adding a family to the mix touches its own file and [`AnyMessage`] alone.

mod any;
mod categorical;
mod cumulants;
mod dense;
mod dynamic;
mod gaussian;
mod kernel;
mod lattice;
mod mixture;
mod moments;
mod particles;
pub mod vector;

pub use any::{AnyForm, AnyMessage, AnyValue, ParticleFamily};
pub use categorical::{Categorical, CategoricalFamily, CategoricalForm, LogOdds};
pub use dense::Cholesky;
pub use dynamic::DynamicGaussian;
pub use gaussian::{Gaussian, GaussianFamily, GaussianForm, Linearisation};
pub use kernel::floor_diagonal;
pub use lattice::{Cell, Lattice, LatticeForm, LatticeMessage, LatticeValue};
pub use mixture::{
    AnnealedGibbs, Auto, Bandwidth, BandwidthChoice, Conditional, ConditionalDraw, Evaluator, Exact,
    GaussianImportance, Gibbs, GibbsStart, Literal, Mixture, MixtureFamily, MixtureForm, MixtureImportance,
    MixtureMessage, Mode, MultiscaleGibbs, Pairwise, Pointwise, Potential, Product, ProductChoice,
    ProductMethod, ProductQuality, modes,
};
pub use moments::{Moments, gaussian_divergence};
pub use particles::{Particles, ParticlesForm, Proposal, Role};
