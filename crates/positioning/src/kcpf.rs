//! The two trackers of the knowledge-board paper: a univariate growth model and a coordinated turn.
//!
//! | method | algorithm | source |
//! |---|---|---|
//! | `grid` | the exact posterior on a grid; of the growth model alone | Bucy, Senne 1971 |
//! | `ekf` | extended Kalman filter, what the paper compares with | |
//! | `pf` | bootstrap particle filter | Gordon, Salmond, Smith 1993 |
//! | `kcpf-literal` | the swarm's cloud taken for a sample of the posterior | Wang and others 2014, as printed |
//! | `kcpf` | the swarm as a proposal | the same, made valid |
//!
//! These are combinations of the keys of [`method::MethodSettings`]; a scenario may have others. Every method sees the
//! same draws of the world and uses the same model. The worlds are those of [`growth`] and [`turn`]; the paper's own
//! models are lost, and these are what its text leaves room for.
//!
//! Source: Wang, Wang, Zou, Qian, "Cooperative particle filtering algorithm based on knowledge plate" (2014).

pub mod growth;
pub mod method;
mod track;
pub mod turn;

#[cfg(test)]
mod tests;
