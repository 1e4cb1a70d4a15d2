//! Registers of qubits: measurement and rotation.

use rand::RngExt;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use sumprod_graph::FastStream;

use super::Coding;
use crate::error::OptimizerError;

/// The qubits of a population: a row of angles for each chromosome, the bits of a coordinate next to each other.
///
/// A qubit is cos ξ |0⟩ + sin ξ |1⟩ with 0 < ξ < π/2; it is measured as 1 with probability sin²ξ.
#[derive(Clone, Debug, PartialEq)]
pub struct Register {
    coding: Coding,
    coordinates: usize,
    angles: Vec<f64>,
    /// sin²ξ of each qubit.
    ones: Vec<f64>,
}

impl Register {
    /// The uniform superposition: every string of `chromosomes` chromosomes is equally likely.
    pub fn uniform(coding: Coding, coordinates: usize, chromosomes: usize) -> Self {
        let qubits = coding.bits() * coordinates;
        let count = qubits * chromosomes;
        Self { coding, coordinates, angles: vec![FRAC_PI_4; count], ones: vec![0.5; count] }
    }

    /// A single chromosome whose bits are 1 as often as in `codes` (rows of one code a coordinate), but neither less
    /// often than `floor` nor more often than 1 - `floor`. Uniform where there are no codes.
    pub fn frequencies(coding: Coding, coordinates: usize, codes: &[u16], floor: f64) -> Self {
        let mut register = Self::uniform(coding, coordinates, 1);
        let rows = codes.len() / coordinates.max(1);
        if rows == 0 {
            return register;
        }
        for (qubit, (angle, one)) in register.angles.iter_mut().zip(&mut register.ones).enumerate() {
            let (coordinate, place) = (qubit / coding.bits(), qubit % coding.bits());
            let column = codes.iter().skip(coordinate).step_by(coordinates);
            let found = column.filter(|&&code| coding.bit(code, place)).count();
            *one = (found as f64 / rows as f64).clamp(floor, 1.0 - floor);
            *angle = one.sqrt().asin();
        }
        register
    }

    /// The probabilities of 1 of a chromosome's qubits.
    fn row(&self, chromosome: usize) -> &[f64] {
        let qubits = self.coding.bits() * self.coordinates;
        &self.ones[chromosome * qubits..(chromosome + 1) * qubits]
    }

    /// Measures a chromosome: writes a code for each coordinate.
    pub fn measure(&self, chromosome: usize, random: &mut FastStream, codes: &mut [u16]) {
        for (qubits, code) in self.row(chromosome).chunks_exact(self.coding.bits()).zip(codes) {
            *code = 0;
            for probability in qubits {
                let one = random.random::<f64>() < *probability;
                *code = *code << 1 | u16::from(one);
            }
        }
    }

    /// Log of how much likelier the uniform superposition is to yield `codes` than this register:
    /// Σ ln(½ / q(bit)).
    pub fn log_uniform_ratio(&self, chromosome: usize, codes: &[u16]) -> f64 {
        let mut sum = 0.0;
        for (qubits, &code) in self.row(chromosome).chunks_exact(self.coding.bits()).zip(codes) {
            // At most 16 factors, none below 2 sin²ξ₀: their product keeps within range.
            let bits = qubits.iter().enumerate();
            let factors =
                bits.map(|(place, one)| if self.coding.bit(code, place) { *one } else { 1.0 - one });
            sum -= factors.fold(1.0, |product, factor| product * 2.0 * factor).ln();
        }
        sum
    }

    /// Turns a chromosome whose string is worse than `reference` towards it.
    pub fn rotate(&mut self, chromosome: usize, codes: &[u16], reference: &[u16], gate: &Rotation) {
        let bits = self.coding.bits();
        let start = chromosome * bits * self.coordinates;
        for (coordinate, (&code, &towards)) in codes.iter().zip(reference).enumerate() {
            for place in 0..bits.min(gate.places) {
                let turn = Rotation::direction(self.coding.bit(code, place), self.coding.bit(towards, place));
                if turn != 0.0 {
                    let qubit = start + coordinate * bits + place;
                    let angle =
                        (self.angles[qubit] + turn * gate.angle).clamp(gate.floor, FRAC_PI_2 - gate.floor);
                    (self.angles[qubit], self.ones[qubit]) = (angle, angle.sin().powi(2));
                }
            }
        }
    }
}

