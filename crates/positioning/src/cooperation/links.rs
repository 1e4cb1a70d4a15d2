//! Who is within reach of whom, by a grid of cells as wide as the radius.

use std::collections::HashMap;

/// Points that can be asked for those near a place.
pub(crate) struct Reach<'a> {
    points: &'a [[f64; 2]],
    radius: f64,
    /// Points by cell, ascending; empty where there is no radius.
    cells: HashMap<[i64; 2], Vec<u32>>,
}

impl<'a> Reach<'a> {
    /// Points in reach of each other up to `radius`, all without one.
    pub(crate) fn new(points: &'a [[f64; 2]], radius: Option<f64>) -> Self {
        let mut cells: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        if let Some(radius) = radius {
            for (index, &point) in points.iter().enumerate() {
                cells.entry(cell(point, radius)).or_default().push(index as u32);
            }
        }
        Self { points, radius: radius.unwrap_or(f64::INFINITY), cells }
    }

    /// Indices and distances of the points within reach of `place`, ascending by index.
    pub(crate) fn within(&self, place: [f64; 2]) -> impl Iterator<Item = (usize, f64)> {
        let mut near: Vec<u32> = Vec::new();
        if self.radius.is_finite() {
            let [column, row] = cell(place, self.radius);
            for dx in -1..=1 {
                for dy in -1..=1 {
                    let cell = [column.saturating_add(dx), row.saturating_add(dy)];
                    near.extend(self.cells.get(&cell).into_iter().flatten());
                }
            }
            near.sort_unstable();
            near.dedup();
        } else {
            near.extend(0..self.points.len() as u32);
        }
        let distance = move |index: u32| {
            let point = self.points[index as usize];
            (index as usize, (place[0] - point[0]).hypot(place[1] - point[1]))
        };
        near.into_iter().map(distance).filter(|&(_, distance)| distance <= self.radius)
    }
}

fn cell(point: [f64; 2], radius: f64) -> [i64; 2] {
    point.map(|x| (x / radius).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_finds_what_a_search_of_all_finds() {
        let points: Vec<[f64; 2]> =
            (0..200).map(|k| [f64::from(k * 37 % 101) - 50.0, f64::from(k * 53 % 97) - 40.0]).collect();
        let grid = Reach::new(&points, Some(12.0));
        let all = Reach::new(&points, None);
        for &place in &points {
            let near: Vec<_> = grid.within(place).collect();
            let expected: Vec<_> = all.within(place).filter(|&(_, distance)| distance <= 12.0).collect();
            assert_eq!(near, expected);
            assert_eq!(all.within(place).count(), 200);
        }
    }
}
