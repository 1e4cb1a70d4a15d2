//! Mirror ambiguities: a reflected answer that the factors like as well.
//!
//! No direction is free there, so no rank tells; two answers lie apart, and a solve finds the one nearer to its start. A
//! mirror is a line in the plane or a plane in space. Those tried are the one that the known places of a connected part
//! lie in, with everything reflected; and the one that what a variable is tied to lies in, with that variable alone
//! reflected. The factors decide: the loss of each must stay as it was.

use super::gauge::Place;
use super::words;
use crate::{ExactError, Problem, Values};
use std::f64::consts::PI;
use std::fmt;
use sumprod_graph::wrap_angle;
use sumprod_models::Expansion;

/// A line in the plane or a plane in space, at which points are reflected.
#[derive(Clone, Debug, PartialEq)]
pub struct Mirror {
    /// A point of it (m): two numbers in the plane, three in space.
    pub point: Vec<f64>,
    /// The unit vector that stands on it.
    pub normal: Vec<f64>,
}

impl fmt::Display for Mirror {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.point[..], &self.normal[..]) {
            ([x, y], [u, v]) => {
                write!(f, "the line through ({x:.3}, {y:.3}) m along ({:.3}, {:.3})", v, -u)
            }
            (point, normal) => {
                let numbers = |vector: &[f64]| {
                    let numbers: Vec<String> = vector.iter().map(|x| format!("{x:.3}")).collect();
                    numbers.join(", ")
                };
                let (point, normal) = (numbers(point), numbers(normal));
                write!(f, "the plane through ({point}) m on which ({normal}) stands")
            }
        }
    }
}

impl Mirror {
    /// The mirror that some points lie in; none where they lie in less than a mirror, or are spread.
    fn through(points: &[Point]) -> Option<Self> {
        let first = points.first()?;
        let axes = first.len();
        let from =
            |p: &Point| -> [f64; 3] { std::array::from_fn(|k| if k < axes { p[k] - first[k] } else { 0.0 }) };
        let farthest = |aside: &dyn Fn([f64; 3]) -> [f64; 3]| {
            points.iter().map(|p| aside(from(p))).max_by(|a, b| dot(*a, *a).total_cmp(&dot(*b, *b)))
        };
        let along = farthest(&|p| p)?;
        let extent = dot(along, along).sqrt();
        let size = first.iter().map(|x| x * x).sum::<f64>().sqrt();
        if extent <= IN_MIRROR * (1.0 + size) {
            return None;
        }
        let along = along.map(|x| x / extent);
        let normal = if axes == 2 {
            [-along[1], along[0], 0.0]
        } else {
            let across = farthest(&|p| reject(p, along))?;
            let width = dot(across, across).sqrt();
            if width <= IN_MIRROR * extent {
                return None;
            }
            cross(along, across.map(|x| x / width))
        };
        let within = points.iter().all(|p| dot(from(p), normal).abs() <= IN_MIRROR * extent);
        within.then(|| Self { point: first.to_vec(), normal: normal[..axes].to_vec() })
    }

    /// Reflects a vector, or a position given from [`Mirror::point`].
    fn vector(&self, v: &[f64]) -> Point {
        let depth: f64 = self.normal.iter().zip(v).map(|(n, x)| n * x).sum();
        v.iter().zip(&self.normal).map(|(x, n)| x - 2.0 * depth * n).collect()
    }
}

/// A position, in the plane or in space.
type Point = Vec<f64>;

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// What of a vector is square to a unit vector.
fn reject(v: [f64; 3], unit: [f64; 3]) -> [f64; 3] {
    let depth = dot(v, unit);
    std::array::from_fn(|k| v[k] - depth * unit[k])
}

/// Variables whose reflection leaves every factor's loss as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorImage {
    /// The variables that would be reflected, by name.
    pub variables: Vec<String>,
    /// Where.
    pub mirror: Mirror,
    /// How far the farthest of them would move (m).
    pub distance: f64,
}

impl fmt::Display for MirrorImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = if self.mirror.point.len() == 2 { "line" } else { "plane" };
        write!(
            f,
            "nothing tells {} from a mirror image at {}, up to {:.3} m away; add a measurement to a known place off \
             that {what}, or a prior that tells the side",
            words::names(&self.variables),
            self.mirror,
            self.distance
        )
    }
}

/// Deviation from a mirror, relative to the points' extent, within which they lie in it.
const IN_MIRROR: f64 = 1e-9;
/// Change of a loss, relative to one plus the loss, that is rounding.
const SAME: f64 = 1e-9;

