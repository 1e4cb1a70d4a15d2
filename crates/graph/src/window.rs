//! Time-sliced graphs: a window of the latest slices, from a filter to a fixed-lag smoother.
//!
//! A slice is the variables and factors of one time step. With a lag of one slice the window is a filter: when
//! the next slice begins, every belief of the last becomes its variable's prior and the factors that made it are
//! dropped. With a lag of L slices it is a fixed-lag smoother: what leaves the window sends its messages to what
//! stays one last time, and these are kept as priors. Nothing grows with time.

use crate::engine::State;
use crate::{
    Engine, Factor, FactorGraph, GraphError, Message, Messages, Options, Port, Purpose, Report, Schedule,
    Space, Stream, Topology, VariableId,
};
use std::collections::VecDeque;

/// Handle of a variable in a window; it stays valid until the variable's slice has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WindowVariable(u64);

struct Entry<M: Message> {
    name: String,
    space: Space,
    time: f64,
    prior: Option<M>,
    start: Option<M>,
    form: Option<M::Form>,
    belief: Option<M>,
    guessed: bool,
    /// Whether the belief lacks a prior that was set after it was computed.
    stale: bool,
}

struct Joint<M: Message, F> {
    name: String,
    factor: F,
    variables: Vec<WindowVariable>,
    forms: Vec<M::Form>,
    /// Messages of the last run, one per port; empty before the first.
    messages: Vec<M>,
}

/// A window over a time-sliced graph.
///
/// Slices begin in the order of time, at whatever times measurements come; variables may appear and disappear
/// from one slice to the next.
pub struct Window<M: Message, F> {
    lag: usize,
    options: Options,
    iteration: u64,
    first: u64,
    variables: VecDeque<Entry<M>>,
    factors: VecDeque<Joint<M, F>>,
    /// Number of variables and factors in each slice, oldest first.
    slices: VecDeque<(f64, usize, usize)>,
}

impl<M: Message, F: Factor<M>> Window<M, F> {
    /// A window of `lag` slices: 1 is a filter, more a fixed-lag smoother.
    ///
    /// # Errors
    ///
    /// Where `lag` is zero.
    pub fn new(lag: usize, options: Options) -> Result<Self, GraphError> {
        if lag == 0 {
            let expected = "a window holds at least one slice";
            return Err(GraphError::Option { what: "the window's lag", value: 0.0, expected });
        }
        Ok(Self {
            lag,
            options,
            iteration: 0,
            first: 0,
            variables: VecDeque::new(),
            factors: VecDeque::new(),
            slices: VecDeque::new(),
        })
    }

    /// Begins the slice at `time` (s), and lets the oldest leave where the window is full.
    ///
    /// # Errors
    ///
    /// Where `time` is not finite or not after the last slice's, where a factor would leave that no run has
    /// heard yet, or where messages that are to be kept as priors have no product.
    pub fn begin(&mut self, time: f64) -> Result<(), GraphError> {
        let last = self.slices.back().map_or(f64::NEG_INFINITY, |slice| slice.0);
        if !time.is_finite() || time <= last {
            let expected = "a slice's time must be finite and after the slice before it";
            return Err(GraphError::Option { what: "the slice's time", value: time, expected });
        }
        self.refuse_unheard()?;
        if self.lag == 1 {
            self.collapse()?;
        }
        // One slice more than the lag stays until the next begins: factors still reach back to it.
        while self.slices.len() > self.lag {
            self.retire()?;
        }
        self.slices.push_back((time, 0, 0));
        Ok(())
    }

    /// A factor that leaves before any run would leave no trace.
    fn refuse_unheard(&self) -> Result<(), GraphError> {
        let leaving = self.slices.len().saturating_sub(self.lag);
        let count: usize = self.slices.iter().take(leaving).map(|slice| slice.1).sum();
        let boundary = WindowVariable(self.first + count as u64);
        let leaves = |joint: &&Joint<M, F>| {
            self.lag == 1 || joint.variables.iter().any(|&variable| variable < boundary)
        };
        match self.factors.iter().filter(leaves).find(|joint| joint.messages.is_empty()) {
            Some(joint) => Err(GraphError::Schedule(format!(
                "factor {:?} was added after the last run and would leave the window unheard; run the window \
                 before beginning a slice",
                joint.name
            ))),
            None => Ok(()),
        }
    }

