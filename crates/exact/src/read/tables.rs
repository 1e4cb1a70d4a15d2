//! Graphs of tables over finitely many states: libDAI's `.fg` files, and those of the UAI competitions.
//!
//! | kind | told by | table entries |
//! |---|---|---|
//! | `.fg` | a number first, and a name that ends in `.fg` | listed by index, the first variable running fastest; others are zero |
//! | UAI | `MARKOV` or `BAYES` | all of them, the last variable running fastest |
//!
//! A `#` opens a comment in `.fg` files. Every error names the file and the line, what was found and what was expected.

use super::{fg, uai};
use crate::ExactError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sumprod_graph::{FactorGraph, Space};
use sumprod_messages::Categorical;
use sumprod_models::discrete::{Table, TableError};

/// The most entries of all tables together: beyond it a file is more likely wrong than meant.
const LARGEST: usize = 1 << 27;
/// The most variables of one table.
const WIDEST: usize = 256;

/// A variable of finitely many states.
#[derive(Clone, Debug, PartialEq)]
pub struct TableVariable {
    /// Its label, as text.
    pub name: String,
    /// Number of its states.
    pub states: usize,
}

/// A factor given by a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableFactor {
    /// The line it begins on, from 1.
    pub line: usize,
    /// Numbers of its variables, port by port. Those of `.fg` files are in reverse, so that the last runs fastest.
    pub variables: Vec<usize>,
    /// Its values.
    pub table: Arc<Table>,
}

/// What a file of tables holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableFile {
    /// Where it was read.
    pub path: PathBuf,
    /// The variables: of `.fg` files by ascending label.
    pub variables: Vec<TableVariable>,
    /// The factors, in the order of the file.
    pub factors: Vec<TableFactor>,
    /// Logarithm of the product of all factors without variables.
    pub log_constant: f64,
}

impl TableFile {
    /// Whether a file of this name and text holds tables.
    pub fn recognises(path: &Path, text: &str) -> bool {
        let named = |name: &str| path.extension().is_some_and(|own| own.eq_ignore_ascii_case(name));
        let mut words = text.lines().filter(|line| !line.trim_start().starts_with('#'));
        let first = words.find_map(|line| line.split_whitespace().next()).unwrap_or_default();
        named("fg") || named("uai") || first == "MARKOV" || first == "BAYES"
    }

    /// Reads a file of either kind.
    ///
    /// # Errors
    ///
    /// Where the file cannot be read, or holds anything that cannot be used.
    pub fn read(path: &Path) -> Result<Self, ExactError> {
        Self::parse(path, &super::text(path)?)
    }

    /// Reads a file's text; `path` is for messages, and tells the kind where the text leaves it open.
    ///
    /// # Errors
    ///
    /// As [`TableFile::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ExactError> {
        let mut file = Self { path: path.to_path_buf(), ..Self::default() };
        let uai = path.extension().is_some_and(|own| own.eq_ignore_ascii_case("uai"));
        let mut words = Words::new(path, text);
        match words.peek() {
            None => return Err(ExactError::file(path, None, "is empty")),
            Some(first) if uai || first == "MARKOV" || first == "BAYES" => uai::read(&mut file, &mut words)?,
            Some(_) => fg::read(&mut file, &mut words)?,
        }
        words.end()?;
        if file.variables.is_empty() {
            return Err(ExactError::file(path, None, "holds no variable"));
        }
        Ok(file)
    }

    /// The graph of the file: one variable and one factor per entry of [`TableFile::variables`] and
    /// [`TableFile::factors`], in their order. [`TableFile::log_constant`] is left to the caller.
    ///
    /// # Errors
    ///
    /// Where a table does not fit its variables, which no file that was read leaves open.
    pub fn graph(&self) -> Result<FactorGraph<Categorical>, ExactError> {
        let mut graph = FactorGraph::<Categorical>::new();
        let mut handles = Vec::with_capacity(self.variables.len());
        for variable in &self.variables {
            handles.push(graph.variable(variable.name.clone(), Space::finite(variable.states))?);
        }
        for factor in &self.factors {
            let ports: Vec<_> = factor.variables.iter().map(|&number| handles[number]).collect();
            graph.factor("table", Box::new(factor.table.clone()), &ports)?;
        }
        Ok(graph)
    }

    /// Adds a factor, or its constant where it has no variable.
    pub(super) fn add(
        &mut self,
        line: usize,
        variables: Vec<usize>,
        cardinalities: &[usize],
        values: Vec<f64>,
    ) -> Result<(), ExactError> {
        if variables.is_empty() {
            let constant = values.first().copied().unwrap_or(0.0);
            if constant == 0.0 {
                return Err(ExactError::file(&self.path, Some(line), TableError::AllZero.to_string()));
            }
            self.log_constant += constant.ln();
            return Ok(());
        }
        let table = Table::new(cardinalities, values)
            .map_err(|error| ExactError::file(&self.path, Some(line), error.to_string()))?;
        self.factors.push(TableFactor { line, variables, table: Arc::new(table) });
        Ok(())
    }
}

