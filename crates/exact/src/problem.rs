//! A graph as a joint solve sees it: spaces, the variables of every factor, and their expansions at a point.

use crate::kernel::Kernel;
use crate::layout::Layout;
use crate::shape::Shape;
use crate::{ExactError, Values};
use std::any::Any;
use sumprod_graph::{Factor, FactorGraph, FactorId, Space, VariableId};
use sumprod_messages::GaussianFamily;
use sumprod_models::{Chart, Expansion, Manifold};

/// What a problem needs of a graph, whatever its family of messages.
trait Source: Sync {
    fn answer(&self, factor: FactorId, question: &mut dyn Any) -> bool;
    fn variable_name(&self, variable: VariableId) -> String;
    fn factor_name(&self, factor: FactorId) -> String;
    fn factor_kind(&self, factor: FactorId) -> &str;
}

impl<M: GaussianFamily, F: Factor<M>> Source for FactorGraph<M, F> {
    fn answer(&self, factor: FactorId, question: &mut dyn Any) -> bool {
        self.rules(factor).answer(question)
    }

    fn variable_name(&self, variable: VariableId) -> String {
        FactorGraph::variable_name(self, variable)
    }

    fn factor_name(&self, factor: FactorId) -> String {
        FactorGraph::factor_name(self, factor)
    }

    fn factor_kind(&self, factor: FactorId) -> &str {
        FactorGraph::factor_kind(self, factor)
    }
}

/// A graph to be solved jointly. Its factors are those of the graph, then one for every prior pinned to a variable.
pub struct Problem<'g> {
    source: &'g dyn Source,
    pub(crate) shape: Shape,
}

impl<'g> Problem<'g> {
    /// Reads a graph of any Gaussian family; linear in its edges.
    ///
    /// # Errors
    ///
    /// Where a variable is finite, or a prior is no proper Gaussian.
    pub fn new<M: GaussianFamily, F: Factor<M>>(graph: &'g FactorGraph<M, F>) -> Result<Self, ExactError> {
        Self::grown(&mut Shape::default(), graph)
    }

    /// The problem of a graph whose shape may be known in part; the shape moves into it.
    pub(crate) fn grown<M: GaussianFamily, F: Factor<M>>(
        shape: &mut Shape,
        graph: &'g FactorGraph<M, F>,
    ) -> Result<Self, ExactError> {
        shape.grow(graph)?;
        Ok(Self { source: graph, shape: std::mem::take(shape) })
    }

    /// Judges the residuals of every factor of a kind (the name it was added by) by a robust kernel; those of heavy-tailed
    /// noise have their own.
    pub fn set_kernel(&mut self, kind: &str, kernel: Kernel) {
        self.shape.add_kernel(kind, kernel);
        let of = |&factor: &FactorId| self.shape.kernel_for(self.source.factor_kind(factor));
        self.shape.kernel_of = self.shape.factors.iter().map(of).collect();
    }

    /// The starts of the graph's beliefs, the means of its priors where there is none, else the origin.
    pub fn start(&self) -> Values {
        Values { layout: self.shape.layout.clone(), numbers: self.shape.start.clone() }
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.shape.layout
    }

    /// Number of variables.
    pub fn variable_count(&self) -> usize {
        self.layout().variables()
    }

    /// Number of factors, pinned priors included.
    pub fn factor_count(&self) -> usize {
        self.shape.factor_count()
    }

    /// Number of degrees of freedom of all variables.
    pub fn degrees_of_freedom(&self) -> usize {
        self.layout().size()
    }

    /// The handles of all variables, in order.
    pub fn variables(&self) -> &[VariableId] {
        &self.shape.variables
    }

    /// The space of a variable, by its number.
    pub(crate) fn space(&self, index: usize) -> &Space {
        self.layout().space(index)
    }

    /// A variable's name.
    pub fn variable_name(&self, index: usize) -> String {
        match self.shape.variables.get(index) {
            Some(&variable) => self.source.variable_name(variable),
            None => format!("variable {index}"),
        }
    }

    /// A factor's name; a pinned prior is called by its variable.
    pub fn factor_name(&self, index: usize) -> String {
        match self.shape.factors.get(index) {
            Some(&factor) => self.source.factor_name(factor),
            None => format!("the prior of {}", self.variable_name(self.ports(index)[0] as usize)),
        }
    }

    /// The variables at a factor's ports.
    pub(crate) fn ports(&self, factor: usize) -> &[u32] {
        self.shape.ports(factor)
    }

    pub(crate) fn port_count(&self) -> usize {
        self.shape.port_count()
    }

