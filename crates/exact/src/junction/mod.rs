//! Exact sums and maxima over variables of finitely many states, by a tree of cliques.
//!
//! Variables are eliminated one after the other, each time the one that joins the fewest neighbours that were not joined
//! (min-fill). A variable and its neighbours at that moment are a clique; the clique is the child of that of the neighbour
//! eliminated next. Messages over the neighbours go to the root and back (Lauritzen and Spiegelhalter 1988; Shafer and
//! Shenoy 1990), in the log domain throughout, so that neither zeros nor wide ranges need care.
//!
//! The order is found first, and with it the size of every clique: a graph that is too wide is refused before any table of
//! a clique is made.

mod combine;
mod order;

use crate::ExactError;
use combine::{Part, combine};
use order::eliminate;
use std::sync::Arc;
use sumprod_graph::{Factor, FactorGraph, FactorId, VariableId};
use sumprod_messages::CategoricalFamily;
use sumprod_messages::vector::{largest, log_sum};
use sumprod_models::discrete::{Table, Tabulation};

/// How large a tree may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JunctionOptions {
    /// The most entries of all cliques together; a solve needs at most twice as many numbers of eight bytes.
    pub most_entries: usize,
}

impl Default for JunctionOptions {
    /// 2²⁶ entries: 1 GiB.
    fn default() -> Self {
        Self { most_entries: 1 << 26 }
    }
}

/// A table or a prior message over some variables, by logarithms.
struct Potential {
    /// Numbers of the variables, the last running fastest.
    variables: Vec<usize>,
    values: Values,
}

enum Values {
    Table(Arc<Table>),
    Logs(Vec<f64>),
}

impl Potential {
    fn logs(&self) -> &[f64] {
        match &self.values {
            Values::Table(table) => table.logs(),
            Values::Logs(logs) => logs,
        }
    }

    fn peak(&self) -> f64 {
        match &self.values {
            Values::Table(table) => table.peak(),
            Values::Logs(_) => 0.0,
        }
    }
}

/// A variable and the neighbours it had when it was eliminated.
struct Clique {
    /// The neighbours, then the variable itself.
    variables: Vec<usize>,
    parent: Option<usize>,
    /// Potentials whose first variable to go is this clique's.
    potentials: Vec<usize>,
    children: Vec<usize>,
}

/// A graph of tables as a tree of cliques, ready to be solved.
pub struct JunctionTree {
    states: Vec<usize>,
    names: Vec<String>,
    potentials: Vec<Potential>,
    /// In the order of elimination: children before parents.
    cliques: Vec<Clique>,
    /// The first potentials are the factors'.
    factors: usize,
    entries: usize,
}

/// The exact answer of a graph of tables.
#[derive(Clone, Debug, PartialEq)]
pub struct JunctionAnswer {
    /// By variable, the probability of each state.
    pub marginals: Vec<Vec<f64>>,
    /// By factor, the probability of each joint state of its variables, in the order of its table.
    pub factor_marginals: Vec<Vec<f64>>,
    /// Logarithm of the sum over all states of the product of all factors and priors.
    pub log_evidence: f64,
}

/// The most probable state of a graph of tables.
#[derive(Clone, Debug, PartialEq)]
pub struct MostProbable {
    /// By variable, its state.
    pub states: Vec<usize>,
    /// Logarithm of the product of all factors and priors there.
    pub log_score: f64,
}

