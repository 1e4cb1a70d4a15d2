//! A checker of users' residuals.

use crate::residual::{Chart, Linearised, Residual, ResidualModel};
use crate::{Expansion, Manifold};
use sumprod_graph::Space;
use thiserror::Error;

/// A derivative that differs from the finite difference.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "component {component} of the residual by coordinate {coordinate} of port {port}: derivative {derivative:.9e}, \
     finite difference {difference:.9e}"
)]
pub struct DerivativeMismatch {
    /// Component of the residual.
    pub component: usize,
    /// The port.
    pub port: usize,
    /// The coordinate there.
    pub coordinate: usize,
    /// The derivative by dual numbers.
    pub derivative: f64,
    /// The central difference.
    pub difference: f64,
}

/// Holds a residual's derivatives against central differences at `x`, one slice per port.
///
/// `tolerance` is relative to the larger of the derivative and one; 1e-6 suits smooth residuals.
///
/// # Errors
///
/// The first derivative that differs, or is not finite.
///
/// # Panics
///
/// Where `x` does not match the residual's ports.
pub fn check_residual<R: Residual>(
    residual: &R,
    x: &[&[f64]],
    tolerance: f64,
) -> Result<(), DerivativeMismatch> {
    let dimensions = residual.dimensions();
    assert!(x.iter().map(|x| x.len()).eq(dimensions.iter().copied()), "one slice per port, of its dimension");
    let mut point: Vec<f64> = x.concat();
    let (m, n) = (residual.noise().dimension(), point.len());
    let model = ResidualModel(residual);
    let (mut value, mut jacobian) = (vec![0.0; m], vec![0.0; m * n]);
    model.linearise(&point, &mut value, &mut jacobian);
    let mut column = 0;
    for (port, &dimension) in dimensions.iter().enumerate() {
        for coordinate in 0..dimension {
            let centre = point[column];
            let step = f64::EPSILON.cbrt() * centre.abs().max(1.0);
            let (mut above, mut below) = (vec![0.0; m], vec![0.0; m]);
            point[column] = centre + step;
            model.evaluate(&point, &mut above);
            point[column] = centre - step;
            model.evaluate(&point, &mut below);
            point[column] = centre;
            for component in 0..m {
                let mut rise = above[component] - below[component];
                if residual.angles().contains(&component) {
                    rise = sumprod_graph::wrap_angle(rise);
                }
                let difference = rise / (2.0 * step);
                let derivative = jacobian[component * n + column];
                let allowed = tolerance * derivative.abs().max(1.0);
                let agrees = (derivative - difference).abs() <= allowed;
                if !agrees {
                    return Err(DerivativeMismatch { component, port, coordinate, derivative, difference });
                }
            }
            column += 1;
        }
    }
    Ok(())
}

/// Holds what joint solves use of a residual against central differences: steps are taken in the local coordinates
/// of the ports' spaces.
///
/// # Errors
///
/// The first derivative that differs, or is not finite; coordinates are degrees of freedom.
///
/// # Panics
///
/// Where `x` or `spaces` do not match the residual's ports.
pub fn check_expansion<R: Residual>(
    residual: &R,
    spaces: &[Space],
    x: &[&[f64]],
    tolerance: f64,
) -> Result<(), DerivativeMismatch> {
    assert!(spaces.iter().map(Space::dimension).eq(x.iter().map(|x| x.len())), "one value per space");
    let model = ResidualModel(residual);
    let mut question = Expansion::default();
    let mut at = |x: &[Vec<f64>], derivative: bool| {
        question.ask(derivative);
        question.point.extend(x.iter().flatten());
        let answered = model.expand(&mut question);
        assert!(answered.is_ok(), "the point matches the ports");
        (question.residual.clone(), question.jacobian.clone(), question.chart)
    };
    let centre: Vec<Vec<f64>> = x.iter().map(|x| x.to_vec()).collect();
    let (value, jacobian, chart) = at(&centre, true);
    let m = value.len();
    let width = jacobian.len() / m;
    let mut start = 0;
    for (port, space) in spaces.iter().enumerate() {
        let (n, d) = (space.dimension(), space.degrees_of_freedom());
        let mut steps = vec![0.0; n * d];
        let chained = chart == Chart::Coordinates && space.step_derivative(x[port], &mut steps);
        for coordinate in 0..d {
            let step = f64::EPSILON.cbrt();
            let mut moved = [centre.clone(), centre.clone()];
            for (sign, moved) in [1.0, -1.0].into_iter().zip(&mut moved) {
                let mut offset = vec![0.0; d];
                offset[coordinate] = sign * step;
                space.retract(&mut moved[port], &offset);
            }
            let [above, below] = moved.map(|x| at(&x, false).0);
            for component in 0..m {
                let row = &jacobian[component * width + start..];
                let derivative = match chained {
                    true => (0..n).map(|k| row[k] * steps[k * d + coordinate]).sum(),
                    false => row[coordinate],
                };
                let difference = (above[component] - below[component]) / (2.0 * step);
                let agrees = (derivative - difference).abs() <= tolerance * f64::abs(derivative).max(1.0);
                if !agrees {
                    return Err(DerivativeMismatch { component, port, coordinate, derivative, difference });
                }
            }
        }
        start += if chart == Chart::Local { d } else { n };
    }
    Ok(())
}
