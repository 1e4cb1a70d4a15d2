//! Which tracks are near each other: a grid over the first scan, and lists in one array.

use super::error::AssociationError;
use super::tracks::Tracks;

/// Tracks nearer than this share of the reach are on one another.
const COINCIDENT: f64 = 1e-12;

/// For each second track the first ones within reach, ascending.
#[derive(Clone, Debug, Default)]
pub(super) struct Candidates {
    starts: Vec<usize>,
    members: Vec<u32>,
}

impl Candidates {
    /// Tracks within `radius`, root mean square over the scans, as long as there are no more than `most`; else the
    /// radius shrinks until there are no more. O(n log n) and the pairs within twice the radius.
    ///
    /// # Errors
    /// [`AssociationError::Tracks`] where more pairs than that coincide.
    pub fn within(
        first: &Tracks,
        second: &Tracks,
        radius: f64,
        most: usize,
    ) -> Result<Self, AssociationError> {
        if first.len().saturating_mul(second.len()) <= most && radius == f64::INFINITY {
            let starts = (0..=second.len()).map(|n| n * first.len()).collect();
            let members = (0..second.len()).flat_map(|_| 0..first.len() as u32).collect();
            return Ok(Self { starts, members });
        }
        let mut radius = radius.min(reach(first, second));
        let least = COINCIDENT * radius;
        loop {
            match Self::collect(first, second, radius, most) {
                Some(candidates) => return Ok(candidates),
                None if radius > least => radius *= 0.8,
                None => {
                    let problem = format!(
                        "of {} and {} tracks more than {most} pairs coincide; leave out those that repeat others",
                        first.len(),
                        second.len()
                    );
                    return Err(AssociationError::Tracks { problem });
                }
            }
        }
    }

    /// As [`within`](Self::within) with the radius as it is; `None` where there are more than `most`.
    pub fn collect(first: &Tracks, second: &Tracks, radius: f64, most: usize) -> Option<Self> {
        let scans = first.scans() as f64;
        let grid = Grid::new(first, radius * scans.sqrt());
        let limit = radius * radius * scans;
        let (mut starts, mut members) = (Vec::with_capacity(second.len() + 1), Vec::new());
        starts.push(0);
        for track in second.iter() {
            let start = members.len();
            grid.around(track, |m| {
                if squared_distance(grid.track(m), track) <= limit {
                    members.push(m);
                }
            });
            if members.len() > most {
                return None;
            }
            members[start..].sort_unstable();
            starts.push(members.len());
        }
        Some(Self { starts, members })
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// The pairs of second track `n`: where they begin, and the first tracks.
    #[inline]
    pub fn of(&self, n: usize) -> (usize, &[u32]) {
        let (start, end) = (self.starts[n], self.starts[n + 1]);
        (start, &self.members[start..end])
    }

    /// All pairs in order: its place, the first track, the second.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        (0..self.starts.len().saturating_sub(1)).flat_map(move |n| {
            let (start, members) = self.of(n);
            members.iter().enumerate().map(move |(k, &m)| (start + k, m as usize, n))
        })
    }
}

/// Σ (a − b)².
#[inline]
pub(super) fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// A distance within which all pairs lie.
fn reach(first: &Tracks, second: &Tracks) -> f64 {
    let diagonal: f64 = (0..first.width())
        .map(|i| {
            let values = first.iter().chain(second.iter()).map(|track| track[i]);
            let [low, high] =
                values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
            (high - low).max(0.0).powi(2)
        })
        .sum();
    diagonal.sqrt().max(f64::MIN_POSITIVE)
}

/// Axes of the grid: the first coordinates of the first scan.
const AXES: usize = 3;

type Cell = [i64; AXES];

/// Tracks sorted by cells as wide as the radius.
struct Grid<'a> {
    tracks: &'a [f64],
    width: usize,
    axes: usize,
    per_metre: f64,
    sorted: Vec<(Cell, u32)>,
}

impl<'a> Grid<'a> {
    fn new(tracks: &'a Tracks, radius: f64) -> Self {
        let mut grid = Self {
            tracks: tracks.coordinates(),
            width: tracks.width(),
            axes: tracks.dimension().min(AXES),
            per_metre: 1.0 / radius.max(f64::MIN_POSITIVE),
            sorted: Vec::new(),
        };
        grid.sorted = tracks.iter().zip(0..).map(|(track, m)| (grid.cell(track), m)).collect();
        grid.sorted.sort_unstable();
        grid
    }

    fn track(&self, m: u32) -> &'a [f64] {
        &self.tracks[m as usize * self.width..][..self.width]
    }

    fn cell(&self, track: &[f64]) -> Cell {
        std::array::from_fn(|axis| {
            // The clamp keeps neighbours of the outermost cell countable.
            if axis < self.axes {
                (track[axis] * self.per_metre).floor().clamp(-4e18, 4e18) as i64
            } else {
                0
            }
        })
    }

    /// Calls `visit` with the tracks of the track's own cell and of those around it. Cells that differ in the last axis
    /// alone lie together.
    fn around(&self, track: &[f64], mut visit: impl FnMut(u32)) {
        let middle = self.cell(track);
        let shifts = |axis: usize| if axis + 1 < self.axes { -1..=1 } else { 0..=0 };
        let last = self.axes - 1;
        for i in shifts(0) {
            for j in shifts(1) {
                let mut low = middle;
                low[0] += i;
                low[1] += j;
                let mut high = low;
                low[last] -= 1;
                high[last] += 1;
                let from = self.sorted.partition_point(|(cell, _)| *cell < low);
                self.sorted[from..].iter().take_while(|(cell, _)| *cell <= high).for_each(|&(_, m)| visit(m));
            }
        }
    }
}