impl JunctionTree {
    /// Reads the tables and priors of a graph and finds the order of elimination; no clique is made yet.
    ///
    /// # Errors
    ///
    /// Where a variable is continuous, a factor has no table, or the cliques are too large: the error names the widest.
    pub fn new<M: CategoricalFamily, F: Factor<M>>(
        graph: &FactorGraph<M, F>,
        options: JunctionOptions,
    ) -> Result<Self, ExactError> {
        let names: Vec<String> = graph.variable_ids().map(|variable| graph.variable_name(variable)).collect();
        let mut states = Vec::with_capacity(names.len());
        for variable in graph.variable_ids() {
            match graph.space(variable) {
                sumprod_graph::Space::Finite(count) => states.push(*count),
                _ => return Err(ExactError::Continuous { variable: graph.variable_name(variable) }),
            }
        }
        let mut potentials = Vec::with_capacity(graph.factor_count());
        for factor in graph.factor_ids() {
            let table = tabulate(graph, factor, options)?;
            let variables: Vec<usize> = graph.ports(factor).map(VariableId::index).collect();
            if let Some(twice) =
                (1..variables.len()).find(|&port| variables[..port].contains(&variables[port]))
            {
                let (factor, variable) = (graph.factor_name(factor), &names[variables[twice]]);
                let problem =
                    format!("factor {factor:?} has variable {variable:?} at two ports; join it once");
                return Err(ExactError::Request(problem));
            }
            potentials.push(Potential { variables, values: Values::Table(Arc::new(table)) });
        }
        let factors = potentials.len();
        for variable in graph.variable_ids() {
            if let Some(prior) = graph.prior(variable) {
                let mut logs = vec![0.0; states[variable.index()]];
                prior.read_logs(&mut logs);
                potentials.push(Potential { variables: vec![variable.index()], values: Values::Logs(logs) });
            }
        }
        let scopes = potentials.iter().map(|potential| potential.variables.as_slice());
        let order = eliminate(&states, scopes, options.most_entries)
            .map_err(|wide| wide.explain(&names, options.most_entries))?;
        let mut place = vec![0; states.len()];
        for (at, (variable, _)) in order.cliques.iter().enumerate() {
            place[*variable] = at;
        }
        let mut cliques: Vec<Clique> = Vec::with_capacity(order.cliques.len());
        for (variable, mut neighbours) in order.cliques {
            let parent = neighbours.iter().map(|&neighbour| place[neighbour]).min();
            neighbours.sort_by_key(|&neighbour| std::cmp::Reverse(place[neighbour]));
            neighbours.push(variable);
            cliques.push(Clique {
                variables: neighbours,
                parent,
                potentials: Vec::new(),
                children: Vec::new(),
            });
        }
        for at in 0..cliques.len() {
            if let Some(parent) = cliques[at].parent {
                cliques[parent].children.push(at);
            }
        }
        for (number, potential) in potentials.iter().enumerate() {
            // A factor of variables of one state each lies in no clique of several.
            let first = potential
                .variables
                .iter()
                .map(|&v| place[v])
                .filter(|&at| states[cliques[at].variables[cliques[at].variables.len() - 1]] > 1);
            let at = first.min().unwrap_or_else(|| potential.variables.first().map_or(0, |&v| place[v]));
            cliques[at].potentials.push(number);
        }
        Ok(Self { states, names, potentials, cliques, factors, entries: order.entries })
    }

    /// Entries of all cliques together.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// The most variables that a clique has, less one: the width of the elimination order.
    pub fn width(&self) -> usize {
        self.cliques.iter().map(|clique| clique.variables.len()).max().unwrap_or(1) - 1
    }

    /// All marginals and the evidence.
    ///
    /// # Errors
    ///
    /// Where no joint state is possible.
    pub fn solve(&self) -> Result<JunctionAnswer, ExactError> {
        let (inward, log_evidence) = self.inward(log_sum)?;
        let mut outward: Vec<Option<Vec<f64>>> = vec![None; self.cliques.len()];
        let mut marginals = vec![Vec::new(); self.states.len()];
        let mut factor_marginals = vec![Vec::new(); self.factors];
        let (mut belief, mut others) = (Vec::new(), Vec::new());
        for at in (0..self.cliques.len()).rev() {
            let clique = &self.cliques[at];
            let from_parent = outward[at].take();
            self.belief(at, &inward, from_parent.as_deref(), None, &mut belief);
            let own = clique.variables.len() - 1;
            let logs = self.project(&belief, clique, &clique.variables[own..]);
            marginals[clique.variables[own]] = probabilities(&logs);
            for &number in &clique.potentials {
                if let Some(slot) = factor_marginals.get_mut(number) {
                    let logs = self.project(&belief, clique, &self.potentials[number].variables);
                    *slot = probabilities(&logs);
                }
            }
            for &child in &clique.children {
                let separator = separator(&self.cliques[child]);
                if inward[child].iter().all(|log| log.is_finite()) {
                    others.clone_from(&belief);
                    let sent = Part { variables: separator, logs: &inward[child] };
                    combine::divide(&self.states, &clique.variables, &sent, &mut others);
                } else {
                    // What the child ruled out cannot be divided out.
                    self.belief(at, &inward, from_parent.as_deref(), Some(child), &mut others);
                }
                let mut logs = self.project(&others, clique, separator);
                let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                logs.iter_mut().for_each(|log| *log -= largest);
                outward[child] = Some(logs);
            }
        }
        Ok(JunctionAnswer { marginals, factor_marginals, log_evidence })
    }

