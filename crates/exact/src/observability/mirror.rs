//! Mirror ambiguities: a reflected answer that the factors like as well.
//!
//! No direction is free there, so no rank tells; two answers lie apart, and a solve finds the one nearer to its start. The
//! mirrors tried are lines through the known places of a connected part, where these lie in a line, with everything
//! reflected; and lines through what one variable is tied to, with that variable alone reflected. The factors decide: the
//! loss of each must stay as it was.

use super::gauge::Place;
use super::words;
use crate::{ExactError, Problem, Values};
use std::fmt;
use sumprod_graph::wrap_angle;
use sumprod_models::Expansion;

/// Variables whose reflection leaves every factor's loss as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorImage {
    /// The variables that would be reflected, by name.
    pub variables: Vec<String>,
    /// A point of the mirror and its direction in the plane (m).
    pub mirror: ([f64; 2], [f64; 2]),
    /// How far the farthest of them would move (m).
    pub distance: f64,
}

impl fmt::Display for MirrorImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y], [u, v]) = self.mirror;
        write!(
            f,
            "nothing tells {} from a mirror image at the line through ({x:.3}, {y:.3}) m along ({u:.3}, {v:.3}), up to \
             {:.3} m away; add a measurement to a known place off that line, or a prior that tells the side",
            words::names(&self.variables),
            self.distance
        )
    }
}

/// Deviation from a line, relative to its length, within which points lie in it.
const IN_LINE: f64 = 1e-9;
/// Change of a loss, relative to one plus the loss, that is rounding.
const SAME: f64 = 1e-9;

/// All mirror ambiguities in the plane at these values. Linear in the edges for each connected part, but for factors of
/// many variables.
///
/// # Errors
///
/// Where a factor cannot be evaluated.
pub fn mirror_images(problem: &Problem<'_>, values: &Values) -> Result<Vec<MirrorImage>, ExactError> {
    let factors_of = factors_of(problem);
    let mut search = Search { problem, values, question: Expansion::default(), chained: Vec::new() };
    let mut found = Vec::new();
    for component in problem.components() {
        let mut factors: Vec<u32> =
            component.iter().flat_map(|&v| factors_of[v as usize].iter().copied()).collect();
        factors.sort_unstable();
        factors.dedup();
        let mut places = Vec::new();
        for &factor in &factors {
            search.places(factor as usize, &mut places)?;
        }
        let whole = match line(&places) {
            Some(mirror) => search.image(&component, &factors, mirror)?,
            None => None,
        };
        if whole.is_some() || component.len() == 1 {
            found.extend(whole);
            continue;
        }
        for &variable in &component {
            let own = &factors_of[variable as usize];
            let mut ties = Vec::new();
            for &factor in own {
                search.places(factor as usize, &mut ties)?;
                for &other in problem.ports(factor as usize).iter().filter(|&&other| other != variable) {
                    ties.extend(search.position(other));
                }
            }
            if let Some(mirror) = line(&ties) {
                found.extend(search.image(&[variable], own, mirror)?);
            }
        }
    }
    Ok(found)
}

/// The factors at each variable.
fn factors_of(problem: &Problem<'_>) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); problem.variable_count()];
    for factor in 0..problem.factor_count() {
        for &variable in problem.ports(factor) {
            if lists[variable as usize].last() != Some(&(factor as u32)) {
                lists[variable as usize].push(factor as u32);
            }
        }
    }
    lists
}

/// The line that some points lie in, by a point and a unit direction; none where they are fewer than two or spread.
fn line(points: &[[f64; 2]]) -> Option<([f64; 2], [f64; 2])> {
    let &[x, y] = points.first()?;
    let far =
        points.iter().max_by(|a, b| (a[0] - x).hypot(a[1] - y).total_cmp(&(b[0] - x).hypot(b[1] - y)))?;
    let (u, v) = (far[0] - x, far[1] - y);
    let length = u.hypot(v);
    if length <= 1e-9 * (1.0 + x.hypot(y)) {
        return None;
    }
    let (u, v) = (u / length, v / length);
    let aside = |p: &[f64; 2]| ((p[0] - x) * v - (p[1] - y) * u).abs();
    points.iter().all(|p| aside(p) <= IN_LINE * length).then_some(([x, y], [u, v]))
}

