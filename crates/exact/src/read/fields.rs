//! Lines of blank-separated fields.

use super::GraphFile;
use crate::ExactError;
use std::path::Path;
use sumprod_messages::Cholesky;

/// The kinds of files that are lines of fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextKind {
    /// g2o.
    G2o,
    /// TORO.
    Toro,
    /// PyFG.
    PyFg,
}

/// Tells the kind of a file by its first elements, and where they leave it open by its name.
pub(super) fn kind(path: &Path, text: &str) -> Result<TextKind, ExactError> {
    let mut lines = (1..).zip(text.lines()).map(|(line, text)| (line, text.split_whitespace()));
    let first = lines.find_map(|(line, mut fields)| {
        let tag = fields.next()?;
        (!tag.starts_with('#')).then(|| (line, tag, fields.collect::<Vec<_>>()))
    });
    let Some((line, tag, fields)) = first else {
        return Err(ExactError::file(path, None, "is empty"));
    };
    if matches!(tag, "VERTEX2" | "EDGE2" | "VERTEX3" | "EDGE3" | "EQUIV") {
        return Ok(TextKind::Toro);
    }
    if !(tag.starts_with("VERTEX_") || tag.starts_with("EDGE_") || tag == "FIX") {
        let problem = format!(
            "starts with {tag:?}, which opens no element of g2o (VERTEX_SE2, EDGE_SE3:QUAT, …), TORO (VERTEX2, EDGE3, …) or PyFG"
        );
        return Err(ExactError::file(path, Some(line), problem));
    }
    let named = |field: &&str| field.starts_with(|c: char| c.is_ascii_alphabetic());
    let pyfg = fields.iter().take(3).any(named) || path.extension().is_some_and(|e| e == "pyfg");
    Ok(if pyfg { TextKind::PyFg } else { TextKind::G2o })
}

/// One line of a file, read field by field.
pub(super) struct Fields<'a> {
    path: &'a Path,
    pub(super) line: usize,
    pub(super) tag: &'a str,
    fields: Vec<&'a str>,
    next: usize,
}

/// The lines of a file that are neither blank nor comments.
pub(super) fn lines<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = Fields<'a>> {
    (1..).zip(text.lines()).filter_map(move |(line, text)| {
        let mut fields = text.split_whitespace();
        let tag = fields.next().filter(|tag| !tag.starts_with('#'))?;
        Some(Fields { path, line, tag, fields: fields.collect(), next: 0 })
    })
}

impl<'a> Fields<'a> {
    pub(super) fn error(&self, problem: impl Into<String>) -> ExactError {
        ExactError::file(self.path, Some(self.line), problem)
    }

    /// The next field as it stands.
    pub(super) fn word(&mut self, what: &str) -> Result<&'a str, ExactError> {
        let field = self.fields.get(self.next).copied();
        self.next += 1;
        field.ok_or_else(|| {
            self.error(format!("{} ends after {} fields; {what} is missing", self.tag, self.fields.len()))
        })
    }

    /// The next field as a finite number.
    pub(super) fn number(&mut self, what: &str) -> Result<f64, ExactError> {
        let word = self.word(what)?;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(number) => {
                Err(self.error(format!("field {} of {} ({what}) is {number}", self.next, self.tag)))
            }
            Err(_) => {
                Err(self
                    .error(format!("field {} of {} ({what}) is {word:?}, not a number", self.next, self.tag)))
            }
        }
    }

    /// Several numbers.
    pub(super) fn numbers(&mut self, names: &[&str]) -> Result<Vec<f64>, ExactError> {
        names.iter().map(|name| self.number(name)).collect()
    }

    /// Refuses fields that nothing reads.
    pub(super) fn end(&self) -> Result<(), ExactError> {
        match self.fields.get(self.next) {
            None => Ok(()),
            Some(extra) => {
                let (found, expected) = (self.fields.len(), self.next);
                Err(self.error(format!(
                    "{} has {found} fields, expected {expected}; the first beyond is {extra:?}",
                    self.tag
                )))
            }
        }
    }

    /// A symmetric matrix by its upper triangle, row by row; row-major.
    pub(super) fn triangle(&mut self, size: usize, what: &str) -> Result<Vec<f64>, ExactError> {
        let mut matrix = vec![0.0; size * size];
        for row in 0..size {
            for column in row..size {
                let entry = self.number(what)?;
                matrix[row * size + column] = entry;
                matrix[column * size + row] = entry;
            }
        }
        Ok(matrix)
    }

    /// The covariance of an information matrix.
    pub(super) fn inverted(&self, information: &[f64], size: usize) -> Result<Vec<f64>, ExactError> {
        let factor = Cholesky::new(information, size, "the information matrix")
            .map_err(|error| self.error(format!("{}: {error}", self.tag)))?;
        let mut covariance = vec![0.0; size * size];
        factor.inverse(&mut covariance);
        symmetrise(&mut covariance, size);
        Ok(covariance)
    }

    /// The variable of a name that the file has given.
    pub(super) fn known(&self, file: &GraphFile, name: &str) -> Result<usize, ExactError> {
        file.find(name)
            .ok_or_else(|| self.error(format!("{} refers to {name}, which no VERTEX line gives", self.tag)))
    }
}

fn symmetrise(matrix: &mut [f64], size: usize) {
    for row in 0..size {
        for column in 0..row {
            let mean = 0.5 * (matrix[row * size + column] + matrix[column * size + row]);
            (matrix[row * size + column], matrix[column * size + row]) = (mean, mean);
        }
    }
}

/// Names of the numbers of a pose, for messages.
pub(super) const PLANE: [&str; 3] = ["x", "y", "theta"];
pub(super) const SPACE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