/// All mirror ambiguities in the plane and in space at these values. Linear in the edges for each connected part, but for
/// factors of many variables.
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
        let mut whole = None;
        for axes in [2, 3] {
            let mut places = Vec::new();
            for &factor in &factors {
                search.places(factor as usize, axes, &mut places)?;
            }
            if let (None, Some(mirror)) = (&whole, Mirror::through(&places)) {
                whole = search.image(&component, &factors, &mirror)?;
            }
        }
        if whole.is_some() || component.len() == 1 {
            found.extend(whole);
            continue;
        }
        for &variable in &component {
            let Some(axes) = search.position(variable).map(|place| place.len()) else { continue };
            let own = &factors_of[variable as usize];
            let mut ties = Vec::new();
            for &factor in own {
                search.places(factor as usize, axes, &mut ties)?;
                for &other in problem.ports(factor as usize).iter().filter(|&&other| other != variable) {
                    ties.extend(search.position(other).filter(|place| place.len() == axes));
                }
            }
            if let Some(mirror) = Mirror::through(&ties) {
                found.extend(search.image(&[variable], own, &mirror)?);
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

    /// The known places of as many axes that a factor refers to.
    fn places(&mut self, factor: usize, axes: usize, out: &mut Vec<Point>) -> Result<(), ExactError> {
        self.problem.expand(factor, &self.values.numbers, false, &mut self.question, &mut self.chained)?;
        let places = self.question.places.iter().filter(|place| place.len() == axes);
        out.extend(places.map(|place| place.to_vec()));
        Ok(())
    }

    fn position(&self, variable: u32) -> Option<Point> {
        let value = self.values.at(variable as usize);
        Some(position(Place::of(self.problem.space(variable as usize))?)?.iter().map(|&k| value[k]).collect())
    }

    /// The mirror image of some variables, where all factors at them are indifferent to it.
    fn image(
        &mut self,
        variables: &[u32],
        factors: &[u32],
        mirror: &Mirror,
    ) -> Result<Option<MirrorImage>, ExactError> {
        let mut mirrored = self.values.clone();
        let (mut moved, mut distance, mut extent): (Vec<u32>, f64, f64) = (Vec::new(), 0.0, 0.0);
        for &variable in variables {
            let here = self.position(variable).filter(|place| place.len() == mirror.point.len());
            let Some(before) = here else { continue };
            let index = variable as usize;
            let own = &mut mirrored.numbers[self.problem.layout().range(index)];
            let Some(place) = Place::of(self.problem.space(index)) else { continue };
            let step = reflect(place, mirror, own);
            let away = before.iter().map(|x| x * x).sum::<f64>().sqrt();
            (distance, extent) = (distance.max(step), extent.max(away));
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
        Ok(Some(MirrorImage { variables, mirror: mirror.clone(), distance }))
    }
}

/// Where a value's position stands; none for a pose in space, whose frame a reflection would turn inside out.
fn position(place: Place) -> Option<Vec<usize>> {
    match place {
        Place::Plane { position, .. } => Some(position.to_vec()),
        Place::PosePlane => Some(vec![0, 1]),
        Place::Point => Some(vec![0, 1, 2]),
        Place::PoseSpace => None,
    }
}

/// Reflects a value, and returns how far its position went.
fn reflect(place: Place, mirror: &Mirror, value: &mut [f64]) -> f64 {
    let Some(axes) = position(place).filter(|axes| axes.len() == mirror.point.len()) else { return 0.0 };
    let from: Point = axes.iter().zip(&mirror.point).map(|(&k, p)| value[k] - p).collect();
    let to = mirror.vector(&from);
    for ((&k, p), x) in axes.iter().zip(&mirror.point).zip(&to) {
        value[k] = p + x;
    }
    let (velocity, heading) = match place {
        Place::Plane { velocity, heading, .. } => (velocity, heading),
        Place::PosePlane => (None, Some(2)),
        _ => (None, None),
    };
    if let Some([a, b]) = velocity {
        let reflected = mirror.vector(&[value[a], value[b]]);
        (value[a], value[b]) = (reflected[0], reflected[1]);
    }
    if let (Some(heading), [u, v]) = (heading, &mirror.normal[..]) {
        // Twice the direction of the line, which stands on the normal.
        value[heading] = wrap_angle(2.0 * v.atan2(*u) + PI - value[heading]);
    }
    from.iter().zip(&to).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
