//! A value for every variable of a problem.

use crate::ExactError;
use crate::layout::Layout;
use std::sync::Arc;
use sumprod_graph::{Space, VariableId};
use sumprod_models::Manifold;

/// Stored coordinates of every variable, one after the other in the graph's order.
#[derive(Clone, Debug)]
pub struct Values {
    pub(crate) layout: Arc<Layout>,
    pub(crate) numbers: Vec<f64>,
}

impl Values {
    /// The stored coordinates of a variable; empty where the handle is of another graph.
    pub fn get(&self, variable: VariableId) -> &[f64] {
        self.at(variable.index())
    }

    /// The stored coordinates of the variable of this number; empty where there is none.
    pub fn at(&self, index: usize) -> &[f64] {
        if index < self.layout.variables() { &self.numbers[self.layout.range(index)] } else { &[] }
    }

    /// The space of the variable of this number.
    ///
    /// # Panics
    ///
    /// Where there is none.
    pub fn space(&self, index: usize) -> &Space {
        self.layout.space(index)
    }

    /// Sets a variable; angles are wrapped and quaternions brought to unit length.
    ///
    /// # Errors
    ///
    /// Where the handle is of another graph, the size is not the variable's, a number is not finite, or a quaternion
    /// vanishes.
    pub fn set(&mut self, variable: VariableId, value: &[f64]) -> Result<(), ExactError> {
        let (index, count) = (variable.index(), self.layout.variables());
        if index >= count {
            return Err(ExactError::Request(format!("there is no variable {index}; the graph has {count}")));
        }
        let space = self.layout.space(index);
        if value.len() != space.dimension() {
            return Err(ExactError::Request(format!(
                "a value of {} numbers was given for variable {index}, whose space stores {}",
                value.len(),
                space.dimension()
            )));
        }
        if let Some(&number) = value.iter().find(|x| !x.is_finite()) {
            let what = format!("a value given for variable {index}");
            return Err(ExactError::NotFinite { what, value: number, remedy: "start from finite numbers" });
        }
        if *space == Space::Se3 && value[3..].iter().all(|q| q.abs() < 1e-6) {
            return Err(ExactError::Request(format!("the quaternion given for variable {index} vanishes")));
        }
        let own = &mut self.numbers[self.layout.range(index)];
        own.copy_from_slice(value);
        space.normalise(own);
        Ok(())
    }

    /// These values moved by a step in local coordinates, all variables one after the other.
    pub(crate) fn retracted(&self, step: &[f64]) -> Self {
        let mut moved = self.clone();
        let layout = &self.layout;
        if layout.is_flat() {
            moved.numbers.iter_mut().zip(step).for_each(|(x, step)| *x += step);
            return moved;
        }
        for index in 0..layout.variables() {
            let own = &mut moved.numbers[layout.range(index)];
            layout.space(index).retract(own, &step[layout.freedoms(index)]);
        }
        moved
    }
}
