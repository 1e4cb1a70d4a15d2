//! What point a string of bits stands for.

use sumprod_graph::FastStream;
use sumprod_messages::Particles;

use super::Coding;
use crate::error::OptimizerError;
use crate::frame::{CloudKernel, Frame};

/// What point a string stands for; the paper does not say, so each reading is one.
#[derive(Clone, Debug, PartialEq)]
pub enum Decoding {
    /// x = xᵢ + c σ (2 s - 1) around the particle, σ the cloud's deviation, s the code's share of its range.
    Local {
        /// The factor c.
        scale: f64,
        /// The coordinates that are encoded; the others stay the particle's. All, where none are named.
        coordinates: Option<Vec<usize>>,
    },
    /// x = least + (greatest - least) s over the whole cloud.
    Global,
    /// x = m + √(1 - h²) (xᵢ - m) + h L u with u = Φ⁻¹((code + U) / 2^m): the uniform superposition is the kernel of
    /// the regularised filter, so that the prior of a string is known.
    Kernel,
}

impl Decoding {
    /// [`Local`](Self::Local) in all coordinates.
    pub fn local(scale: f64) -> Self {
        Self::Local { scale, coordinates: None }
    }

    /// The encoded coordinates of points of `dimension` coordinates.
    ///
    /// # Errors
    ///
    /// Where a named coordinate does not exist, or the factor is not finite.
    pub(crate) fn encoded(&self, dimension: usize) -> Result<Vec<usize>, OptimizerError> {
        let Self::Local { scale, coordinates } = self else {
            return Ok((0..dimension).collect());
        };
        if !scale.is_finite() {
            let what = "the factor of the local decoding";
            return Err(OptimizerError::Parameter { what, value: *scale, must: "it must be finite" });
        }
        let all = || (0..dimension).collect();
        let named = coordinates.clone().unwrap_or_else(all);
        match named.iter().find(|&&coordinate| coordinate >= dimension) {
            Some(&coordinate) => Err(OptimizerError::Parameter {
                what: "an encoded coordinate",
                value: coordinate as f64,
                must: "it must be less than the number of coordinates",
            }),
            None => Ok(named),
        }
    }

    /// Prepares the decoding of one cloud.
    pub(crate) fn prepare<'a>(
        &self,
        cloud: &'a Particles,
        coding: Coding,
    ) -> Result<Decoder<'a>, OptimizerError> {
        let d = cloud.dimension();
        let encoded = self.encoded(d)?;
        let rule = match self {
            Self::Local { scale, .. } => {
                let frame = Frame::of(cloud)?;
                Rule::Local(frame.deviations().iter().map(|deviation| scale * deviation).collect())
            }
            Self::Global => {
                let mut bounds = vec![(f64::INFINITY, f64::NEG_INFINITY); d];
                for point in cloud.points().chunks_exact(d) {
                    for ((least, greatest), &x) in bounds.iter_mut().zip(point) {
                        (*least, *greatest) = (least.min(x), greatest.max(x));
                    }
                }
                Rule::Global(bounds)
            }
            Self::Kernel => Rule::Kernel(Box::new(CloudKernel::of(cloud, 1.0)?)),
        };
        Ok(Decoder { cloud, coding, encoded, rule })
    }
}

/// A decoding of one cloud.
pub(crate) struct Decoder<'a> {
    cloud: &'a Particles,
    coding: Coding,
    encoded: Vec<usize>,
    rule: Rule,
}

enum Rule {
    Local(Vec<f64>),
    Global(Vec<(f64, f64)>),
    Kernel(Box<CloudKernel>),
}

impl Decoder<'_> {
    /// Number of codes of a string.
    pub(crate) fn codes(&self) -> usize {
        self.encoded.len()
    }

    /// Writes the point that `codes` of chromosome `index` stand for.
    pub(crate) fn point(&self, index: usize, codes: &[u16], random: &mut FastStream, point: &mut [f64]) {
        let centre = self.cloud.point(index);
        match &self.rule {
            Rule::Local(reach) => {
                point.copy_from_slice(centre);
                for (&coordinate, &code) in self.encoded.iter().zip(codes) {
                    point[coordinate] += reach[coordinate] * (2.0 * self.coding.share(code) - 1.0);
                }
            }
            Rule::Global(bounds) => {
                for ((x, (least, greatest)), &code) in point.iter_mut().zip(bounds).zip(codes) {
                    *x = least + (greatest - least) * self.coding.share(code);
                }
            }
            Rule::Kernel(kernel) => {
                let standard: Vec<f64> = codes.iter().map(|&code| self.coding.normal(code, random)).collect();
                kernel.place(centre, &standard, point);
            }
        }
    }
}
