//! Where the numbers of each variable lie.

use std::ops::Range;
use sumprod_graph::Space;

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

    /// Adds a variable of this space.
    pub(crate) fn push(&mut self, space: &Space) {
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
