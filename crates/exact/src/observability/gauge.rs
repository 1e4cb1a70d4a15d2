//! Free directions told as motions of a whole, or as coordinates of variables.

use super::FreeDirections;
use super::null_space::{NullSpace, add_orthonormal, squared_image};
use super::words;
use crate::{ExactError, Problem, Values};
use sumprod_graph::{Coordinate, Space};
use sumprod_models::pose::Pose3;

/// The share of its bound below which a motion's effect on the factors is rounding.
const STILL: f64 = 1e-18;
/// The share of a free direction's squared length that a variable must have to be named.
const NAMED: f64 = 1e-4;

/// How a variable's position lies in its coordinates.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Place {
    Plane { position: [usize; 2], velocity: Option<[usize; 2]>, heading: Option<usize> },
    PosePlane,
    Point,
    PoseSpace,
}

impl Place {
    /// What a space's coordinates may mean; whether they do is tried on the factors.
    pub(super) fn of(space: &Space) -> Option<Self> {
        use Coordinate::{Angle, Real};
        let plane = |position, velocity, heading| Some(Self::Plane { position, velocity, heading });
        match space {
            Space::Se2 => Some(Self::PosePlane),
            Space::Se3 => Some(Self::PoseSpace),
            Space::Continuous(coordinates) => match coordinates.as_slice() {
                [Real, Real] => plane([0, 1], None, None),
                [Real, Real, Angle] => plane([0, 1], None, Some(2)),
                [Real, Real, Real] => Some(Self::Point),
                [Real, Real, Real, Real] => plane([0, 2], Some([1, 3]), None),
                _ => None,
            },
            Space::Finite(_) => None,
        }
    }

    fn axes(self) -> usize {
        if matches!(self, Self::Point | Self::PoseSpace) { 3 } else { 2 }
    }
}

/// A motion of everything.
#[derive(Clone, Copy)]
enum Motion {
    Along(usize),
    About(usize),
    Scale,
}

impl Motion {
    fn name(self, axes: usize) -> String {
        const AXES: [&str; 3] = ["x", "y", "z"];
        match self {
            Self::Along(axis) => format!("the position along {}", AXES[axis]),
            Self::About(_) if axes == 2 => "the orientation of the whole (rotation in the plane)".to_owned(),
            Self::About(axis) => format!("the orientation of the whole about {}", AXES[axis]),
            Self::Scale => "the scale of the whole".to_owned(),
        }
    }
}

/// Turns a vector of the world into the frame of a pose.
fn into_frame(heading: f64, [x, y]: [f64; 2]) -> [f64; 2] {
    let (sine, cosine) = heading.sin_cos();
    [cosine * x + sine * y, cosine * y - sine * x]
}

fn turned(axis: usize, p: [f64; 3]) -> [f64; 3] {
    match axis {
        0 => [0.0, -p[2], p[1]],
        1 => [p[2], 0.0, -p[0]],
        _ => [-p[1], p[0], 0.0],
    }
}

/// The step that a motion gives a variable.
fn step(place: Place, motion: Motion, value: &[f64], out: &mut [f64]) {
    let unit = |axis: usize| [0, 1, 2].map(|k| f64::from(u8::from(k == axis)));
    match place {
        Place::Plane { position, velocity, heading } => {
            let [x, y] = position.map(|k| value[k]);
            let moved = match motion {
                Motion::Along(axis) => [unit(axis)[0], unit(axis)[1]],
                Motion::About(_) => [-y, x],
                Motion::Scale => [x, y],
            };
            (out[position[0]], out[position[1]]) = (moved[0], moved[1]);
            if let (Some([u, v]), Motion::About(_) | Motion::Scale) = (velocity, motion) {
                let (a, b) = (value[u], value[v]);
                (out[u], out[v]) = if matches!(motion, Motion::Scale) { (a, b) } else { (-b, a) };
            }
            if let (Some(heading), Motion::About(_)) = (heading, motion) {
                out[heading] = 1.0;
            }
        }
        Place::PosePlane => {
            let moved = match motion {
                Motion::Along(axis) => [unit(axis)[0], unit(axis)[1]],
                Motion::About(_) => [-value[1], value[0]],
                Motion::Scale => [value[0], value[1]],
            };
            out[..2].copy_from_slice(&into_frame(value[2], moved));
            out[2] = if matches!(motion, Motion::About(_)) { 1.0 } else { 0.0 };
        }
        Place::Point | Place::PoseSpace => {
            let p = [value[0], value[1], value[2]];
            let moved = match motion {
                Motion::Along(axis) => unit(axis),
                Motion::About(axis) => turned(axis, p),
                Motion::Scale => p,
            };
            if place == Place::Point {
                return out[..3].copy_from_slice(&moved);
            }
            let mut frame = Pose3::read(value);
            frame.position = [0.0; 3];
            out[..3].copy_from_slice(&frame.local(moved));
            let turn = if let Motion::About(axis) = motion { frame.local(unit(axis)) } else { [0.0; 3] };
            out[3..6].copy_from_slice(&turn);
        }
    }
}

/// The name of a local coordinate.
fn coordinate_name(space: &Space, index: usize) -> String {
    let known: &[&str] = match space {
        Space::Se3 => &["x", "y", "z", "rotation about x", "rotation about y", "rotation about z"],
        _ if Place::of(space).is_some_and(|place| place.axes() == 2) && space.dimension() == 3 => {
            &["x", "y", "heading"]
        }
        _ => &[],
    };
    match known.get(index) {
        Some(name) => (*name).to_owned(),
        None if space.degrees_of_freedom() == 1 => "the value".to_owned(),
        None => format!("coordinate {index}"),
    }
}