    /// A joint state of the largest product; of several the one with the least states in the order of elimination.
    ///
    /// # Errors
    ///
    /// Where no joint state is possible.
    pub fn most_probable(&self) -> Result<MostProbable, ExactError> {
        let (inward, log_score) = self.inward(largest)?;
        let mut states = vec![0; self.states.len()];
        let mut belief = Vec::new();
        for (at, clique) in self.cliques.iter().enumerate().rev() {
            self.belief(at, &inward, None, None, &mut belief);
            // The neighbours' states are known: they were eliminated later.
            let own = clique.variables[clique.variables.len() - 1];
            let separator = separator(clique);
            let row =
                separator.iter().fold(0, |row, &variable| row * self.states[variable] + states[variable]);
            let run = &belief[row * self.states[own]..(row + 1) * self.states[own]];
            let better = |best: usize, state: usize| if run[state] > run[best] { state } else { best };
            states[own] = (0..run.len()).fold(0, better);
        }
        Ok(MostProbable { states, log_score })
    }

    /// Messages from the leaves to the roots, each over a clique's neighbours with the largest entry zero, and the sum of
    /// everything.
    fn inward(&self, sum: fn(&[f64]) -> f64) -> Result<(Vec<Vec<f64>>, f64), ExactError> {
        let mut inward: Vec<Vec<f64>> = Vec::with_capacity(self.cliques.len());
        let mut total: f64 = self.potentials.iter().map(Potential::peak).sum();
        let mut belief = Vec::new();
        for (at, clique) in self.cliques.iter().enumerate() {
            self.belief(at, &inward, None, None, &mut belief);
            let own = clique.variables[clique.variables.len() - 1];
            let mut sent: Vec<f64> = belief.chunks_exact(self.states[own].max(1)).map(sum).collect();
            let largest = sent.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            if largest == f64::NEG_INFINITY {
                let names = clique.variables.iter().map(|&v| self.names[v].clone()).collect();
                return Err(ExactError::Impossible { variables: names });
            }
            sent.iter_mut().for_each(|log| *log -= largest);
            total += largest;
            inward.push(sent);
        }
        Ok((inward, total))
    }

    /// Logarithms of a clique's own potentials times the messages into it, without those of one child.
    fn belief(
        &self,
        at: usize,
        inward: &[Vec<f64>],
        from_parent: Option<&[f64]>,
        without: Option<usize>,
        out: &mut Vec<f64>,
    ) {
        let clique = &self.cliques[at];
        let own = clique.potentials.iter().map(|&number| {
            let potential = &self.potentials[number];
            Part { variables: &potential.variables, logs: potential.logs() }
        });
        let children = clique.children.iter().filter(|&&child| Some(child) != without);
        let children =
            children.map(|&child| Part { variables: separator(&self.cliques[child]), logs: &inward[child] });
        let parent = from_parent.map(|logs| Part { variables: separator(clique), logs });
        combine(&self.states, &clique.variables, own.chain(children).chain(parent), out);
    }

    /// The logarithm of the sum of a clique's entries over all variables but `onto`.
    fn project(&self, belief: &[f64], clique: &Clique, onto: &[usize]) -> Vec<f64> {
        combine::project(&self.states, &clique.variables, belief, onto)
    }
}

/// The variables that a clique shares with its parent.
fn separator(clique: &Clique) -> &[usize] {
    &clique.variables[..clique.variables.len() - 1]
}

fn tabulate<M: CategoricalFamily, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    factor: FactorId,
    options: JunctionOptions,
) -> Result<Table, ExactError> {
    let mut question = Tabulation::new(options.most_entries);
    if !graph.rules(factor).answer(&mut question) {
        return Err(ExactError::NoTable { factor: graph.factor_name(factor) });
    }
    question.table.ok_or_else(|| ExactError::TooWide {
        variables: graph.ports(factor).map(|variable| graph.variable_name(variable)).collect(),
        entries: question.entries.map_or(f64::INFINITY, |entries| entries as f64),
        most: options.most_entries,
    })
}

fn probabilities(logs: &[f64]) -> Vec<f64> {
    let total = log_sum(logs);
    logs.iter().map(|log| (log - total).exp()).collect()
}
