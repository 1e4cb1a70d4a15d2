//! A graph as a joint solve sees it: spaces, the variables of every factor, and their expansions at a point.

use crate::kernel::Kernel;
use crate::{ExactError, Values};
use std::any::Any;
use std::ops::Range;
use std::sync::Arc;
use sumprod_graph::{Factor, FactorGraph, FactorId, Space, VariableId};
use sumprod_messages::{Cholesky, GaussianFamily};
use sumprod_models::{Chart, Expansion, Manifold};

/// Where each variable's numbers lie.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Layout {
    spaces: Vec<Space>,
    space_of: Vec<u32>,
    /// First stored coordinate of each variable, and the number of all.
    coordinate: Vec<u32>,
    /// First degree of freedom of each variable, and the number of all.
    freedom: Vec<u32>,
    flat: bool,
}

impl Layout {
    pub(crate) fn variables(&self) -> usize {
        self.space_of.len()
    }

    pub(crate) fn space(&self, index: usize) -> &Space {
        &self.spaces[self.space_of[index] as usize]
    }

    /// The stored coordinates of a variable.
    pub(crate) fn range(&self, index: usize) -> Range<usize> {
        self.coordinate[index] as usize..self.coordinate[index + 1] as usize
    }

    /// The degrees of freedom of a variable.
    pub(crate) fn freedoms(&self, index: usize) -> Range<usize> {
        self.freedom[index] as usize..self.freedom[index + 1] as usize
    }

    /// Number of stored coordinates in all.
    pub(crate) fn coordinates(&self) -> usize {
        self.coordinate.last().map_or(0, |&end| end as usize)
    }

    /// Number of degrees of freedom in all.
    pub(crate) fn size(&self) -> usize {
        self.freedom.last().map_or(0, |&end| end as usize)
    }

    /// Whether every coordinate is real and free, so that moving is adding.
    pub(crate) fn is_flat(&self) -> bool {
        self.flat
    }

    fn push(&mut self, space: &Space) {
        if self.space_of.is_empty() {
            (self.coordinate, self.freedom, self.flat) = (vec![0], vec![0], true);
        }
        let known = self.spaces.iter().rposition(|other| other == space);
        let slot = known.unwrap_or_else(|| {
            self.spaces.push(space.clone());
            self.flat &= matches!(space, Space::Continuous(_)) && !space.has_angles();
            self.spaces.len() - 1
        });
        self.space_of.push(slot as u32);
        self.coordinate.push((self.coordinates() + space.dimension()) as u32);
        self.freedom.push((self.size() + space.degrees_of_freedom()) as u32);
    }
}

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

/// A prior pinned to a variable, as a factor: W (x - μ) with W'W the information.
#[derive(Clone, Debug)]
struct Pinned {
    variable: u32,
    mean: Vec<f64>,
    /// Upper triangular, row-major.
    whitening: Vec<f64>,
    log_peak: f64,
}

/// A graph to be solved jointly. Its factors are those of the graph, then one for every prior pinned to a variable.
pub struct Problem<'g> {
    source: &'g dyn Source,
    pub(crate) layout: Arc<Layout>,
    variables: Vec<VariableId>,
    factors: Vec<FactorId>,
    /// Variables of every factor, in compressed rows.
    port_pointer: Vec<u32>,
    port_variable: Vec<u32>,
    priors: Vec<Pinned>,
    starts: Vec<(u32, Vec<f64>)>,
    kernels: Vec<(String, Kernel)>,
    kernel_of: Vec<Kernel>,
}