    /// A factor's residual, whitened and weighted, and, if asked, its derivative by local coordinates, into `out`, at stored
    /// coordinates of all variables.
    ///
    /// # Errors
    ///
    /// Where the factor has no residual, or a number is not finite.
    pub(crate) fn expand(
        &self,
        factor: usize,
        numbers: &[f64],
        derivative: bool,
        out: &mut Expansion,
        chained: &mut Vec<f64>,
    ) -> Result<(), ExactError> {
        out.ask(derivative);
        for &variable in self.ports(factor) {
            out.point.extend_from_slice(&numbers[self.layout().range(variable as usize)]);
        }
        match self.shape.factors.get(factor) {
            Some(&id) => self.ask(id, out)?,
            None => self.shape.priors[factor - self.shape.factors.len()]
                .expand(self.layout().space(self.ports(factor)[0] as usize), out),
        }
        if !out.loss.is_finite() {
            return Err(self.not_finite(factor, out));
        }
        if derivative && out.chart == Chart::Coordinates && !self.layout().is_flat() {
            self.chain(factor, numbers, out, chained);
        }
        if let Some(kernel) = self.shape.kernel_of.get(factor).filter(|kernel| **kernel != Kernel::None) {
            kernel.apply(out);
        }
        Ok(())
    }

    fn ask(&self, factor: FactorId, out: &mut Expansion) -> Result<(), ExactError> {
        let answered = self.source.answer(factor, out);
        let source = match out.refusal.take() {
            None if answered => return Ok(()),
            Some(reason) => reason,
            None => sumprod_graph::MessageError::Unsupported(
                "it has rules for messages alone; give it a residual to solve it jointly with others".into(),
            ),
        };
        Err(ExactError::Factor { factor: self.source.factor_name(factor), source })
    }

    fn not_finite(&self, factor: usize, out: &Expansion) -> ExactError {
        let value = out.residual.iter().copied().find(|r| !r.is_finite()).unwrap_or(out.loss);
        let what = format!("the residual of factor {:?}", self.factor_name(factor));
        ExactError::NotFinite { what, value, remedy: "start its variables elsewhere" }
    }

    /// Turns a derivative by stored coordinates into one by steps.
    fn chain(&self, factor: usize, numbers: &[f64], out: &mut Expansion, chained: &mut Vec<f64>) {
        let ports = self.ports(factor);
        let wide = out.point.len();
        let narrow: usize = ports.iter().map(|&v| self.layout().freedoms(v as usize).len()).sum();
        let rows = out.residual.len();
        chained.clear();
        chained.resize(rows * narrow, 0.0);
        let (mut from, mut to) = (0, 0);
        let mut steps = [0.0; 42];
        for &variable in ports {
            let (range, space) =
                (self.layout().range(variable as usize), self.layout().space(variable as usize));
            let (n, d) = (range.len(), space.degrees_of_freedom());
            let curved = matches!(space, Space::Se2 | Space::Se3)
                && space.step_derivative(&numbers[range], &mut steps[..n * d]);
            for row in 0..rows {
                let source = &out.jacobian[row * wide + from..][..n];
                let target = &mut chained[row * narrow + to..][..d];
                if curved {
                    for (entry, steps) in source.iter().zip(steps.chunks_exact(d)) {
                        target.iter_mut().zip(steps).for_each(|(target, step)| *target += entry * step);
                    }
                } else {
                    target.copy_from_slice(source);
                }
            }
            (from, to) = (from + n, to + d);
        }
        std::mem::swap(&mut out.jacobian, chained);
        out.chart = Chart::Local;
    }

    /// Values moved by a step in local coordinates, all variables one after the other.
    ///
    /// # Errors
    ///
    /// Where sizes do not agree.
    pub fn moved(&self, values: &Values, step: &[f64]) -> Result<Values, ExactError> {
        let (found, expected) = (step.len(), self.degrees_of_freedom());
        if found != expected || values.layout != self.shape.layout {
            let reason =
                format!("a step of {found} numbers does not suit values of {expected} degrees of freedom");
            return Err(ExactError::Request(reason));
        }
        Ok(values.retracted(step))
    }

    /// The sum of all factors' losses at these values.
    ///
    /// # Errors
    ///
    /// As for a solve.
    pub fn cost(&self, values: &Values) -> Result<f64, ExactError> {
        let (mut question, mut chained) = (Expansion::default(), Vec::new());
        let mut sum = 0.0;
        for factor in 0..self.factor_count() {
            self.expand(factor, &values.numbers, false, &mut question, &mut chained)?;
            sum += question.loss;
        }
        Ok(sum)
    }
}
