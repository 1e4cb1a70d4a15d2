//! Where the walker can be, and the grid over it.

/// A rectangle of square cells.
pub struct Area {
    low: [f64; 2],
    counts: [usize; 2],
    cell: f64,
}

/// Most cells of a grid: beyond, the cell is taken larger.
const MOST: usize = 100_000;

impl Area {
    /// The bounding box of the nodes and a margin, in cells of about this side (m).
    pub fn around(nodes: &[[f64; 2]], margin: f64, cell: f64) -> Self {
        let ends = [0, 1].map(|k| {
            let along = nodes.iter().map(|node| node[k]);
            (
                along.clone().fold(f64::INFINITY, f64::min) - margin,
                along.fold(f64::NEG_INFINITY, f64::max) + margin,
            )
        });
        let sides = ends.map(|(low, high)| high - low);
        let cell =
            cell.max((sides[0] * sides[1] / MOST as f64).sqrt()).max(sides[0].max(sides[1]) / MOST as f64);
        let counts = sides.map(|side| ((side / cell).ceil() as usize).max(1));
        Self { low: ends.map(|(low, _)| low), counts, cell }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.counts[0] * self.counts[1]
    }

    /// Number of cells along each axis; the cells of one x follow each other.
    pub fn counts(&self) -> [usize; 2] {
        self.counts
    }

    /// Side of a cell (m).
    pub fn cell(&self) -> f64 {
        self.cell
    }

    /// Middle of a cell (m).
    pub fn middle(&self, index: usize) -> [f64; 2] {
        let at = [index / self.counts[1], index % self.counts[1]];
        [0, 1].map(|k| self.low[k] + (at[k] as f64 + 0.5) * self.cell)
    }

    /// Whether a point lies inside.
    pub fn holds(&self, point: &[f64]) -> bool {
        (0..2).all(|k| (0.0..=self.counts[k] as f64 * self.cell).contains(&(point[k] - self.low[k])))
    }

    /// Middle of the whole (m), and the variance of each coordinate of a point anywhere in it (m²).
    pub fn moments(&self) -> ([f64; 2], [f64; 2]) {
        let sides = self.counts.map(|count| count as f64 * self.cell);
        ([0, 1].map(|k| self.low[k] + 0.5 * sides[k]), sides.map(|side| side * side / 12.0))
    }
}
