//! Decisions: nearest neighbours, and the assignment of least total distance among pairs within a gate.
//!
//! A pair at distance d within the gate g is worth g² − d², no pair is worth nothing; the assignment of largest worth is
//! the one of least squared distance where not to be assigned costs g²/2 a track. Tracks that no chain of gated pairs
//! connects are assigned apart: each group is one small matrix for the Hungarian method.

use pathfinding::kuhn_munkres::{Weights, kuhn_munkres};

use super::candidates::{Candidates, squared_distance};
use super::error::AssociationError;
use super::settings::positive;
use super::tracks::Tracks;

/// Most pairs within the gate, and most entries of one group's matrix: some hundred megabytes.
const LARGEST: usize = 1 << 24;

/// Worth of a pair at distance zero, in units of the assignment, which are whole so that its sums are exact.
const UNITS: f64 = (1_u64 << 40) as f64;

/// A declared pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the first set's track.
    pub first: usize,
    /// Index of the second set's track.
    pub second: usize,
    /// Their distance, root mean square over the scans, after displacement where there was one (m).
    pub distance: f64,
}

/// To each first track the nearest second one closer than `gate` (m), by first track. A second track may be taken twice.
///
/// # Errors
/// [`AssociationError::Shapes`], and [`AssociationError::Parameter`] for a gate that is not positive.
pub fn nearest(first: &Tracks, second: &Tracks, gate: f64) -> Result<Vec<Pair>, AssociationError> {
    let gated = gated(first, second, gate)?;
    let mut best: Vec<Option<Pair>> = vec![None; first.len()];
    for pair in gated {
        let slot = &mut best[pair.first];
        if slot.is_none_or(|held| pair.distance < held.distance) {
            *slot = Some(pair);
        }
    }
    Ok(best.into_iter().flatten().collect())
}

/// The one-to-one pairs of least total squared distance where leaving a track alone costs half of the squared gate (m),
/// by first track. Near n log n where few tracks compete, cubic in the number of those that do.
///
/// # Errors
/// As [`nearest`], and [`AssociationError::Crowded`].
pub fn global_nearest(first: &Tracks, second: &Tracks, gate: f64) -> Result<Vec<Pair>, AssociationError> {
    let gated = gated(first, second, gate)?;
    let mut chosen = Vec::with_capacity(first.len().min(second.len()));
    for group in groups(&gated, first.len(), second.len()) {
        assign(&group, gate, &mut chosen)?;
    }
    chosen.sort_unstable_by_key(|pair| pair.first);
    Ok(chosen)
}

/// All pairs closer than the gate, by second track.
fn gated(first: &Tracks, second: &Tracks, gate: f64) -> Result<Vec<Pair>, AssociationError> {
    positive("gate", gate)?;
    first.agree(second)?;
    let candidates = Candidates::collect(first, second, gate, LARGEST).ok_or(AssociationError::Crowded {
        first: first.len(),
        second: second.len(),
        gate,
        limit: LARGEST,
    })?;
    let (width, scans) = (first.width(), first.scans() as f64);
    let at = |tracks: &'_ Tracks, i: usize, j: usize, other: &Tracks| {
        let [a, b] = [&tracks.coordinates()[i * width..], &other.coordinates()[j * width..]];
        (squared_distance(&a[..width], &b[..width]) / scans).sqrt()
    };
    let pair = |(_, m, n)| Pair { first: m, second: n, distance: at(first, m, n, second) };
    Ok(candidates.pairs().map(pair).filter(|pair| pair.distance < gate).collect())
}

/// The pairs that hang together, group by group in the order of their first pair.
fn groups(pairs: &[Pair], first: usize, second: usize) -> Vec<Vec<Pair>> {
    let mut parents: Vec<usize> = (0..first + second).collect();
    let root = |parents: &mut [usize], mut node: usize| {
        while parents[node] != node {
            parents[node] = parents[parents[node]];
            node = parents[node];
        }
        node
    };
    for pair in pairs {
        let (a, b) = (root(&mut parents, pair.first), root(&mut parents, first + pair.second));
        parents[a.max(b)] = a.min(b);
    }
    let mut places = vec![usize::MAX; first + second];
    let mut groups: Vec<Vec<Pair>> = Vec::new();
    for pair in pairs {
        let place = &mut places[root(&mut parents, pair.first)];
        if *place == usize::MAX {
            *place = groups.len();
            groups.push(Vec::new());
        }
        groups[*place].push(*pair);
    }
    groups
}

/// One group's worths; rows are the fewer.
struct Worth {
    rows: Vec<usize>,
    columns: Vec<usize>,
    entries: Vec<i64>,
    sign: i64,
}

impl Weights<i64> for Worth {
    fn rows(&self) -> usize {
        self.rows.len()
    }

    fn columns(&self) -> usize {
        self.columns.len()
    }

    fn at(&self, row: usize, column: usize) -> i64 {
        self.sign * self.entries[row * self.columns.len() + column]
    }

    fn neg(&self) -> Self {
        let Self { rows, columns, entries, sign } = self;
        Self { rows: rows.clone(), columns: columns.clone(), entries: entries.clone(), sign: -sign }
    }
}

fn assign(group: &[Pair], gate: f64, chosen: &mut Vec<Pair>) -> Result<(), AssociationError> {
    if let [pair] = group {
        chosen.push(*pair);
        return Ok(());
    }
    let distinct = |of: fn(&Pair) -> usize| {
        let mut indices: Vec<usize> = group.iter().map(of).collect();
        indices.sort_unstable();
        indices.dedup();
        indices
    };
    let (first, second) = (distinct(|pair| pair.first), distinct(|pair| pair.second));
    if first.len().saturating_mul(second.len()) > LARGEST {
        let (first, second) = (first.len(), second.len());
        return Err(AssociationError::Crowded { first, second, gate, limit: LARGEST });
    }
    let turned = first.len() > second.len();
    let ends = |pair: &Pair| if turned { [pair.second, pair.first] } else { [pair.first, pair.second] };
    let (rows, columns) = if turned { (second, first) } else { (first, second) };
    let mut worth = Worth { entries: vec![0; rows.len() * columns.len()], rows, columns, sign: 1 };
    let place = |worth: &Worth, pair: &Pair| {
        let [row, column] = ends(pair);
        Some((worth.rows.binary_search(&row).ok()?, worth.columns.binary_search(&column).ok()?))
    };
    for pair in group {
        if let Some((row, column)) = place(&worth, pair) {
            let share = 1.0 - (pair.distance / gate).powi(2);
            worth.entries[row * worth.columns.len() + column] = (UNITS * share).round() as i64;
        }
    }
    let (_, assigned) = kuhn_munkres(&worth);
    // A row that is worth nothing anywhere is given some column all the same; only gated pairs count.
    let kept = group
        .iter()
        .filter(|pair| place(&worth, pair).is_some_and(|(row, column)| assigned.get(row) == Some(&column)));
    chosen.extend(kept);
    Ok(())
}
