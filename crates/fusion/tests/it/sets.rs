use std::collections::BTreeSet;

use proptest::prelude::*;
use sumprod_fusion::expression::express;
use sumprod_fusion::{InformationSet, Item};

fn items() -> impl Strategy<Value = BTreeSet<(u32, u64)>> {
    prop::collection::btree_set((0_u32..3, 0_u64..6), 0..12)
}

fn set(items: &BTreeSet<(u32, u64)>) -> InformationSet {
    InformationSet::of(items.iter().map(|&(source, number)| Item::new(source, number)))
}

proptest! {
    #[test]
    fn sets_are_sets(a in items(), b in items()) {
        let (left, right) = (set(&a), set(&b));
        prop_assert_eq!(left.union(&right), set(&(&a | &b)));
        prop_assert_eq!(left.intersection(&right), set(&(&a & &b)));
        prop_assert_eq!(left.difference(&right), set(&(&a - &b)));
        prop_assert_eq!(left.is_subset(&right), a.is_subset(&b));
        prop_assert_eq!(left.is_disjoint(&right), a.is_disjoint(&b));
        prop_assert_eq!(left.len(), a.len() as u64);
        prop_assert_eq!(left.iter().map(|item| (item.source, item.number)).collect::<BTreeSet<_>>(), a.clone());
        let mut backwards = InformationSet::new();
        a.iter().rev().for_each(|&(source, number)| backwards.insert(Item::new(source, number)));
        prop_assert_eq!(backwards, left);
    }

    #[test]
    fn an_expression_adds_up_to_its_target(sets in prop::collection::vec(items(), 1..6), target in items()) {
        let at_hand: Vec<InformationSet> = sets.iter().map(set).collect();
        let references: Vec<&InformationSet> = at_hand.iter().collect();
        if let Some(terms) = express(&set(&target), &references) {
            for source in 0..3 {
                for number in 0..6 {
                    let count: i32 = terms
                        .iter()
                        .filter(|(k, _)| sets[*k].contains(&(source, number)))
                        .map(|(_, count)| count)
                        .sum();
                    prop_assert_eq!(count, i32::from(target.contains(&(source, number))));
                }
            }
        }
    }

    #[test]
    fn inclusion_and_exclusion_of_a_family_closed_under_intersection_always_succeeds(
        sets in prop::collection::vec(items(), 1..4)
    ) {
        let mut closed = sets.clone();
        for a in 0..closed.len() {
            for b in 0..closed.len() {
                let both = &closed[a] & &closed[b];
                closed.push(both);
            }
        }
        for own in &sets {
            let more: Vec<_> = closed.iter().map(|other| other & own).collect();
            closed.extend(more);
        }
        let at_hand: Vec<InformationSet> = closed.iter().map(set).collect();
        let references: Vec<&InformationSet> = at_hand.iter().collect();
        let all = sets.iter().fold(BTreeSet::new(), |all, set| &all | set);
        prop_assert!(express(&set(&all), &references).is_some());
    }
}

#[test]
fn sets_are_told_in_words() {
    let set = InformationSet::of([Item::PRIOR, Item::new(2, 0), Item::new(2, 1), Item::new(0, 5)]);
    assert_eq!(set.to_string(), "observation 5 of 0, observations 0 to 1 of 2, the prior");
    assert_eq!(InformationSet::new().to_string(), "nothing");
    assert_eq!(set.sources(), [0, 2]);
}
