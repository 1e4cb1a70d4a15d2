//! What can go wrong, said with the names and numbers a user knows.

use thiserror::Error;

/// Why a message could not be computed; the engine adds which one.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MessageError {
    /// A matrix that must be positive definite is not.
    #[error("{what} is not positive definite: pivot {pivot} is {value:.3e}")]
    NotPositiveDefinite {
        /// Which matrix.
        what: &'static str,
        /// Index of the pivot that failed.
        pivot: usize,
        /// Its value.
        value: f64,
    },
    /// Something leaves directions of the variable without any information.
    #[error("{what} constrains {rank} of {dimension} directions; nothing constrains {direction}")]
    Improper {
        /// Which distribution.
        what: &'static str,
        /// Number of constrained directions.
        rank: usize,
        /// Number of directions in all.
        dimension: usize,
        /// An unconstrained direction, as a combination of coordinates.
        direction: String,
    },
    /// A number that must be finite is not.
    #[error("{what} is {value}")]
    NotFinite {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// No particle has positive weight.
    #[error("{what}: every weight is zero (largest log weight {largest:.3e}); {remedy}")]
    NoWeight {
        /// What was weighted.
        what: &'static str,
        /// The largest log weight.
        largest: f64,
        /// What to do about it.
        remedy: &'static str,
    },
    /// Sizes that must agree do not.
    #[error("{what} has dimension {found}, expected {expected}")]
    Dimension {
        /// Of what.
        what: &'static str,
        /// The dimension found.
        found: usize,
        /// The dimension expected.
        expected: usize,
    },
    /// A coordinate that its variable does not have.
    #[error("{what} reads coordinate {index}, expected one below the variable's dimension {dimension}")]
    Coordinate {
        /// What reads it.
        what: &'static str,
        /// The coordinate, counted from zero.
        index: usize,
        /// The variable's dimension.
        dimension: usize,
    },
    /// Every state is ruled out.
    #[error("{what} rules out every state: what its factors and priors allow contradicts")]
    Impossible {
        /// Which message or table.
        what: &'static str,
    },
    /// A rule or an operation that a family does not have.
    #[error("{0}")]
    Unsupported(String),
}

/// Why a graph could not be built, compiled or run.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GraphError {
    /// A variable's name is taken.
    #[error("a variable named {0:?} exists already; names must differ")]
    DuplicateName(String),
    /// A handle of another graph, or of a removed variable or factor.
    #[error(
        "{what} {index} is not in this graph (it holds {count}); handles of another graph, or of something removed, cannot be used"
    )]
    Unknown {
        /// "variable" or "factor".
        what: &'static str,
        /// The handle's number.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A factor without ports.
    #[error("factor {0:?} has no port; a factor joins at least one variable")]
    NoPort(String),
    /// A factor was given the wrong number of variables.
    #[error("factor {factor:?} has {ports} ports but was given {variables} variables")]
    PortCount {
        /// The factor.
        factor: String,
        /// Number of its ports.
        ports: usize,
        /// Number of variables given.
        variables: usize,
    },
    /// A port and its variable differ in dimension.
    #[error(
        "port {port} of factor {factor:?} takes dimension {expected}, but variable {variable:?} has dimension {found}"
    )]
    PortDimension {
        /// The factor.
        factor: String,
        /// The port.
        port: usize,
        /// The port's dimension.
        expected: usize,
        /// The variable.
        variable: String,
        /// The variable's dimension.
        found: usize,
    },
    /// A port that a factor does not have.
    #[error("factor {factor:?} has no port {port}; its ports are 0 to {last}")]
    NoSuchPort {
        /// The factor.
        factor: String,
        /// The port asked for.
        port: usize,
        /// The last port.
        last: usize,
    },
    /// A form that the family does not know, or not on this space.
    #[error("the form of port {port} of factor {factor:?} (variable {variable:?}) cannot be used: {reason}")]
    Form {
        /// The factor.
        factor: String,
        /// The port.
        port: usize,
        /// The variable.
        variable: String,
        /// Why not.
        reason: String,
    },
    /// A schedule for trees met a loop.
    #[error("forward-backward needs a tree, but these form a loop: {}; use flooding, sequential or residual instead", .0.join(" - "))]
    Loop(Vec<String>),
    /// An option out of its range.
    #[error("{what} is {value}; {expected}")]
    Option {
        /// The option.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
    /// A message could not be computed.
    #[error(
        "iteration {iteration}: factor {factor:?} cannot send port {port} (variable {variable:?}) a message: {source}"
    )]
    Rule {
        /// The factor.
        factor: String,
        /// The port the message was for.
        port: usize,
        /// The variable at that port.
        variable: String,
        /// The iteration.
        iteration: u64,
        /// What went wrong.
        source: MessageError,
    },
    /// A product of messages could not be computed.
    #[error("iteration {iteration}: the messages into variable {variable:?} have no product: {source}")]
    Product {
        /// The variable.
        variable: String,
        /// The iteration.
        iteration: u64,
        /// What went wrong.
        source: MessageError,
    },
    /// A checkpoint of another graph or version.
    #[error("this checkpoint cannot be resumed here: {0}")]
    Checkpoint(String),
    /// A schedule cannot run on this graph.
    #[error("{0}")]
    Schedule(String),
}