struct Search<'p, 'g> {
    problem: &'p Problem<'g>,
    values: &'p Values,
    question: Expansion,
    chained: Vec<f64>,
}

impl Search<'_, '_> {
    fn loss(&mut self, factor: usize, values: &Values) -> Result<f64, ExactError> {
        self.problem.expand(factor, &values.numbers, false, &mut self.question, &mut self.chained)?;
        Ok(self.question.loss)
    }

    /// The known places that a factor refers to.
    fn places(&mut self, factor: usize, out: &mut Vec<[f64; 2]>) -> Result<(), ExactError> {
        self.problem.expand(factor, &self.values.numbers, false, &mut self.question, &mut self.chained)?;
        out.extend(
            self.question.places.iter().filter(|place| place.len() == 2).map(|place| [place[0], place[1]]),
        );
        Ok(())
    }

    fn position(&self, variable: u32) -> Option<[f64; 2]> {
        let value = self.values.at(variable as usize);
        match Place::of(self.problem.space(variable as usize))? {
            Place::PosePlane => Some([value[0], value[1]]),
            Place::Plane { position: [x, y], .. } => Some([value[x], value[y]]),
            _ => None,
        }
    }

    /// The mirror image of some variables, where all factors at them are indifferent to it.
    fn image(
        &mut self,
        variables: &[u32],
        factors: &[u32],
        mirror: ([f64; 2], [f64; 2]),
    ) -> Result<Option<MirrorImage>, ExactError> {
        let mut mirrored = self.values.clone();
        let (mut moved, mut distance, mut extent): (Vec<u32>, f64, f64) = (Vec::new(), 0.0, 0.0);
        for &variable in variables {
            let Some(before) = self.position(variable) else { continue };
            let index = variable as usize;
            let own = &mut mirrored.numbers[self.problem.layout().range(index)];
            let Some(place) = Place::of(self.problem.space(index)) else { continue };
            reflect(place, mirror, own);
            let after = match place {
                Place::Plane { position: [x, y], .. } => [own[x], own[y]],
                _ => [own[0], own[1]],
            };
            let step = (after[0] - before[0]).hypot(after[1] - before[1]);
            (distance, extent) = (distance.max(step), extent.max(before[0].hypot(before[1])));
            moved.push(variable);
        }
        if distance <= 1e-6 * (1.0 + extent) {
            return Ok(None);
        }
        for &factor in factors {
            let before = self.loss(factor as usize, self.values)?;
            // A residual that the image cannot have tells the two apart.
            let Ok(after) = self.loss(factor as usize, &mirrored) else { return Ok(None) };
            if (after - before).abs() > SAME * (1.0 + before) {
                return Ok(None);
            }
        }
        let variables = moved.iter().map(|&v| self.problem.variable_name(v as usize)).collect();
        Ok(Some(MirrorImage { variables, mirror, distance }))
    }
}

/// Reflects a value at a line.
fn reflect(place: Place, ([px, py], [u, v]): ([f64; 2], [f64; 2]), value: &mut [f64]) {
    let vector = |[x, y]: [f64; 2]| {
        let along = x * u + y * v;
        [2.0 * along * u - x, 2.0 * along * v - y]
    };
    let (position, velocity, heading) = match place {
        Place::Plane { position, velocity, heading } => (position, velocity, heading),
        Place::PosePlane => ([0, 1], None, Some(2)),
        Place::Point | Place::PoseSpace => return,
    };
    let [x, y] = vector([value[position[0]] - px, value[position[1]] - py]);
    (value[position[0]], value[position[1]]) = (px + x, py + y);
    if let Some([a, b]) = velocity {
        [value[a], value[b]] = vector([value[a], value[b]]);
    }
    if let Some(heading) = heading {
        value[heading] = wrap_angle(2.0 * v.atan2(u) - value[heading]);
    }
}
