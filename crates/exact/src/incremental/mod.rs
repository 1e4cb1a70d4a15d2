//! Joint solves of a graph that grows: adding factors reuses what has not changed.
//!
//! What elimination leaves is kept as a tree of cliques. A new factor changes the cliques of its variables and those
//! between them and the root; only their variables are eliminated anew, from the factors among them and the messages of the
//! cliques that were cut off, whose insides stay as they are. Variables that have moved far from where their factors were
//! made linear are treated as if all their factors were new (Kaess, Johannsson, Roberts, Ila, Leonard and Dellaert 2012,
//! iSAM2). Variables that are forgotten are eliminated first and leave their message: a fixed lag.

mod eliminate;
mod forget;
mod quadratic;
mod tree;

use crate::kernel::Kernel;
use crate::shape::Shape;
use crate::{ExactError, Problem, Values, observability};
use eliminate::{Elimination, Stop, Turn};
use quadratic::Quadratic;
use sumprod_graph::{Factor, FactorGraph, VariableId};
use sumprod_messages::{GaussianFamily, Moments};
use sumprod_models::{Expansion, Manifold};
use tree::{NONE, Tree};

/// How a growing graph is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IncrementalOptions {
    /// The distance of a local coordinate (m or rad) from where its factors were made linear, beyond which they are made
    /// linear anew.
    pub relinearise_beyond: f64,
    /// The change of a step (m or rad) that is not passed on to the variables below.
    pub propagate_beyond: f64,
}

impl Default for IncrementalOptions {
    fn default() -> Self {
        Self { relinearise_beyond: 0.05, propagate_beyond: 1e-12 }
    }
}

/// What an update did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UpdateReport {
    /// Variables about which factors were made linear anew.
    pub relinearised: usize,
    /// Variables that were eliminated anew, those that are new included.
    pub eliminated: usize,
    /// Cliques that were taken over with all below them.
    pub reused: usize,
}

/// A factor of the tree, and where it comes from.
#[derive(Debug, Default)]
struct Piece {
    /// The factor's number in the problem; none of what forgotten variables left.
    factor: Option<Origin>,
    quadratic: Quadratic,
    /// Whether it must be made linear at the present points.
    dirty: bool,
}

#[derive(Clone, Copy, Debug)]
enum Origin {
    Factor(usize),
    Prior(usize),
}

/// The solution of a graph that grows.
///
/// ```
/// use sumprod_exact::Incremental;
/// use sumprod_graph::{FactorGraph, Space};
/// use sumprod_messages::DynamicGaussian;
/// use sumprod_models::library::LinearGaussian;
/// use sumprod_models::{AddModel, Noise};
///
/// let mut graph = FactorGraph::<DynamicGaussian>::new();
/// let mut smoother = Incremental::default();
/// let mut last = graph.variable("x0", Space::real(1))?;
/// graph.add("prior", LinearGaussian::new(&[&[1.0]], &[0.0], Noise::isotropic(1, 1.0)?)?, &[last])?;
/// for step in 1..100 {
///     let next = graph.variable(format!("x{step}"), Space::real(1))?;
///     let walk = LinearGaussian::new(&[&[-1.0], &[1.0]], &[1.0], Noise::isotropic(1, 0.1)?)?;
///     graph.add("walk", walk, &[last, next])?;
///     let report = smoother.update(&graph, &[])?;
///     assert!(report.eliminated <= 3);
///     last = next;
/// }
/// let answer = smoother.marginal(last)?;
/// assert!((answer.mean[0] - 99.0).abs() < 1e-9 && (answer.covariance[0] - 10.9).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Default)]
pub struct Incremental {
    options: IncrementalOptions,
    shape: Shape,
    /// Where factors were made linear, in stored coordinates.
    points: Vec<f64>,
    /// From there to the answer, in local coordinates.
    steps: Vec<f64>,
    pieces: Vec<Piece>,
    pieces_of: Vec<Vec<u32>>,
    forgotten: Vec<bool>,
    tree: Tree,
    /// Variables whose steps have changed since factors were last made linear.
    moved: Vec<u32>,
    /// Factors and priors that have a piece.
    known: (usize, usize),
    /// Whether an update failed midway, so that the next builds the tree from its pieces.
    broken: bool,
    /// Number of variables that have been eliminated at some time: the first ones.
    eliminated: u32,
    place: Vec<u32>,
}