/// The words of a text, with their lines.
pub(super) struct Words<'a> {
    path: &'a Path,
    words: std::iter::Peekable<Box<dyn Iterator<Item = (usize, &'a str)> + 'a>>,
    /// The line of the last word taken.
    pub(super) line: usize,
    /// Entries of all tables so far.
    entries: usize,
}

impl<'a> Words<'a> {
    fn new(path: &'a Path, text: &'a str) -> Self {
        let words = (1..).zip(text.lines()).flat_map(|(line, text)| {
            let said = text.split('#').next().unwrap_or_default();
            said.split_whitespace().map(move |word| (line, word))
        });
        let words: Box<dyn Iterator<Item = (usize, &'a str)>> = Box::new(words);
        Self { path, words: words.peekable(), line: 1, entries: 0 }
    }

    pub(super) fn error(&self, problem: impl Into<String>) -> ExactError {
        ExactError::file(self.path, Some(self.line), problem)
    }

    fn peek(&mut self) -> Option<&'a str> {
        self.words.peek().map(|(_, word)| *word)
    }

    /// The next word; `what` it should be.
    pub(super) fn word(&mut self, what: &str) -> Result<&'a str, ExactError> {
        match self.words.next() {
            Some((line, word)) => {
                self.line = line;
                Ok(word)
            }
            None => Err(self.error(format!("the file ends where {what} should follow"))),
        }
    }

    /// The next word as a whole number that is not negative.
    pub(super) fn count(&mut self, what: &str) -> Result<usize, ExactError> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.error(format!("{what} is {word:?}, expected a whole number from 0")))
    }

    /// The next word as the number of a variable's states.
    pub(super) fn states(&mut self, variable: &str) -> Result<usize, ExactError> {
        match self.count(&format!("the number of states of variable {variable}"))? {
            0 => Err(self.error(format!("variable {variable} has 0 states, expected at least 1"))),
            states => Ok(states),
        }
    }

    /// The next word as a table's entry.
    pub(super) fn value(&mut self, what: &str) -> Result<f64, ExactError> {
        let word = self.word(what)?;
        match word.parse::<f64>() {
            Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
            Ok(value) => {
                Err(self.error(format!("{what} is {value}; a value must be finite and not negative")))
            }
            Err(_) => Err(self.error(format!("{what} is {word:?}, not a number"))),
        }
    }

    /// The number of variables of a factor.
    pub(super) fn width(&mut self, factor: usize) -> Result<usize, ExactError> {
        match self.count(&format!("the number of variables of factor {factor}"))? {
            width if width > WIDEST => Err(self
                .error(format!("factor {factor} has {width} variables, but a table has at most {WIDEST}"))),
            width => Ok(width),
        }
    }

    /// The number of entries of a table, where all tables together are not too large.
    pub(super) fn entries(&mut self, cardinalities: &[usize]) -> Result<usize, ExactError> {
        let product = cardinalities.iter().try_fold(1_usize, |product, &states| product.checked_mul(states));
        let total = product.and_then(|entries| entries.checked_add(self.entries));
        match (product, total) {
            (Some(entries), Some(total)) if total <= LARGEST => {
                self.entries = total;
                Ok(entries)
            }
            _ => Err(self.error(format!(
                "with a table of {cardinalities:?} states the file has more than {LARGEST} entries, which is the \
                 most that is read"
            ))),
        }
    }

    fn end(&mut self) -> Result<(), ExactError> {
        match self.words.next() {
            None => Ok(()),
            Some((line, word)) => {
                self.line = line;
                Err(self
                    .error(format!("{word:?} follows after the last factor; expected the end of the file")))
            }
        }
    }
}
