//! libDAI's factor graphs: the number of factors, then by factor its number of variables, their labels, their numbers of
//! states, the number of entries listed, and a line `index value` for each, the first variable's state running fastest.

use super::tables::{TableFile, TableVariable, Words};
use crate::ExactError;
use std::collections::BTreeMap;

/// A variable by its label: its number of states, and the line that says so.
type Known = BTreeMap<u64, (usize, usize)>;

pub(super) fn read(file: &mut TableFile, words: &mut Words<'_>) -> Result<(), ExactError> {
    let factors = words.count("the number of factors")?;
    let mut known = Known::new();
    let mut blocks = Vec::new();
    for number in 0..factors {
        let block = block(words, number, &mut known)?;
        blocks.push(block);
    }
    let mut place = BTreeMap::new();
    for (&label, &(states, _)) in &known {
        place.insert(label, file.variables.len());
        file.variables.push(TableVariable { name: label.to_string(), states });
    }
    for Block { line, labels, cardinalities, values } in blocks {
        let variables = labels.iter().rev().filter_map(|label| place.get(label).copied()).collect();
        let cardinalities: Vec<usize> = cardinalities.into_iter().rev().collect();
        file.add(line, variables, &cardinalities, values)?;
    }
    Ok(())
}

struct Block {
    line: usize,
    labels: Vec<u64>,
    cardinalities: Vec<usize>,
    values: Vec<f64>,
}

fn block(words: &mut Words<'_>, number: usize, known: &mut Known) -> Result<Block, ExactError> {
    let count = words.width(number)?;
    let line = words.line;
    let mut labels: Vec<u64> = Vec::new();
    for _ in 0..count {
        let what = format!("a variable's label of factor {number}");
        let label = words.count(&what)? as u64;
        if labels.contains(&label) {
            return Err(words.error(format!("factor {number} names variable {label} twice")));
        }
        labels.push(label);
    }
    let mut cardinalities = Vec::with_capacity(labels.len());
    for &label in &labels {
        let states = words.states(&label.to_string())?;
        let (before, line) = *known.entry(label).or_insert((states, words.line));
        if before != states {
            return Err(words.error(format!(
                "variable {label} has {states} states here, but {before} on line {line}; they must be the same"
            )));
        }
        cardinalities.push(states);
    }
    let entries = words.entries(&cardinalities)?;
    let listed = words.count(&format!("the number of entries of factor {number}"))?;
    if listed > entries {
        return Err(words.error(format!(
            "factor {number} lists {listed} entries, but a table of {cardinalities:?} states has {entries}"
        )));
    }
    let mut values = vec![0.0; entries];
    let mut given = vec![false; entries];
    for _ in 0..listed {
        let index = words.count(&format!("an entry's index of factor {number}"))?;
        let Some(slot) = values.get_mut(index) else {
            return Err(words.error(format!(
                "entry {index} of factor {number} is none of its table, whose entries are 0 to {}",
                entries - 1
            )));
        };
        *slot = words.value(&format!("entry {index} of factor {number}"))?;
        if std::mem::replace(&mut given[index], true) {
            return Err(words.error(format!("entry {index} of factor {number} is given twice")));
        }
    }
    Ok(Block { line, labels, cardinalities, values })
}
