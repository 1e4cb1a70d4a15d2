//! Laws of fusion: every belief is the posterior of what it says that it is made of.

mod graphs;
mod intersections;
mod nodes;
mod sets;
mod support;
mod wrong;