    /// A filter's close: beliefs become priors, and the factors that made them go. Where a belief is no
    /// product (a start still stands in for it, or a prior came later), the messages become the prior.
    fn collapse(&mut self) -> Result<(), GraphError> {
        for joint in std::mem::take(&mut self.factors) {
            for ((&variable, message), form) in joint.variables.iter().zip(joint.messages).zip(&joint.forms) {
                let entry = &self.variables[(variable.0 - self.first) as usize];
                if entry.guessed || entry.stale {
                    self.pin(variable, message, form)?;
                }
            }
        }
        for slice in &mut self.slices {
            slice.2 = 0;
        }
        for entry in self.variables.iter_mut().filter(|entry| !entry.guessed && !entry.stale) {
            if let Some(belief) = &entry.belief {
                entry.prior = Some(belief.clone());
                entry.start = None;
            }
        }
        Ok(())
    }

    /// Lets the oldest slice leave; its last messages to what stays are kept as priors.
    fn retire(&mut self) -> Result<(), GraphError> {
        let Some((_, leaving, _)) = self.slices.pop_front() else { return Ok(()) };
        let boundary = WindowVariable(self.first + leaving as u64);
        let mut kept = VecDeque::with_capacity(self.factors.len());
        for joint in std::mem::take(&mut self.factors) {
            if joint.variables.iter().all(|&variable| variable >= boundary) {
                kept.push_back(joint);
                continue;
            }
            for ((&variable, message), form) in joint.variables.iter().zip(joint.messages).zip(&joint.forms) {
                if variable >= boundary {
                    self.pin(variable, message, form)?;
                }
            }
        }
        self.factors = kept;
        self.variables.drain(..leaving);
        self.first = boundary.0;
        let counts = self.factors.iter().fold(vec![0; self.slices.len()], |mut counts, joint| {
            if let Some(newest) = joint.variables.iter().max() {
                counts[self.slice_of(*newest)] += 1;
            }
            counts
        });
        for (slice, count) in self.slices.iter_mut().zip(counts) {
            slice.2 = count;
        }
        Ok(())
    }

    fn slice_of(&self, variable: WindowVariable) -> usize {
        let mut position = (variable.0 - self.first) as usize;
        for (index, slice) in self.slices.iter().enumerate() {
            if position < slice.1 {
                return index;
            }
            position -= slice.1;
        }
        self.slices.len().saturating_sub(1)
    }

    fn pin(&mut self, variable: WindowVariable, message: M, form: &M::Form) -> Result<(), GraphError> {
        let index = (variable.0 - self.first) as usize;
        let entry = &mut self.variables[index];
        let Some(prior) = entry.prior.take() else {
            entry.prior = Some(message);
            return Ok(());
        };
        let mut stream = Stream::new(self.options.seed, self.iteration, Purpose::Extrinsic, variable.0);
        let pair = [prior, message];
        let product = M::product(Messages::new(&pair, &[0, 1]), form, &mut stream);
        entry.prior = Some(product.map_err(|source| GraphError::Product {
            variable: entry.name.clone(),
            iteration: self.iteration,
            source,
        })?);
        Ok(())
    }

    /// Adds a variable to the newest slice.
    ///
    /// # Errors
    ///
    /// Where no slice has begun.
    pub fn variable(&mut self, name: impl Into<String>, space: Space) -> Result<WindowVariable, GraphError> {
        let Some(slice) = self.slices.back_mut() else {
            return Err(GraphError::Schedule("begin a slice before adding variables to it".into()));
        };
        slice.1 += 1;
        let time = slice.0;
        self.variables.push_back(Entry {
            name: name.into(),
            space,
            time,
            prior: None,
            start: None,
            form: None,
            belief: None,
            guessed: false,
            stale: false,
        });
        Ok(WindowVariable(self.first + self.variables.len() as u64 - 1))
    }

