//! A sensor's tracks.

use super::error::AssociationError;

/// The tracks of one sensor: of each its coordinates in every scan, scan by scan.
///
/// Coordinates are metres along fixed axes, the same for both sensors. Several scans of the same tracks are one set:
/// then one association is found for all scans together.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracks {
    dimension: usize,
    scans: usize,
    coordinates: Vec<f64>,
}

impl Tracks {
    /// Tracks of `scans` scans with `dimension` coordinates each: `coordinates` holds them track by track and, within
    /// a track, scan by scan. It may be empty.
    ///
    /// # Errors
    /// [`AssociationError::Tracks`] for no scans or dimensions, a length that is no multiple of their product, and
    /// numbers that are not finite or too large to be squared.
    pub fn new(dimension: usize, scans: usize, coordinates: Vec<f64>) -> Result<Self, AssociationError> {
        let wrong = |problem| Err(AssociationError::Tracks { problem });
        let Some(width) = dimension.checked_mul(scans).filter(|width| *width > 0) else {
            return wrong(format!(
                "they have {scans} scans of {dimension} coordinates; both must be at least 1, and can be counted"
            ));
        };
        if !coordinates.len().is_multiple_of(width) {
            let given = coordinates.len();
            return wrong(format!("{given} numbers are no whole number of tracks with {width} each"));
        }
        if let Some(place) = coordinates.iter().position(|value| value.is_nan() || value.abs() > 1e100) {
            let (track, value) = (place / width, coordinates[place]);
            return wrong(format!("coordinate {} of track {track} is {value}", place % width));
        }
        Ok(Self { dimension, scans, coordinates })
    }

    /// Tracks of one scan in the plane.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn planar(positions: &[[f64; 2]]) -> Result<Self, AssociationError> {
        Self::new(2, 1, positions.as_flattened().to_vec())
    }

    /// Number of tracks.
    pub fn len(&self) -> usize {
        self.coordinates.len() / self.width()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Coordinates a scan.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of scans.
    pub fn scans(&self) -> usize {
        self.scans
    }

    /// Coordinates a track: scans times coordinates a scan.
    pub fn width(&self) -> usize {
        self.dimension * self.scans
    }

    /// All coordinates, track by track.
    pub fn coordinates(&self) -> &[f64] {
        &self.coordinates
    }

    /// The coordinates of each track in order, scan by scan.
    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.coordinates.chunks_exact(self.width())
    }

    /// These tracks, moved.
    pub(super) fn displaced(&self, by: &[f64]) -> Self {
        let coordinates = self.coordinates.iter().zip(by).map(|(y, v)| y + v).collect();
        Self { coordinates, ..self.clone() }
    }

    /// Fails unless both sets have the same shape.
    pub(super) fn agree(&self, other: &Self) -> Result<(), AssociationError> {
        let [first, second] = [self, other].map(|tracks| [tracks.scans, tracks.dimension]);
        if first == second { Ok(()) } else { Err(AssociationError::Shapes { first, second }) }
    }
}

/// Root mean square of a coordinate about its mean over both sets, averaged over coordinates; 1 where all coincide.
pub(super) fn scale(first: &Tracks, second: &Tracks) -> f64 {
    let (count, width) = ((first.len() + second.len()) as f64, first.width());
    let mut square = 0.0;
    for coordinate in 0..width {
        let values = || first.iter().chain(second.iter()).map(|track| track[coordinate]);
        let mean = values().sum::<f64>() / count;
        square += values().map(|value| (value - mean).powi(2)).sum::<f64>();
    }
    let scale = (square / (count * width as f64)).sqrt();
    if scale > 0.0 { scale } else { 1.0 }
}

/// Logarithm of the volume in which a track without partner may lie: the box of both sets in the first scan times the
/// boxes of their steps from scan to scan, each side longer by `margin`.
pub(super) fn log_volume(first: &Tracks, second: &Tracks, margin: f64) -> f64 {
    let (dimension, width) = (first.dimension, first.width());
    (0..width)
        .map(|i| {
            let values = first.iter().chain(second.iter()).map(|track| match i.checked_sub(dimension) {
                Some(before) => track[i] - track[before],
                None => track[i],
            });
            let [low, high] =
                values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
            (high - low + margin).ln()
        })
        .sum()
}
