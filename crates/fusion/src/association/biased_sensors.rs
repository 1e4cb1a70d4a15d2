//! Two sensors that measure ranges and azimuths with an offset each.

use nalgebra::{Matrix2, Matrix2x4, Vector2, Vector4};

use super::error::AssociationError;
use super::tracks::Tracks;

/// Where the two sensors of a plane stand (m).
///
/// Biases are b = (range offset of the first sensor, its azimuth offset, the same of the second): metres and radians,
/// measured minus true. A track that the first sensor sees at y is where it is without the first's offsets, and the
/// second sensor sees it there with its own: T(y, b). To first order that is
///
/// T ≈ y − u_A Δr_A − u_A^⊥ r_A Δθ_A + u_B Δr_B + u_B^⊥ r_B Δθ_B
///
/// with unit vectors u and distances r from the sensors; it is computed exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensors {
    /// Position of the sensor whose tracks are the first set.
    pub first: [f64; 2],
    /// Position of the other.
    pub second: [f64; 2],
}

impl Sensors {
    /// Where the second sensor sees what the first one sees at `seen`, and the derivative by the biases.
    pub(super) fn transfer(
        &self,
        seen: Vector2<f64>,
        biases: &Vector4<f64>,
    ) -> (Vector2<f64>, Matrix2x4<f64>) {
        let [a, b] = [self.first, self.second].map(Vector2::from);
        // Without the first sensor's offsets.
        let (out, along, _) = stretched(seen - a, -biases[0]);
        let turn = rotation(-biases[1]);
        let truth = a + turn * out;
        let by_first = [-(turn * along), -across(truth - a)];
        // With the second's.
        let (out, along, by_place) = stretched(truth - b, biases[2]);
        let turn = rotation(biases[3]);
        let place = b + turn * out;
        let by_truth = turn * by_place;
        let columns = [by_truth * by_first[0], by_truth * by_first[1], turn * along, across(place - b)];
        (place, Matrix2x4::from_columns(&columns))
    }

    /// The first tracks as the second sensor sees them under these biases, the same in all scans.
    ///
    /// # Errors
    /// [`AssociationError::Field`] for tracks that are not of the plane.
    pub fn displaced(&self, tracks: &Tracks, biases: [f64; 4]) -> Result<Tracks, AssociationError> {
        planar(tracks)?;
        let biases = Vector4::from(biases);
        let moves = tracks.coordinates().chunks_exact(2).flat_map(|seen| {
            let seen = Vector2::new(seen[0], seen[1]);
            let change = self.transfer(seen, &biases).0 - seen;
            [change.x, change.y]
        });
        Ok(tracks.displaced(&moves.collect::<Vec<_>>()))
    }
}

/// Fails for tracks that are not of the plane.
pub(super) fn planar(tracks: &Tracks) -> Result<(), AssociationError> {
    match tracks.dimension() {
        2 => Ok(()),
        other => Err(AssociationError::Field {
            problem: format!(
                "ranges and azimuths are of the plane, and the tracks have {other} coordinates a scan"
            ),
        }),
    }
}

/// q lengthened by `more`, its direction, and the derivative of the lengthened vector by q. At the sensor itself there is
/// no direction, and nothing is lengthened.
fn stretched(q: Vector2<f64>, more: f64) -> (Vector2<f64>, Vector2<f64>, Matrix2<f64>) {
    let length = q.norm();
    if length <= f64::MIN_POSITIVE {
        return (q, Vector2::zeros(), Matrix2::identity());
    }
    let u = q / length;
    let share = more / length;
    (q + more * u, u, Matrix2::identity() * (1.0 + share) - share * u * u.transpose())
}

fn rotation(angle: f64) -> Matrix2<f64> {
    let (sine, cosine) = angle.sin_cos();
    Matrix2::new(cosine, -sine, sine, cosine)
}

/// Turned by a quarter.
fn across(v: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}
