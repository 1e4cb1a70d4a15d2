//! How the program fails: one sentence, an exit status, and where there is one the place in the scenario file.

use std::fmt;
use std::io::IsTerminal;
use std::ops::Range;
use std::process::ExitCode;

use miette::{Diagnostic, GraphicalReportHandler, LabeledSpan, NamedSource, SourceCode};
use sumprod_positioning::PositioningError;

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    status: u8,
    sentence: String,
    /// Boxed, since most failures have none.
    place: Option<Box<Place>>,
}

#[derive(Debug)]
struct Place {
    source: NamedSource<String>,
    span: Range<usize>,
}

impl Failure {
    /// The input is wrong: exit status 2.
    pub fn input(sentence: impl Into<String>) -> Self {
        Self { status: 2, sentence: sentence.into(), place: None }
    }

    /// Something failed while running: exit status 1.
    pub fn running(sentence: impl Into<String>) -> Self {
        Self { status: 1, sentence: sentence.into(), place: None }
    }

    /// Shows `span` (bytes) of the file `name` below the sentence.
    pub fn at(mut self, name: &str, text: &str, span: Range<usize>) -> Self {
        self.place = Some(Box::new(Place { source: NamedSource::new(name, text.to_owned()), span }));
        self
    }

    /// The sentence.
    #[cfg(test)]
    pub fn sentence(&self) -> &str {
        &self.sentence
    }

    /// The exit status.
    #[cfg(test)]
    pub fn status(&self) -> u8 {
        self.status
    }

    /// Prints the failure to standard error: the sentence on one line, and the place in the file on a terminal.
    pub fn report(&self) -> ExitCode {
        eprintln!("error: {}", self.sentence);
        if self.place.is_some() && std::io::stderr().is_terminal() {
            let mut drawing = String::new();
            let excerpt = Excerpt(self);
            if GraphicalReportHandler::new().render_report(&mut drawing, &excerpt).is_ok() {
                eprint!("{drawing}");
            }
        }
        ExitCode::from(self.status)
    }
}

impl From<PositioningError> for Failure {
    fn from(error: PositioningError) -> Self {
        let sentence = error.to_string();
        if error.is_input() { Self::input(sentence) } else { Self::running(sentence) }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)
    }
}

/// The place of a failure as miette draws it; the sentence has already been printed.
#[derive(Debug)]
struct Excerpt<'a>(&'a Failure);

impl fmt::Display for Excerpt<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("in the scenario file")
    }
}

impl std::error::Error for Excerpt<'_> {}

impl Diagnostic for Excerpt<'_> {
    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.0.place.as_ref().map(|place| &place.source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.0.place.as_ref()?;
        let span = LabeledSpan::new_with_span(Some("here".into()), place.span.clone());
        Some(Box::new(std::iter::once(span)))
    }
}
