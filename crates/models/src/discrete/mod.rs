//! Factors over variables of finitely many states.
//!
//! | factor | says | cost of its messages |
//! |---|---|---|
//! | [`Table`] | any function, by its values | its entries |
//! | [`PairOdds`] | any positive function of two binary variables | constant, many factors at once |
//! | [`Logical`] | or, and, at most one, parity of binary variables | linear in the number of ports |
//!
//! All serve every family that can be read as states ([`sumprod_messages::CategoricalFamily`]), at the temperature of the
//! edge's form: 1 sums, 0 maximises. A factor that stands in many places is shared by an [`std::sync::Arc`], which is a
//! factor too.

mod error;
mod logical;
mod pair_odds;
mod questions;
mod rules;
mod semiring;
mod strips;
mod table;

pub use error::TableError;
pub use logical::Logical;
pub use pair_odds::PairOdds;
pub use questions::{LocalEvidence, Tabulation};
pub use table::Table;