/// The share of its own information that a pivot must keep to be trusted.
const SAFE_PIVOT: f64 = 1e-10;

impl Incremental {
    /// An empty graph's solution.
    pub fn new(options: IncrementalOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Judges the residuals of factors of a kind by a robust kernel: of those that come after.
    pub fn set_kernel(&mut self, kind: &str, kernel: Kernel) {
        self.shape.add_kernel(kind, kernel);
    }

    /// Takes in the variables and factors added to the graph since the last call, and solves again. `start` gives values of
    /// new variables, in stored coordinates; others start where [`Problem::start`] has them. Priors pinned to variables
    /// that were there before, and changes of factors, go unseen.
    ///
    /// Linear in what is new and what must be eliminated anew.
    ///
    /// # Errors
    ///
    /// Where a factor cannot be linearised, joins a variable that was forgotten, or a direction is free. What was added is
    /// kept: once the graph has the factors that were missing, the next update succeeds.
    pub fn update<M: GaussianFamily, F: Factor<M>>(
        &mut self,
        graph: &FactorGraph<M, F>,
        start: &[(VariableId, &[f64])],
    ) -> Result<UpdateReport, ExactError> {
        let far = self.options.relinearise_beyond;
        let moved = std::mem::take(&mut self.moved);
        let far: Vec<u32> = moved.into_iter().filter(|&variable| self.is_beyond(variable, far)).collect();
        self.with_problem(graph, |own, problem| {
            own.welcome(problem, start)?;
            own.solve(problem, far, &[])
        })
    }

    /// Makes all factors linear at the answer, and solves, until no step is longer than `tolerance` (m or rad): the minimum
    /// that a joint solve from here would find by Gauss-Newton.
    ///
    /// # Errors
    ///
    /// As [`Incremental::update`], and where `rounds` do not suffice.
    pub fn settle<M: GaussianFamily, F: Factor<M>>(
        &mut self,
        graph: &FactorGraph<M, F>,
        tolerance: f64,
        rounds: usize,
    ) -> Result<(), ExactError> {
        for _ in 0..rounds {
            let all = 0..self.forgotten.len() as u32;
            let far: Vec<u32> = all.filter(|&variable| self.is_beyond(variable, tolerance)).collect();
            if far.is_empty() && !self.broken && self.shape.factors.len() == graph.factor_count() {
                return Ok(());
            }
            self.moved.clear();
            self.with_problem(graph, |own, problem| {
                own.welcome(problem, &[])?;
                own.solve(problem, far, &[])
            })?;
        }
        let longest = self.steps.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        if longest <= tolerance {
            return Ok(());
        }
        Err(ExactError::Request(format!(
            "the longest step is {longest:.1e} after {rounds} rounds, over the tolerance of {tolerance:.1e}; allow more"
        )))
    }

    /// The answer's values; of forgotten variables their last.
    pub fn values(&self) -> Values {
        let values = Values { layout: self.shape.layout.clone(), numbers: self.points.clone() };
        values.retracted(&self.steps)
    }

    /// Value (stored coordinates) and covariance (local coordinates, row-major) of one variable, by the cliques between it
    /// and the root.
    ///
    /// # Errors
    ///
    /// Where the handle is of another graph, or the variable not solved for yet or forgotten.
    pub fn marginal(&self, variable: VariableId) -> Result<Moments, ExactError> {
        let index = self.solved(variable)?;
        let covariance = self.tree.covariance(&self.shape.layout, index as u32);
        Ok(Moments { mean: self.value(variable)?, covariance })
    }

    /// The value of one variable, in stored coordinates; of a forgotten one its last.
    ///
    /// # Errors
    ///
    /// Where the handle is of another graph, or the variable not solved for yet.
    pub fn value(&self, variable: VariableId) -> Result<Vec<f64>, ExactError> {
        let index = variable.index();
        if !self.forgotten.get(index).is_some_and(|&forgotten| forgotten) {
            self.solved(variable)?;
        }
        let layout = &self.shape.layout;
        let mut value = self.points[layout.range(index)].to_vec();
        layout.space(index).retract(&mut value, &self.steps[layout.freedoms(index)]);
        Ok(value)
    }

    /// The number of a variable that the tree holds.
    fn solved(&self, variable: VariableId) -> Result<usize, ExactError> {
        let (index, count) = (variable.index(), self.forgotten.len());
        let reason = match self.tree.clique_of.get(index) {
            None => format!("there is no variable {index}; {count} have been solved for"),
            Some(_) if self.forgotten[index] => format!("variable {index} was forgotten"),
            Some(&clique) if clique == NONE => format!("variable {index} has not been solved for"),
            Some(_) => return Ok(index),
        };
        Err(ExactError::Request(reason))
    }

    fn is_beyond(&self, variable: u32, far: f64) -> bool {
        let own = self.steps.get(self.shape.layout.freedoms(variable as usize)).unwrap_or_default();
        !self.forgotten[variable as usize] && own.iter().any(|x| x.abs() > far)
    }

    /// Does something with the grown problem, and remembers whether it failed midway.
    fn with_problem<M: GaussianFamily, F: Factor<M>, T>(
        &mut self,
        graph: &FactorGraph<M, F>,
        work: impl FnOnce(&mut Self, &Problem<'_>) -> Result<T, ExactError>,
    ) -> Result<T, ExactError> {
        let (variables, factors) = (graph.variable_count(), graph.factor_count());
        if variables < self.shape.variables.len() || factors < self.shape.factors.len() {
            let reason = format!(
                "the graph has {variables} variables and {factors} factors, fewer than were solved for; it is another graph"
            );
            return Err(ExactError::Request(reason));
        }
        let problem = Problem::grown(&mut self.shape, graph)?;
        // The layout is asked of the shape throughout, which the problem has borrowed.
        self.shape.layout = problem.shape.layout.clone();
        let result = work(self, &problem);
        self.broken = result.is_err();
        let Problem { shape, .. } = problem;
        self.shape = shape;
        result
    }

    /// Makes room for new variables and factors.
    fn welcome(&mut self, problem: &Problem<'_>, start: &[(VariableId, &[f64])]) -> Result<(), ExactError> {
        let (before, count) = (self.forgotten.len(), problem.variable_count());
        let layout = problem.layout();
        self.points.extend_from_slice(&problem.shape.start[self.points.len()..]);
        self.steps.resize(layout.size(), 0.0);
        self.pieces_of.resize_with(count, Vec::new);
        self.forgotten.resize(count, false);
        self.tree.grow(count);
        for factor in self.known.0..problem.shape.factors.len() {
            self.piece(Some(Origin::Factor(factor)), problem.ports(factor).to_vec());
        }
        for prior in self.known.1..problem.shape.priors.len() {
            self.piece(Some(Origin::Prior(prior)), vec![problem.shape.priors[prior].variable]);
        }
        self.known = (problem.shape.factors.len(), problem.shape.priors.len());
        if start.is_empty() {
            return Ok(());
        }
        let mut given =
            Values { layout: problem.shape.layout.clone(), numbers: std::mem::take(&mut self.points) };
        let mut set = |&(variable, value): &(VariableId, &[f64])| {
            let index = variable.index();
            if index < before && self.tree.clique_of[index] != NONE {
                let name = problem.variable_name(index);
                let reason = format!("variable {name} was solved for before; a start is for new variables");
                return Err(ExactError::Request(reason));
            }
            given.set(variable, value)
        };
        let result = start.iter().try_for_each(&mut set);
        self.points = given.numbers;
        result
    }

    fn piece(&mut self, factor: Option<Origin>, variables: Vec<u32>) {
        let number = self.pieces.len() as u32;
        for &variable in &variables {
            let list = &mut self.pieces_of[variable as usize];
            if list.last() != Some(&number) {
                list.push(number);
            }
        }
        let quadratic = Quadratic { variables, ..Quadratic::default() };
        self.pieces.push(Piece { dirty: factor.is_some(), factor, quadratic });
    }

    /// Eliminates what has changed, and substitutes back.
    fn solve(
        &mut self,
        problem: &Problem<'_>,
        far: Vec<u32>,
        leaving: &[u32],
    ) -> Result<UpdateReport, ExactError> {
        let layout = problem.layout();
        let count = self.forgotten.len() as u32;
        let mut cliques = Vec::new();
        let mut dirty: Vec<u32> = Vec::new();
        // New pieces stand last.
        let fresh = self.pieces.iter().rposition(|piece| !piece.dirty).map_or(0, |place| place + 1);
        dirty.extend(fresh as u32..self.pieces.len() as u32);
        let touched = |own: &Self, pieces: &[u32]| -> Vec<u32> {
            let mut all: Vec<u32> =
                pieces.iter().flat_map(|&p| own.pieces[p as usize].quadratic.variables.clone()).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        let newest = touched(self, &dirty);
        for &variable in &far {
            self.tree.holding(variable, &mut cliques);
            self.move_point(problem, variable, &mut dirty);
        }
        for &variable in leaving {
            self.tree.holding(variable, &mut cliques);
        }
        if self.broken {
            // Whatever the last update left undone is done here.
            dirty =
                (0..self.pieces.len() as u32).filter(|&p| self.pieces[p as usize].factor.is_some()).collect();
        }
        dirty.sort_unstable();
        dirty.dedup();
        self.linearise(problem, &dirty)?;
        let in_tree = |&variable: &u32| self.tree.clique_of[variable as usize];
        cliques.extend(touched(self, &dirty).iter().map(in_tree));
        if self.broken {
            cliques.extend((0..count).map(|variable| self.tree.clique_of[variable as usize]));
        }
        let mut cut = self.tree.cut(&cliques);
        let waits = |&variable: &u32| {
            self.tree.clique_of[variable as usize] == NONE && !self.forgotten[variable as usize]
        };
        let unseen = if self.broken { 0 } else { self.eliminated };
        cut.variables.extend((unseen..count).filter(waits));
        cut.variables.sort_unstable();
        cut.variables.dedup();
        let made = self.eliminate(problem, &cut, &newest, leaving)?;
        self.eliminated = count;
        for &variable in &cut.variables {
            self.moved.push(variable);
        }
        let roots = made.iter().copied().filter(|&index| self.tree.clique(index).parent == NONE).collect();
        let least = self.options.propagate_beyond;
        self.tree.substitute(layout, roots, least, &mut self.steps, &mut self.moved);
        let own = |&variable: &u32| &self.steps[layout.freedoms(variable as usize)];
        if let Some(&value) = self.moved.iter().flat_map(own).find(|x| !x.is_finite()) {
            let remedy = "bring the factors' variances closer together";
            return Err(ExactError::NotFinite { what: "a step of the solve".into(), value, remedy });
        }
        self.moved.sort_unstable();
        self.moved.dedup();
        let (relinearised, eliminated) = (far.len(), cut.variables.len());
        Ok(UpdateReport { relinearised, eliminated, reused: cut.orphans.len() })
    }

    /// Moves a variable's point to the answer.
    fn move_point(&mut self, problem: &Problem<'_>, variable: u32, dirty: &mut Vec<u32>) {
        let (layout, index) = (problem.layout(), variable as usize);
        let step = self.steps[layout.freedoms(index)].to_vec();
        layout.space(index).retract(&mut self.points[layout.range(index)], &step);
        self.steps[layout.freedoms(index)].fill(0.0);
        for &piece in &self.pieces_of[index] {
            let piece_of = &mut self.pieces[piece as usize];
            match piece_of.factor {
                Some(_) => {
                    piece_of.dirty = true;
                    dirty.push(piece);
                }
                None => piece_of.quadratic.shift(layout, variable, &step),
            }
        }
    }

    fn linearise(&mut self, problem: &Problem<'_>, dirty: &[u32]) -> Result<(), ExactError> {
        let (mut question, mut chained) = (Expansion::default(), Vec::new());
        for &number in dirty {
            let piece = &mut self.pieces[number as usize];
            let factor = match piece.factor {
                Some(Origin::Factor(factor)) => factor,
                Some(Origin::Prior(prior)) => problem.shape.factors.len() + prior,
                None => continue,
            };
            if let Some(&gone) =
                piece.quadratic.variables.iter().find(|&&variable| self.forgotten[variable as usize])
            {
                let (factor, variable) = (problem.factor_name(factor), problem.variable_name(gone as usize));
                let reason = format!("factor {factor:?} joins variable {variable}, which was forgotten");
                return Err(ExactError::Request(reason));
            }
            problem.expand(factor, &self.points, true, &mut question, &mut chained)?;
            piece.quadratic.linearise(&question);
            piece.dirty = false;
        }
        Ok(())
    }

    /// Eliminates the variables of a cut.
    fn eliminate(
        &mut self,
        problem: &Problem<'_>,
        cut: &tree::Cut,
        newest: &[u32],
        leaving: &[u32],
    ) -> Result<Vec<u32>, ExactError> {
        if cut.variables.is_empty() {
            return Ok(Vec::new());
        }
        let some = newest.len() < cut.variables.len();
        let turn = |variable: &u32| match variable {
            variable if leaving.contains(variable) => Turn::First,
            variable if some && newest.binary_search(variable).is_ok() => Turn::Last,
            _ => Turn::Any,
        };
        let inside = |variable: &u32| cut.variables.binary_search(variable).is_ok();
        let mut pieces: Vec<u32> = cut
            .variables
            .iter()
            .flat_map(|&variable| self.pieces_of[variable as usize].iter().copied())
            .collect();
        pieces.sort_unstable();
        pieces.dedup();
        pieces.retain(|&piece| self.pieces[piece as usize].quadratic.variables.iter().all(inside));
        let elimination = Elimination {
            layout: problem.layout(),
            variables: cut.variables.iter().map(|variable| (*variable, turn(variable))).collect(),
            factors: pieces.iter().map(|&piece| &self.pieces[piece as usize].quadratic).collect(),
            orphans: &cut.orphans,
        };
        let made = elimination.run(&mut self.tree, &mut self.place).map_err(|stop| match stop {
            Stop::Error(error) => error,
            Stop::Pivot(variable) => {
                let values = Values { layout: problem.shape.layout.clone(), numbers: self.points.clone() };
                observability::explain(problem, &values, variable as usize)
            }
        })?;
        self.refuse_free_directions(problem, &made)?;
        Ok(made)
    }

    /// A pivot that all but vanishes may be rounding where an exact zero should be.
    fn refuse_free_directions(&self, problem: &Problem<'_>, made: &[u32]) -> Result<(), ExactError> {
        let layout = problem.layout();
        let mut own = Vec::new();
        for &index in made {
            let clique = self.tree.clique(index);
            let rows = clique.factor.len() / clique.right.len().max(1);
            let mut row = 0;
            for &variable in &clique.own {
                own.clear();
                own.resize(layout.freedoms(variable as usize).len(), 0.0);
                for &piece in &self.pieces_of[variable as usize] {
                    self.pieces[piece as usize].quadratic.add_diagonal(layout, variable, &mut own);
                }
                for information in &own {
                    let pivot = clique.factor[row * (rows + 1)];
                    if pivot * pivot < SAFE_PIVOT * information {
                        let numbers = self.points.clone();
                        let values = Values { layout: problem.shape.layout.clone(), numbers };
                        let free = observability::free_directions(problem, &values)?;
                        return if free.is_empty() { Ok(()) } else { Err(ExactError::Unobservable(free)) };
                    }
                    row += 1;
                }
            }
        }
        Ok(())
    }
}
