//! A wanted set of information written by those at hand: inclusion and exclusion.
//!
//! log p(x | ∪ Aᵢ) = Σ_{S ≠ ∅} (-1)^{|S|+1} log p(x | ∩_{i ∈ S} Aᵢ) + constant,
//!
//! where each intersection is again a set at hand, or is written by some. With two sets it is the rule of removal:
//! p(x | A ∪ B) ∝ p(x | A) p(x | B) / p(x | A ∩ B).
//!
//! Source: Chong, Mori, "Graphical models for nonlinear distributed estimation" (2004).

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::InformationSet;

/// A set as a sum of others: which of those at hand, and how often; negative is divided out.
pub type Terms = Vec<(usize, i32)>;

/// Sets looked at before the search is given up: what people and programs make takes tens.
const ATTEMPTS: u32 = 20_000;
/// Overlaps of overlaps before the search is given up.
const DEPTH: u32 = 64;

/// Writes `target` as a signed sum of sets at hand; none where they do not suffice. The empty set is the empty sum.
///
/// The sets inside the target are joined from the largest on, each corrected by what it shares with those before it. A
/// set at hand that equals the target is found in one pass; beyond that the work grows with the number of nested
/// overlaps, and ends after a fixed number of attempts.
pub fn express(target: &InformationSet, at_hand: &[&InformationSet]) -> Option<Terms> {
    let mut search = Search { at_hand, attempts: ATTEMPTS };
    let mut sum = Sum::new();
    search.write(target, 1, DEPTH, &mut sum)?;
    Some(sum.into_iter().filter(|(_, count)| *count != 0).collect())
}

type Sum = BTreeMap<usize, i32>;

fn add(sum: &mut Sum, terms: Sum) {
    terms.into_iter().for_each(|(set, count)| *sum.entry(set).or_default() += count);
}

struct Search<'a> {
    at_hand: &'a [&'a InformationSet],
    attempts: u32,
}

impl Search<'_> {
    /// Adds `sign` times the target to `sum`.
    fn write(&mut self, target: &InformationSet, sign: i32, depth: u32, sum: &mut Sum) -> Option<()> {
        if target.is_empty() {
            return Some(());
        }
        if let Some(found) = self.at_hand.iter().position(|set| *set == target) {
            *sum.entry(found).or_default() += sign;
            return Some(());
        }
        let depth = depth.checked_sub(1)?;
        let within = |k: &usize| !self.at_hand[*k].is_empty() && self.at_hand[*k].is_subset(target);
        let mut inside: Vec<usize> = (0..self.at_hand.len()).filter(within).collect();
        inside.sort_by_key(|&k| Reverse(self.at_hand[k].len()));
        // A start that leads nowhere is left out.
        for start in 0..inside.len() {
            if let Some(joined) = self.join(target, &inside[start..], sign, depth) {
                add(sum, joined);
                return Some(());
            }
        }
        None
    }

    /// `sign` times the join of the sets `inside`, each without what it shares with those before it, where that is the
    /// target.
    fn join(&mut self, target: &InformationSet, inside: &[usize], sign: i32, depth: u32) -> Option<Sum> {
        let mut covered = InformationSet::new();
        let mut joined = Sum::new();
        for &k in inside {
            self.attempts = self.attempts.checked_sub(1)?;
            let next = self.at_hand[k];
            if next.is_subset(&covered) {
                continue;
            }
            let mut overlap = Sum::new();
            if self.write(&covered.intersection(next), -sign, depth, &mut overlap).is_none() {
                continue;
            }
            *joined.entry(k).or_default() += sign;
            add(&mut joined, overlap);
            covered = covered.union(next);
            if covered == *target {
                return Some(joined);
            }
        }
        None
    }
}
