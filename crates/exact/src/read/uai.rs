//! Files of the UAI competitions: `MARKOV` or `BAYES`, the number of variables, their numbers of states, the number of
//! factors, by factor its number of variables and which; then by factor its number of entries, and all of them, the last
//! variable's state running fastest.

use super::tables::{TableFile, TableVariable, Words};
use crate::ExactError;

pub(super) fn read(file: &mut TableFile, words: &mut Words<'_>) -> Result<(), ExactError> {
    let kind = words.word("MARKOV or BAYES")?;
    if kind != "MARKOV" && kind != "BAYES" {
        return Err(words.error(format!("starts with {kind:?}, expected MARKOV or BAYES")));
    }
    let variables = words.count("the number of variables")?;
    for number in 0..variables {
        let states = words.states(&number.to_string())?;
        file.variables.push(TableVariable { name: number.to_string(), states });
    }
    let factors = words.count("the number of factors")?;
    let mut scopes = Vec::new();
    for number in 0..factors {
        let count = words.width(number)?;
        let mut scope = Vec::new();
        for _ in 0..count {
            let variable = words.count(&format!("a variable of factor {number}"))?;
            if variable >= variables {
                return Err(words.error(format!(
                    "factor {number} names variable {variable}, but there are {variables}, counted from 0"
                )));
            }
            if scope.contains(&variable) {
                return Err(words.error(format!("factor {number} names variable {variable} twice")));
            }
            scope.push(variable);
        }
        scopes.push(scope);
    }
    for (number, scope) in scopes.into_iter().enumerate() {
        let cardinalities: Vec<usize> = scope.iter().map(|&number| file.variables[number].states).collect();
        let entries = words.entries(&cardinalities)?;
        let listed = words.count(&format!("the number of entries of factor {number}"))?;
        let line = words.line;
        if listed != entries {
            return Err(words.error(format!(
                "factor {number} has {listed} entries, but a table of {cardinalities:?} states has {entries}"
            )));
        }
        let mut values = Vec::with_capacity(entries);
        for index in 0..entries {
            values.push(words.value(&format!("entry {index} of factor {number}"))?);
        }
        file.add(line, scope, &cardinalities, values)?;
    }
    Ok(())
}