/// The rotation gate: a qubit's angle turns by ± Δθ, and stays ξ₀ away from the axes.
///
/// | bit | reference | string | turn |
/// |---|---|---|---|
/// | 0 | 1 | worse | + Δθ |
/// | 1 | 0 | worse | - Δθ |
/// | any | the same | any | 0 |
/// | any | any | not worse | 0 |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    angle: f64,
    floor: f64,
    places: usize,
}

impl Default for Rotation {
    /// Δθ = 0.05 π, ξ₀ = 0.12, all bits.
    fn default() -> Self {
        Self { angle: 0.05 * PI, floor: 0.12, places: usize::MAX }
    }
}

impl Rotation {
    /// Turns by `angle` (rad), of the `places` most significant bits of each coordinate.
    ///
    /// # Errors
    ///
    /// Where `angle` is not between 0 and π/2.
    pub fn new(angle: f64, places: usize) -> Result<Self, OptimizerError> {
        if (0.0..=FRAC_PI_2).contains(&angle) {
            return Ok(Self { angle, places, ..Self::default() });
        }
        let must = "it must lie between 0 and π/2";
        Err(OptimizerError::Parameter { what: "the angle of rotation", value: angle, must })
    }

    /// The sign of the turn of a worse string's bit.
    fn direction(bit: bool, reference: bool) -> f64 {
        f64::from(u8::from(reference)) - f64::from(u8::from(bit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Stream};

    #[test]
    fn measured_bits_are_as_frequent_as_the_angles_say() {
        // 20,000 strings, 5 standard errors of a frequency: error probability 6e-7 each.
        let coding = Coding::new(3).unwrap();
        let register = Register::frequencies(coding, 1, &[0b110, 0b100, 0b111, 0b010], 0.1);
        let mut random = Stream::new(1, 0, Purpose::Optimizer, 0).fast();
        let (mut ones, mut codes) = ([0.0; 3], [0]);
        for _ in 0..20_000 {
            register.measure(0, &mut random, &mut codes);
            for (place, ones) in ones.iter_mut().enumerate() {
                *ones += f64::from(u8::from(coding.bit(codes[0], place))) / 20_000.0;
            }
        }
        for (found, expected) in ones.into_iter().zip([0.75, 0.75, 0.25]) {
            assert!((found - expected).abs() < 5.0 * (0.25_f64 / 20_000.0).sqrt());
        }
        let ratio = register.log_uniform_ratio(0, &[0b110]);
        assert!((ratio - 3.0 * (0.5_f64 / 0.75).ln()).abs() < 1e-12);
    }

    #[test]
    fn the_probabilities_of_all_strings_sum_to_one() {
        let coding = Coding::new(4).unwrap();
        let mut register = Register::uniform(coding, 2, 2);
        register.rotate(1, &[0, 15], &[9, 3], &Rotation::default());
        let total: f64 = (0..16_u16)
            .flat_map(|a| (0..16_u16).map(move |b| [a, b]))
            .map(|codes| (-register.log_uniform_ratio(1, &codes)).exp() / 256.0)
            .sum();
        assert!((total - 1.0).abs() < 1e-12);
        assert!(register.log_uniform_ratio(0, &[3, 8]).abs() < 1e-12);
    }

    #[test]
    fn the_gate_turns_differing_bits_of_its_places_towards_the_reference() {
        let coding = Coding::new(3).unwrap();
        let mut register = Register::uniform(coding, 1, 1);
        let gate = Rotation::new(0.1, 2).unwrap();
        register.rotate(0, &[0b001], &[0b100], &gate);
        assert_eq!(register.angles, [FRAC_PI_4 + 0.1, FRAC_PI_4, FRAC_PI_4]);
        for _ in 0..20 {
            register.rotate(0, &[0b001], &[0b100], &gate);
        }
        assert!((register.angles[0] - (FRAC_PI_2 - 0.12)).abs() < 1e-12);
        assert_eq!(register.row(0)[0], (FRAC_PI_2 - 0.12).sin().powi(2));
        assert!(Rotation::new(f64::NAN, 1).is_err());
    }
}
