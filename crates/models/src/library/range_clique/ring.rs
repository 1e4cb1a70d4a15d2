//! A ring cut into tiles whose sum is a flat prior.

use super::climb::Tile;
use std::f64::consts::{PI, TAU};

/// Sagitta of a tile, in standard deviations of the range: how far its middle and its ends lie apart across the ring.
const SAGITTA: f64 = 0.1;
/// Fewest tiles of a ring whose radius is no longer than its noise.
const FEWEST: usize = 8;

/// Tiles around `centre` at `radius` (m), for ranges of this standard deviation (m): as many as keep each of them
/// straight, `most` at most.
///
/// With spacing Δ, tiles of standard deviation s = Δ/2 and height Δ / (s √2π) sum to one within 2 exp(-2π²/4) = 1.5 %.
/// Their sagitta is s² / 2 radius.
pub(super) fn tiles(centre: [f64; 2], radius: f64, deviation: f64, most: usize) -> Vec<Tile> {
    let radius = radius.max(deviation);
    let straight = (2.0 * SAGITTA * radius * deviation).sqrt();
    let wanted = (PI * radius / straight).ceil().max(FEWEST as f64);
    // A float beyond the integers saturates.
    let count = (wanted as usize).min(most).max(1);
    let width = PI * radius / count as f64;
    (0..count)
        .map(|number| {
            let (sine, cosine) = (TAU * number as f64 / count as f64).sin_cos();
            Tile {
                centre: [centre[0] + radius * cosine, centre[1] + radius * sine],
                tangent: [-sine, cosine],
                variance: width * width,
                log_height: (2.0 / TAU.sqrt()).ln(),
                radius,
            }
        })
        .collect()
}

/// The one tile of a Gaussian: along the ring at the point nearest to `start`, and as wide as the whole ring is along an
/// axis.
pub(super) fn single(centre: [f64; 2], radius: f64, start: [f64; 2]) -> Tile {
    let (sine, cosine) = (start[1] - centre[1]).atan2(start[0] - centre[0]).sin_cos();
    Tile {
        centre: [centre[0] + radius * cosine, centre[1] + radius * sine],
        tangent: [-sine, cosine],
        variance: 0.5 * radius * radius,
        log_height: 0.0,
        radius,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_sum_to_a_flat_prior_and_are_straight() {
        let (centre, radius, deviation) = ([3.0, -2.0], 67.0, 2.0);
        let ring = tiles(centre, radius, deviation, usize::MAX);
        assert_eq!(ring.len(), 41);
        assert!(ring[0].variance / (2.0 * radius) <= SAGITTA * deviation);
        for number in 0..1000 {
            let angle = f64::from(number) * TAU / 1000.0;
            let sum: f64 = ring
                .iter()
                .filter(|tile| {
                    tile.faces([centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()])
                })
                .map(|tile| {
                    let offset =
                        tile.tangent[0] * radius * angle.cos() + tile.tangent[1] * radius * angle.sin();
                    (tile.log_height - 0.5 * offset * offset / tile.variance).exp()
                })
                .sum();
            assert!((sum - 1.0).abs() < 0.03, "{angle}: {sum}");
        }
        assert_eq!(tiles(centre, 67.0, 2.0, 10).len(), 10);
        assert_eq!(tiles(centre, 0.0, 2.0, 100).len(), FEWEST);
        assert_eq!(tiles(centre, 1e300, 1e-9, 7).len(), 7);
    }
}