/// Describes the free directions of a component, whose orthonormal basis this is.
pub(super) fn describe(
    problem: &Problem<'_>,
    values: &Values,
    space: &NullSpace,
    component: &[u32],
    basis: Vec<Vec<f64>>,
    several: bool,
) -> Result<FreeDirections, ExactError> {
    let dimension = basis.len();
    let (mut named, mut directions) = (Vec::new(), Vec::new());
    let mut motions = Vec::new();
    let places: Vec<Option<Place>> =
        component.iter().map(|&v| Place::of(problem.space(v as usize))).collect();
    let axes = places.iter().flatten().map(|place| place.axes()).max().unwrap_or(0);
    let uniform = places.iter().flatten().all(|place| place.axes() == axes);
    if axes > 0 && uniform {
        let along = (0..axes).map(Motion::Along);
        let about = (if axes == 2 { 2..3 } else { 0..3 }).map(Motion::About);
        for motion in along.chain(about).chain([Motion::Scale]) {
            let mut vector = vec![0.0; problem.degrees_of_freedom()];
            for (&variable, place) in component.iter().zip(&places) {
                if let Some(place) = *place {
                    let index = variable as usize;
                    let value = &values.numbers[problem.layout().range(index)];
                    step(place, motion, value, &mut vector[problem.layout().freedoms(index)]);
                }
            }
            let (image, bound) = squared_image(problem, values, &vector)?;
            vector.iter_mut().zip(space.scale()).for_each(|(x, scale)| *x /= scale);
            let length = crate::solve::dot(&vector, &vector).sqrt();
            vector.iter_mut().for_each(|x| *x /= length.max(f64::MIN_POSITIVE));
            if length > 0.0 && image <= STILL * bound && add_orthonormal(&mut named, vector, 1e-6) {
                directions.push(motion.name(axes));
                motions.push(motion);
            }
        }
    }
    let whole = named.len();
    let mut rest = Vec::new();
    for vector in basis {
        let mut both = named.clone();
        if add_orthonormal(&mut both, vector, 1e-4)
            && let Some(left) = both.pop()
        {
            add_orthonormal(&mut rest, left, 1e-4);
        }
    }
    rest.truncate(dimension.saturating_sub(whole));
    let mut moving: Vec<u32> = if whole > 0 { component.to_vec() } else { Vec::new() };
    let weakest = name_rest(problem, component, &rest, &mut moving, &mut directions);
    moving.sort_unstable();
    moving.dedup();
    Ok(FreeDirections {
        variables: moving.iter().map(|&v| problem.variable_name(v as usize)).collect(),
        dimension,
        remedy: remedy(&motions, axes, weakest, several && whole > 0),
        directions,
        apart: several && whole > 0,
    })
}

/// Names the coordinates that free directions move, beyond motions of the whole; returns the one that moves most.
fn name_rest(
    problem: &Problem<'_>,
    component: &[u32],
    rest: &[Vec<f64>],
    moving: &mut Vec<u32>,
    directions: &mut Vec<String>,
) -> Option<String> {
    if rest.is_empty() {
        return None;
    }
    let mut labels: Vec<(String, Vec<u32>)> = Vec::new();
    let mut weakest: Option<(f64, String)> = None;
    for &variable in component {
        let index = variable as usize;
        let space = problem.space(index);
        for (k, row) in problem.layout().freedoms(index).enumerate() {
            let share: f64 = rest.iter().map(|vector| vector[row] * vector[row]).sum();
            if share < NAMED * rest.len() as f64 {
                continue;
            }
            moving.push(variable);
            let label = coordinate_name(space, k);
            if weakest.as_ref().is_none_or(|(most, _)| share > *most) {
                weakest = Some((share, format!("{label} of {}", problem.variable_name(index))));
            }
            match labels.iter_mut().find(|(known, _)| *known == label) {
                Some((_, variables)) => variables.push(variable),
                None => labels.push((label, vec![variable])),
            }
        }
    }
    for (label, variables) in labels {
        let names: Vec<String> = variables.iter().map(|&v| problem.variable_name(v as usize)).collect();
        let together = if rest.len() == 1 { "" } else { " in some combination" };
        directions.push(format!("{label}{together} ({})", words::names(&names)));
    }
    weakest.map(|(_, name)| name)
}

fn remedy(motions: &[Motion], axes: usize, weakest: Option<String>, apart: bool) -> String {
    let moved = |wanted: fn(&Motion) -> bool| motions.iter().filter(|motion| wanted(motion)).count();
    let along = moved(|motion| matches!(motion, Motion::Along(_)));
    let about = moved(|motion| matches!(motion, Motion::About(_)));
    let scale = moved(|motion| matches!(motion, Motion::Scale));
    let mut remedies = Vec::new();
    match (along, about) {
        (0, 0) => {}
        (0, _) => remedies
            .push("add a prior on one orientation, or the known place of a second variable".to_owned()),
        (_, 0) => remedies.push("add a prior on one position, or a measurement to a known place".to_owned()),
        _ => {
            let anchors = if axes == 2 { "two known places" } else { "three known places not in a line" };
            remedies.push(format!("add a prior on one pose, or measurements to {anchors}"));
        }
    }
    if scale > 0 {
        remedies.push("add one known distance".to_owned());
    }
    if let Some(name) = weakest {
        remedies.push(format!("add a prior on, or a factor that measures, {name}"));
    }
    let joined = if apart { "join them to the others by factors, or " } else { "" };
    format!("{joined}{}", remedies.join("; "))
}
