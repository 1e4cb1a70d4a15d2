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

/// A belief's set as a sum of other sets: which of those at hand, and how often; negative is divided out.
pub type Terms = Vec<(usize, i32)>;

/// Sets looked at before the search is given up: what people and programs make takes tens.
const ATTEMPTS: u32 = 20_000;

/// Writes `target` as a signed sum of sets at hand; none where they do not suffice. The empty set is the empty sum.
///
/// The sets inside the target are joined from the largest on, each corrected by what it shares with those before it. A
/// set at hand that equals the target is found in one pass; beyond that the work grows with the number of nested
/// overlaps, and ends after a fixed number of attempts.
pub fn express(target: &InformationSet, at_hand: &[&InformationSet]) -> Option<Terms> {
    let mut attempts = ATTEMPTS;
    let mut sum = BTreeMap::new();
    write(target, at_hand, 1, &mut sum, &mut attempts)?;
    Some(sum.into_iter().filter(|(_, count)| *count != 0).collect())
}

/// Adds `sign` times the target to `sum`.
fn write(
    target: &InformationSet,
    at_hand: &[&InformationSet],
    sign: i32,
    sum: &mut BTreeMap<usize, i32>,
    attempts: &mut u32,
) -> Option<()> {
    if target.is_empty() {
        return Some(());
    }
    if let Some(found) = at_hand.iter().position(|set| *set == target) {
        *sum.entry(found).or_default() += sign;
        return Some(());
    }
    let mut inside: Vec<usize> =
        (0..at_hand.len()).filter(|&k| !at_hand[k].is_empty() && at_hand[k].is_subset(target)).collect();
    inside.sort_by_key(|&k| Reverse(at_hand[k].len()));
    // A start that leads nowhere is left out.
    while !inside.is_empty() {
        if join(target, at_hand, &inside, sign, sum, attempts)? {
            return Some(());
        }
        inside.remove(0);
    }
    None
}

/// Joins the sets `inside` in their order, each without what it shares with those before it, and adds `sign` times the
/// join to `sum` where it is the target. None where the attempts are used up.
fn join(
    target: &InformationSet,
    at_hand: &[&InformationSet],
    inside: &[usize],
    sign: i32,
    sum: &mut BTreeMap<usize, i32>,
    attempts: &mut u32,
) -> Option<bool> {
    let mut covered = InformationSet::new();
    let mut joined = BTreeMap::<usize, i32>::new();
    for &k in inside {
        *attempts = attempts.checked_sub(1)?;
        if at_hand[k].is_subset(&covered) {
            continue;
        }
        let mut overlap = BTreeMap::new();
        if write(&covered.intersection(at_hand[k]), at_hand, -sign, &mut overlap, attempts).is_none() {
            continue;
        }
        *joined.entry(k).or_default() += sign;
        overlap.into_iter().for_each(|(other, count)| *joined.entry(other).or_default() += count);
        covered = covered.union(at_hand[k]);
        if covered == *target {
            joined.into_iter().for_each(|(other, count)| *sum.entry(other).or_default() += count);
            return Some(true);
        }
    }
    Some(false)
}
