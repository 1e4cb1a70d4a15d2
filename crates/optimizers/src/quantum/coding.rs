//! Strings of bits, one whole number a coordinate.

use rand::RngExt;
use statrs::function::erf::{erfc, erfc_inv};
use std::f64::consts::SQRT_2;
use sumprod_graph::FastStream;

use crate::error::OptimizerError;

/// How many bits encode a coordinate: a code lies between 0 and 2^m - 1, its most significant bit first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coding {
    bits: u32,
}

impl Default for Coding {
    /// The 9 bits of the paper.
    fn default() -> Self {
        Self { bits: 9 }
    }
}

impl Coding {
    /// `bits` bits a coordinate.
    ///
    /// # Errors
    ///
    /// Where `bits` is not between 1 and 16.
    pub fn new(bits: u32) -> Result<Self, OptimizerError> {
        if (1..=16).contains(&bits) {
            return Ok(Self { bits });
        }
        let must = "it must lie between 1 and 16";
        Err(OptimizerError::Parameter {
            what: "the number of bits a coordinate",
            value: f64::from(bits),
            must,
        })
    }

    /// Bits a coordinate.
    pub fn bits(self) -> usize {
        self.bits as usize
    }

    /// Number of codes, 2^m.
    pub fn levels(self) -> f64 {
        f64::from(1_u32 << self.bits)
    }

    /// Bit `place` of a code, the most significant at place 0.
    pub fn bit(self, code: u16, place: usize) -> bool {
        code >> (self.bits as usize - 1 - place) & 1 == 1
    }

    /// The share of the range that a code stands for, from 0 to 1.
    pub fn share(self, code: u16) -> f64 {
        f64::from(code) / (self.levels() - 1.0)
    }

    /// A standard normal value from a code and a uniform draw within its cell: Φ⁻¹((code + U) / 2^m). Uniform codes
    /// give exactly a standard normal value.
    pub fn normal(self, code: u16, random: &mut FastStream) -> f64 {
        let within = 1.0 - random.random::<f64>();
        // Where the last cell's draw is rounded to 1, the largest value below stands for it.
        let probability = ((f64::from(code) + within) / self.levels()).min(1.0 - f64::EPSILON);
        -SQRT_2 * erfc_inv(2.0 * probability)
    }

    /// The code whose cell a standard normal value lies in.
    pub fn code(self, standard: f64) -> u16 {
        let probability = 0.5 * erfc(-standard / SQRT_2);
        (probability * self.levels()).min(self.levels() - 1.0).max(0.0) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Stream};

    #[test]
    fn a_normal_value_leads_back_to_its_code() {
        let mut random = Stream::new(1, 0, Purpose::Optimizer, 0).fast();
        let coding = Coding::default();
        for code in 0..512 {
            let value = coding.normal(code, &mut random);
            assert!(value.is_finite());
            assert_eq!(coding.code(value), code, "{value}");
        }
        assert_eq!((coding.code(f64::NEG_INFINITY), coding.code(f64::INFINITY)), (0, 511));
        assert_eq!((coding.share(0), coding.share(511)), (0.0, 1.0));
        assert!(coding.bit(256, 0) && !coding.bit(256, 8) && coding.bit(1, 8));
    }

    #[test]
    fn the_number_of_bits_is_checked() {
        for bits in [0, 17] {
            assert!(Coding::new(bits).unwrap_err().to_string().contains("between 1 and 16"));
        }
        assert_eq!(Coding::new(16).unwrap().levels(), 65536.0);
    }
}
