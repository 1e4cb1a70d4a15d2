//! The order in which variables are eliminated, and the sizes it leads to.

use crate::ExactError;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// Cliques in the order of elimination: each variable with the neighbours it then has.
pub(super) struct Order {
    pub(super) cliques: Vec<(usize, Vec<usize>)>,
    pub(super) entries: usize,
}

/// A clique with which the tree is larger than allowed.
pub(super) struct Wide {
    variables: Vec<usize>,
    entries: f64,
}

impl Wide {
    pub(super) fn explain(self, names: &[String], most: usize) -> ExactError {
        let variables = self.variables.iter().map(|&variable| names[variable].clone()).collect();
        ExactError::TooWide { variables, entries: self.entries, most }
    }
}

/// Neighbours from which a variable cannot be eliminated at all: a clique of so many variables of two states and more has
/// more entries than can be counted.
const HOPELESS: usize = 60;

/// Eliminates the variable that joins the fewest pairs of neighbours, again and again; of several the one of the smallest
/// clique, then the first. Ends as soon as the cliques have more than `most` entries together.
pub(super) fn eliminate<'a>(
    states: &[usize],
    scopes: impl Iterator<Item = &'a [usize]>,
    most: usize,
) -> Result<Order, Wide> {
    let mut neighbours = vec![BTreeSet::new(); states.len()];
    for scope in scopes {
        for &a in scope.iter().filter(|&&a| states[a] > 1) {
            let others = scope.iter().filter(|&&b| b != a && states[b] > 1);
            neighbours[a].extend(others.copied());
        }
    }
    let mut graph = Graph { states, neighbours, gone: vec![false; states.len()] };
    let mut cost: Vec<Cost> = (0..states.len()).map(|variable| graph.cost(variable)).collect();
    let mut queue: BinaryHeap<Reverse<(Cost, usize)>> =
        cost.iter().enumerate().map(|(variable, &cost)| Reverse((cost, variable))).collect();
    let mut order = Order { cliques: Vec::with_capacity(states.len()), entries: 0 };
    let mut total = 0.0;
    while let Some(Reverse((known, variable))) = queue.pop() {
        // A variable whose cost has changed since is in the queue once more.
        if graph.gone[variable] || known != cost[variable] {
            continue;
        }
        let around: Vec<usize> = graph.neighbours[variable].iter().copied().collect();
        total += graph.entries(variable);
        if total > most as f64 {
            let mut variables = around;
            variables.push(variable);
            return Err(Wide { variables, entries: total });
        }
        order.entries = total as usize;
        for variable in graph.remove(variable, &around) {
            cost[variable] = graph.cost(variable);
            queue.push(Reverse((cost[variable], variable)));
        }
        order.cliques.push((variable, around));
    }
    Ok(order)
}

/// Pairs of neighbours to join, then the logarithm of the clique's entries in units of 2⁻¹⁶.
type Cost = (u64, u64);

struct Graph<'a> {
    states: &'a [usize],
    neighbours: Vec<BTreeSet<usize>>,
    gone: Vec<bool>,
}

impl Graph<'_> {
    fn entries(&self, variable: usize) -> f64 {
        let around = self.neighbours[variable].iter().map(|&other| self.states[other] as f64);
        self.states[variable] as f64 * around.product::<f64>()
    }

    fn cost(&self, variable: usize) -> Cost {
        let around = &self.neighbours[variable];
        if around.len() > HOPELESS {
            return (u64::MAX, around.len() as u64);
        }
        let mut missing = 0;
        for &a in around {
            let later = around.range(a + 1..);
            missing += later.filter(|&b| !self.neighbours[a].contains(b)).count() as u64;
        }
        (missing, (self.entries(variable).log2() * 65536.0) as u64)
    }

    /// Joins the neighbours and removes the variable; returns those whose cost has changed.
    fn remove(&mut self, variable: usize, around: &[usize]) -> BTreeSet<usize> {
        self.gone[variable] = true;
        let mut changed: BTreeSet<usize> = around.iter().copied().collect();
        for &a in around {
            self.neighbours[a].remove(&variable);
        }
        for (k, &a) in around.iter().enumerate() {
            for &b in &around[k + 1..] {
                if self.neighbours[a].insert(b) {
                    self.neighbours[b].insert(a);
                    // Those that know both have one pair less to join.
                    changed.extend(self.neighbours[a].intersection(&self.neighbours[b]));
                }
            }
        }
        changed
    }
}
