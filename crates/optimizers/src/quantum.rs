//! The quantum genetic algorithm as a move: a register of qubits for each particle, measured and rotated.
//!
//! A chromosome is a string of m bits for each encoded coordinate. Its register holds an angle ξ a qubit, and a
//! measurement yields 1 with probability sin²ξ ([`Register`]). The string is decoded into a point ([`Decoding`]),
//! the point is judged by the likelihood, and the gate turns each qubit towards the bit of a reference string
//! ([`Rotation`]). Nothing here is a quantum computer: the register is simulated, bit by bit.
//!
//! | form | what is returned | valid |
//! |---|---|---|
//! | [`QuantumLiteral`] | the likeliest point each chromosome has met, weighed by its likelihood | no: the likelihood counts several times |
//! | [`QuantumImportance`] | all measured points, weighed by prior(bits) / q(bits) × likelihood | yes |
//! | [`QuantumMetropolis`] | Metropolis-Hastings chains on the strings | yes |
//!
//! Source: Yang, Peng, Wang, Wang, "Tracking algorithms based on quantum genetic particle filter for WSN" (2010);
//! the gate and its table: Han, Kim, "Quantum-inspired evolutionary algorithm for a class of combinatorial
//! optimization" (2002).

mod coding;
mod decoding;
mod importance;
mod literal;
mod metropolis;
mod register;

pub use coding::Coding;
pub use decoding::Decoding;
pub use importance::QuantumImportance;
pub use literal::{QuantumLiteral, Reference};
pub use metropolis::QuantumMetropolis;
pub use register::{Register, Rotation};