    /// Adds a factor to the newest slice, with the form of each of its edges.
    ///
    /// # Errors
    ///
    /// Where a variable has left the window or was never in it.
    pub fn factor(
        &mut self,
        name: impl Into<String>,
        factor: F,
        edges: &[(WindowVariable, M::Form)],
    ) -> Result<(), GraphError> {
        for (variable, _) in edges {
            self.position(*variable)?;
        }
        if let Some(slice) = self.slices.back_mut() {
            slice.2 += 1;
        }
        let (variables, forms) = edges.iter().cloned().unzip();
        self.factors.push_back(Joint { name: name.into(), factor, variables, forms, messages: Vec::new() });
        Ok(())
    }

    /// Pins a message to a variable, as [`FactorGraph::set_prior`].
    ///
    /// # Errors
    ///
    /// Where the variable is not in the window.
    pub fn set_prior(&mut self, variable: WindowVariable, prior: M) -> Result<(), GraphError> {
        let position = self.position(variable)?;
        let entry = &mut self.variables[position];
        entry.prior = Some(prior);
        entry.stale = true;
        Ok(())
    }

    /// Gives a variable's belief a start, as [`FactorGraph::set_start`].
    ///
    /// # Errors
    ///
    /// Where the variable is not in the window.
    pub fn set_start(&mut self, variable: WindowVariable, start: M) -> Result<(), GraphError> {
        let position = self.position(variable)?;
        self.variables[position].start = Some(start);
        Ok(())
    }

    /// Chooses how a belief is held, as [`FactorGraph::set_belief_form`].
    ///
    /// # Errors
    ///
    /// Where the variable is not in the window.
    pub fn set_belief_form(&mut self, variable: WindowVariable, form: M::Form) -> Result<(), GraphError> {
        let position = self.position(variable)?;
        self.variables[position].form = Some(form);
        Ok(())
    }

    /// The belief of a variable after the last run; none before it.
    pub fn belief(&self, variable: WindowVariable) -> Option<&M> {
        let position = self.position(variable).ok()?;
        self.variables[position].belief.as_ref()
    }

    /// The messages that factors sent in the last run, each with its factor's name and the variable it went to;
    /// factors added since then have sent none.
    pub fn messages(&self) -> impl Iterator<Item = (&str, WindowVariable, &M)> {
        self.factors.iter().flat_map(|joint| {
            let sent = joint.variables.iter().zip(&joint.messages);
            sent.map(|(&variable, message)| (joint.name.as_str(), variable, message))
        })
    }

    /// Replaces a belief, for instance by a resampled one; with a lag of one slice it is what the next slice
    /// is predicted from.
    ///
    /// # Errors
    ///
    /// Where the variable is not in the window.
    pub fn set_belief(&mut self, variable: WindowVariable, belief: M) -> Result<(), GraphError> {
        let position = self.position(variable)?;
        let entry = &mut self.variables[position];
        (entry.belief, entry.guessed, entry.stale) = (Some(belief), false, false);
        Ok(())
    }

    /// The variables of a slice, counted back from the newest (zero).
    pub fn slice(&self, back: usize) -> Vec<WindowVariable> {
        let Some(index) = self.slices.len().checked_sub(back + 1) else { return Vec::new() };
        let before: usize = self.slices.iter().take(index).map(|slice| slice.1).sum();
        let start = self.first + before as u64;
        (start..start + self.slices[index].1 as u64).map(WindowVariable).collect()
    }

    /// Number of slices in the window, the one kept for prediction included.
    pub fn slice_count(&self) -> usize {
        self.slices.len()
    }

    fn position(&self, variable: WindowVariable) -> Result<usize, GraphError> {
        let position = variable.0.checked_sub(self.first).map(|position| position as usize);
        position.filter(|&position| position < self.variables.len()).ok_or(GraphError::Unknown {
            what: "window variable",
            index: variable.0 as usize,
            count: self.variables.len(),
        })
    }