impl<'g> Problem<'g> {
    /// Reads a graph of any Gaussian family; linear in its edges.
    ///
    /// # Errors
    ///
    /// Where a variable is finite, or a prior is no proper Gaussian.
    pub fn new<M: GaussianFamily, F: Factor<M>>(graph: &'g FactorGraph<M, F>) -> Result<Self, ExactError> {
        let mut problem = Self {
            source: graph,
            layout: Arc::default(),
            variables: graph.variable_ids().collect(),
            factors: graph.factor_ids().collect(),
            port_pointer: vec![0],
            port_variable: Vec::with_capacity(graph.edge_count()),
            priors: Vec::new(),
            starts: Vec::new(),
            kernels: Vec::new(),
            kernel_of: Vec::new(),
        };
        let mut layout = Layout::default();
        for variable in graph.variable_ids() {
            let space = graph.space(variable);
            if let Space::Finite(states) = *space {
                return Err(ExactError::Finite { variable: graph.variable_name(variable), states });
            }
            layout.push(space);
            if let Some(prior) = graph.prior(variable) {
                problem.priors.push(pinned(graph, variable, prior, space)?);
            }
            if let Some(mean) = graph.start(variable).and_then(|start| mean_of(start)) {
                problem.starts.push((variable.index() as u32, mean));
            }
        }
        for factor in graph.factor_ids() {
            problem.port_variable.extend(graph.ports(factor).map(|variable| variable.index() as u32));
            problem.port_pointer.push(problem.port_variable.len() as u32);
        }
        for prior in &problem.priors {
            problem.port_variable.push(prior.variable);
            problem.port_pointer.push(problem.port_variable.len() as u32);
        }
        problem.layout = Arc::new(layout);
        Ok(problem)
    }

    /// Judges the residuals of every factor of a kind (the name it was added by) by a robust kernel; those of heavy-tailed
    /// noise have their own.
    pub fn set_kernel(&mut self, kind: &str, kernel: Kernel) {
        self.kernels.push((kind.to_owned(), kernel));
        let of = |&factor: &FactorId| {
            let kind = self.source.factor_kind(factor);
            self.kernels
                .iter()
                .rev()
                .find(|(name, _)| name == kind)
                .map_or(Kernel::None, |(_, kernel)| *kernel)
        };
        self.kernel_of = self.factors.iter().map(of).collect();
    }

    /// The starts of the graph's beliefs, the means of its priors where there is none, else the origin.
    pub fn start(&self) -> Values {
        let mut values = Values::origin(self.layout.clone());
        for prior in &self.priors {
            values.numbers[self.layout.range(prior.variable as usize)].copy_from_slice(&prior.mean);
        }
        for (variable, mean) in &self.starts {
            values.numbers[self.layout.range(*variable as usize)].copy_from_slice(mean);
        }
        values
    }

    /// Number of variables.
    pub fn variable_count(&self) -> usize {
        self.layout.variables()
    }

    /// Number of factors, pinned priors included.
    pub fn factor_count(&self) -> usize {
        self.port_pointer.len() - 1
    }

    /// Number of degrees of freedom of all variables.
    pub fn degrees_of_freedom(&self) -> usize {
        self.layout.size()
    }

    /// The handles of all variables, in order.
    pub fn variables(&self) -> &[VariableId] {
        &self.variables
    }

    /// The space of a variable, by its number.
    pub(crate) fn space(&self, index: usize) -> &Space {
        self.layout.space(index)
    }

    /// A variable's name.
    pub fn variable_name(&self, index: usize) -> String {
        match self.variables.get(index) {
            Some(&variable) => self.source.variable_name(variable),
            None => format!("variable {index}"),
        }
    }

    /// A factor's name; a pinned prior is called by its variable.
    pub fn factor_name(&self, index: usize) -> String {
        match self.factors.get(index) {
            Some(&factor) => self.source.factor_name(factor),
            None => format!("the prior of {}", self.variable_name(self.ports(index)[0] as usize)),
        }
    }

    /// The variables at a factor's ports.
    pub(crate) fn ports(&self, factor: usize) -> &[u32] {
        &self.port_variable[self.port_pointer[factor] as usize..self.port_pointer[factor + 1] as usize]
    }

    pub(crate) fn port_count(&self) -> usize {
        self.port_variable.len()
    }

