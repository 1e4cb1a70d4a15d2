//! Sets of information: the observations, and the prior, that a belief is made of.
//!
//! Observations are conditionally independent given the state, so that log p(x | A) - log p(x) adds up over the
//! observations in A: it is a measure on sets, and whatever is done to beliefs is done to their sets. A set is held as
//! ranges of sequence numbers by source; a source whose every observation up to the n-th is held takes one range,
//! however large n is.

use std::fmt;

use smallvec::SmallVec;

/// One piece of information: an observation, or the common prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Item {
    /// Who observed.
    pub source: u32,
    /// Which of its observations, counted from zero.
    pub number: u64,
}

impl Item {
    /// The prior that all nodes of a network share.
    pub const PRIOR: Self = Self { source: u32::MAX, number: 0 };

    /// Observation `number` of `source`.
    pub fn new(source: u32, number: u64) -> Self {
        Self { source, number }
    }
}

impl fmt::Display for Item {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::PRIOR => f.write_str("the prior"),
            Self { source, number } => write!(f, "observation {number} of {source}"),
        }
    }
}

/// Observations `first` to `end` - 1 of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Range {
    source: u32,
    first: u64,
    end: u64,
}

/// A set of [`Item`]s. All operations are linear in the number of ranges.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct InformationSet {
    /// Ascending, disjoint, none touching the next of its source.
    ranges: SmallVec<[Range; 7]>,
}

impl InformationSet {
    /// Nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// The common prior alone.
    pub fn prior() -> Self {
        Self::of([Item::PRIOR])
    }

    /// These items.
    pub fn of(items: impl IntoIterator<Item = Item>) -> Self {
        let mut set = Self::new();
        items.into_iter().for_each(|item| set.insert(item));
        set
    }

    /// Adds one item.
    pub fn insert(&mut self, item: Item) {
        let Item { source, number } = item;
        // The usual case: the next observation of a source.
        if let Some(range) =
            self.ranges.iter_mut().find(|range| range.source == source && range.end == number)
        {
            range.end = number.saturating_add(1);
            self.merge_touching();
            return;
        }
        let single = Range { source, first: number, end: number.saturating_add(1) };
        *self = self.union(&Self { ranges: SmallVec::from_slice(&[single]) });
    }

    fn merge_touching(&mut self) {
        self.ranges.dedup_by(|next, range| {
            let touch = next.source == range.source && next.first <= range.end;
            if touch {
                range.end = range.end.max(next.end);
            }
            touch
        });
    }

    /// Whether there is nothing in it.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// Number of items.
    pub fn len(&self) -> u64 {
        self.ranges.iter().map(|range| range.end - range.first).sum()
    }

    /// Whether it holds an item.
    pub fn contains(&self, item: Item) -> bool {
        let holds =
            |range: &Range| range.source == item.source && (range.first..range.end).contains(&item.number);
        self.ranges.iter().any(holds)
    }

    /// Whether all of it is in `other`.
    pub fn is_subset(&self, other: &Self) -> bool {
        let mut outer = other.ranges.iter().peekable();
        self.ranges.iter().all(|range| {
            while outer.next_if(|o| (o.source, o.end) < (range.source, range.end)).is_some() {}
            outer.peek().is_some_and(|o| o.source == range.source && o.first <= range.first)
        })
    }

    /// Whether nothing is in both.
    pub fn is_disjoint(&self, other: &Self) -> bool {
        self.intersection(other).is_empty()
    }

    /// What is in either.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        let mut ranges = SmallVec::with_capacity(self.ranges.len().max(other.ranges.len()));
        let (mut a, mut b) = (self.ranges.iter().peekable(), other.ranges.iter().peekable());
        loop {
            let next = match (a.peek(), b.peek()) {
                (Some(left), Some(right)) if left <= right => a.next(),
                (Some(_), None) => a.next(),
                _ => b.next(),
            };
            match next {
                Some(range) => ranges.push(*range),
                None => break,
            }
        }
        let mut union = Self { ranges };
        union.merge_touching();
        union
    }

    /// What is in both.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Self {
        let mut ranges = SmallVec::new();
        let (mut a, mut b) = (self.ranges.iter().peekable(), other.ranges.iter().peekable());
        while let (Some(left), Some(right)) = (a.peek(), b.peek()) {
            if left.source == right.source {
                let (first, end) = (left.first.max(right.first), left.end.min(right.end));
                if first < end {
                    ranges.push(Range { source: left.source, first, end });
                }
            }
            if (left.source, left.end) <= (right.source, right.end) {
                a.next();
            } else {
                b.next();
            }
        }
        Self { ranges }
    }

    /// What is in this and not in `other`.
    #[must_use]
    pub fn difference(&self, other: &Self) -> Self {
        let mut ranges = SmallVec::new();
        for range in &self.ranges {
            let mut first = range.first;
            for taken in other.ranges.iter().filter(|taken| taken.source == range.source) {
                if taken.end <= first || taken.first >= range.end {
                    continue;
                }
                if taken.first > first {
                    ranges.push(Range { first, end: taken.first, ..*range });
                }
                first = taken.end;
            }
            if first < range.end {
                ranges.push(Range { first, ..*range });
            }
        }
        Self { ranges }
    }

    /// The items in order; as many as there are.
    pub fn iter(&self) -> impl Iterator<Item = Item> + '_ {
        self.ranges
            .iter()
            .flat_map(|range| (range.first..range.end).map(|number| Item { source: range.source, number }))
    }

    /// The sources of observations in it, ascending, without the prior.
    pub fn sources(&self) -> Vec<u32> {
        let mut sources: Vec<u32> = self.ranges.iter().map(|range| range.source).collect();
        sources.dedup();
        sources.retain(|&source| source != Item::PRIOR.source);
        sources
    }
}

impl fmt::Display for InformationSet {
    /// The first few ranges.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const SHOWN: usize = 4;
        if self.is_empty() {
            return f.write_str("nothing");
        }
        for (k, range) in self.ranges.iter().take(SHOWN).enumerate() {
            let comma = if k == 0 { "" } else { ", " };
            let item = Item { source: range.source, number: range.first };
            match range.end - range.first {
                1 => write!(f, "{comma}{item}")?,
                _ => {
                    write!(f, "{comma}observations {} to {} of {}", range.first, range.end - 1, range.source)?
                }
            }
        }
        match self.ranges.len().saturating_sub(SHOWN) {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}