    /// The window as a graph, its factors borrowed.
    ///
    /// # Errors
    ///
    /// Where a factor's ports and variables do not match, as [`FactorGraph::factor`].
    pub fn graph(&self) -> Result<FactorGraph<M, &F>, GraphError> {
        let mut graph = FactorGraph::new();
        for entry in &self.variables {
            let id = graph.unnamed_variable(entry.space.clone());
            let variable = &mut graph.variables[id.index()];
            variable.time = Some(entry.time);
            variable.prior = entry.prior.clone();
            variable.start = entry.start.clone();
            if let Some(form) = &entry.form {
                graph.set_belief_form(id, form.clone())?;
            }
        }
        for joint in &self.factors {
            let place = |variable: &WindowVariable| VariableId((variable.0 - self.first) as u32);
            let variables: Vec<VariableId> = joint.variables.iter().map(place).collect();
            let id = graph.factor(joint.name.clone(), &joint.factor, &variables)?;
            for (port, form) in joint.forms.iter().enumerate() {
                graph.set_edge_form(id, port as Port, form.clone())?;
            }
        }
        Ok(graph)
    }

    /// Runs a schedule on the window.
    ///
    /// # Errors
    ///
    /// As [`Engine::run`]; variables are called by their names.
    pub fn run(&mut self, schedule: &mut dyn Schedule) -> Result<Report, GraphError> {
        let names: Vec<String> = self.variables.iter().map(|entry| entry.name.clone()).collect();
        let named = |error: GraphError| rename(error, &names);
        let graph = self.graph().map_err(named)?;
        let topology = Topology::new(&graph);
        let mut state = State::new(&graph, &topology);
        state.iteration = self.iteration;
        let mut edge = 0;
        for joint in &self.factors {
            for message in &joint.messages {
                state.messages[edge] = message.clone();
                state.sent[edge] = true;
                edge += 1;
            }
            edge += joint.variables.len() - joint.messages.len();
        }
        for (position, entry) in self.variables.iter().enumerate() {
            if let Some(belief) = &entry.belief {
                state.beliefs[position] = belief.clone();
                state.guessed[position] = entry.guessed;
                state.stale[position] = entry.stale;
            }
        }
        let mut engine = Engine::with_state(&graph, topology, self.options, state).map_err(named)?;
        let report = engine.run(schedule).map_err(named)?;
        let state = engine.into_state();
        drop(graph);
        self.iteration = state.iteration;
        for ((entry, belief), guessed) in self.variables.iter_mut().zip(state.beliefs).zip(state.guessed) {
            (entry.belief, entry.guessed, entry.stale) = (Some(belief), guessed, false);
        }
        let mut messages = state.messages.into_iter();
        for joint in &mut self.factors {
            joint.messages = messages.by_ref().take(joint.variables.len()).collect();
        }
        Ok(report)
    }
}

/// Puts a window's names where its graph knows numbers only.
fn rename(error: GraphError, names: &[String]) -> GraphError {
    let look_up = |label: String| {
        let number = label.strip_prefix("variable ").and_then(|number| number.parse::<usize>().ok());
        number.and_then(|number| names.get(number).cloned()).unwrap_or(label)
    };
    match error {
        GraphError::Rule { factor, port, variable, iteration, source } => {
            GraphError::Rule { factor, port, variable: look_up(variable), iteration, source }
        }
        GraphError::Product { variable, iteration, source } => {
            GraphError::Product { variable: look_up(variable), iteration, source }
        }
        GraphError::PortDimension { factor, port, expected, variable, found } => {
            GraphError::PortDimension { factor, port, expected, variable: look_up(variable), found }
        }
        GraphError::Form { factor, port, variable, reason } => {
            GraphError::Form { factor, port, variable: look_up(variable), reason }
        }
        GraphError::Loop(nodes) => GraphError::Loop(nodes.into_iter().map(look_up).collect()),
        other => other,
    }
}