    /// A factor's residual, whitened and weighted, and, if asked, its derivative by local coordinates, into `out`.
    ///
    /// # Errors
    ///
    /// Where the factor has no residual, or a number is not finite.
    pub(crate) fn expand(
        &self,
        factor: usize,
        values: &Values,
        derivative: bool,
        out: &mut Expansion,
        chained: &mut Vec<f64>,
    ) -> Result<(), ExactError> {
        out.ask(derivative);
        for &variable in self.ports(factor) {
            out.point.extend_from_slice(&values.numbers[self.layout.range(variable as usize)]);
        }
        match self.factors.get(factor) {
            Some(&id) => self.ask(id, out)?,
            None => self.priors[factor - self.factors.len()]
                .expand(self.layout.space(self.ports(factor)[0] as usize), out),
        }
        if !out.loss.is_finite() {
            return Err(self.not_finite(factor, out));
        }
        if derivative && out.chart == Chart::Coordinates && !self.layout.flat {
            self.chain(factor, values, out, chained);
        }
        if let Some(kernel) = self.kernel_of.get(factor).filter(|kernel| **kernel != Kernel::None) {
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
    fn chain(&self, factor: usize, values: &Values, out: &mut Expansion, chained: &mut Vec<f64>) {
        let ports = self.ports(factor);
        let wide = out.point.len();
        let narrow: usize = ports.iter().map(|&v| self.layout.freedoms(v as usize).len()).sum();
        let rows = out.residual.len();
        chained.clear();
        chained.resize(rows * narrow, 0.0);
        let (mut from, mut to) = (0, 0);
        let mut steps = [0.0; 42];
        for &variable in ports {
            let (range, space) = (self.layout.range(variable as usize), self.layout.space(variable as usize));
            let (n, d) = (range.len(), space.degrees_of_freedom());
            let curved = matches!(space, Space::Se2 | Space::Se3)
                && space.step_derivative(&values.numbers[range], &mut steps[..n * d]);
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
        if found != expected || values.layout != self.layout {
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
            self.expand(factor, values, false, &mut question, &mut chained)?;
            sum += question.loss;
        }
        Ok(sum)
    }
}

impl Pinned {
    fn expand(&self, space: &Space, out: &mut Expansion) {
        let d = self.mean.len();
        let mut offset: Vec<f64> = out.point.iter().zip(&self.mean).map(|(x, mean)| x - mean).collect();
        space.wrap(&mut offset);
        out.residual.clear();
        out.residual.extend(self.whitening.chunks_exact(d).map(|row| dot(row, &offset)));
        out.loss = 0.5 * out.residual.iter().map(|r| r * r).sum::<f64>();
        out.log_peak = self.log_peak;
        out.chart = Chart::Coordinates;
        if out.derivative {
            out.jacobian.clear();
            out.jacobian.extend_from_slice(&self.whitening);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The mean of a message, where it has one.
fn mean_of<M: GaussianFamily>(message: &M) -> Option<Vec<f64>> {
    let d = message.dimension();
    let (mut information, mut vector) = (vec![0.0; d * d], vec![0.0; d]);
    message.read_information(&mut information, &mut vector).ok()?;
    Cholesky::new(&information, d, "the start").ok()?.solve(&mut vector);
    Some(vector)
}

/// A prior as a factor.
fn pinned<M: GaussianFamily, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    variable: VariableId,
    prior: &M,
    space: &Space,
) -> Result<Pinned, ExactError> {
    let named = |source| ExactError::Prior { variable: graph.variable_name(variable), source };
    let d = prior.dimension();
    if d != space.dimension() || *space == Space::Se3 {
        let reason =
            "a prior message suits real and angular coordinates; give a pose in space a PosePrior factor";
        return Err(named(sumprod_graph::MessageError::Unsupported(reason.into())));
    }
    let (mut information, mut mean) = (vec![0.0; d * d], vec![0.0; d]);
    prior.read_information(&mut information, &mut mean).map_err(named)?;
    let factor = Cholesky::new(&information, d, "its information").map_err(named)?;
    factor.solve(&mut mean);
    let mut whitening = vec![0.0; d * d];
    for column in 0..d {
        let mut unit = vec![0.0; d];
        unit[column] = 1.0;
        factor.multiply_lower(&unit, &mut whitening[column * d..][..d]);
    }
    let log_peak = 0.5 * (factor.log_determinant() - d as f64 * std::f64::consts::TAU.ln());
    Ok(Pinned { variable: variable.index() as u32, mean, whitening, log_peak })
}
