//! `sumprod check`: reads a scenario as `run` would, and describes its graphs.

use sumprod_positioning::scenario::{GraphSummary, Scenario};

use crate::args::{CheckArguments, ScenarioArguments};
use crate::document::Document;
use crate::failure::Failure;
use crate::print::print;
use crate::setup::{self, Setup};
use crate::systems::{Action, dispatch};

struct Check<'a>(&'a ScenarioArguments);

impl Action for Check<'_> {
    type Output = Vec<GraphSummary>;

    fn on<S: Scenario>(self, document: &Document) -> Result<Self::Output, Failure> {
        let setup = Setup::<S>::new(document, self.0)?;
        setup
            .scenario
            .check(&setup.prepared, setup.settings.seed, &setup.methods)
            .map_err(|error| document.explain(error))
    }
}

/// Prints the summary of each method's graph; directions that nothing constrains make the scenario a wrong input.
pub fn execute(arguments: &CheckArguments) -> Result<(), Failure> {
    let document = setup::document(&arguments.scenario, &[])?;
    let summaries = dispatch(&document, Check(&arguments.scenario))?;
    for summary in &summaries {
        print(&described(summary))?;
    }
    match summaries.iter().find_map(|summary| summary.unconstrained.first()) {
        None => Ok(()),
        Some(sentence) => Err(Failure::input(sentence.clone())),
    }
}

fn described(summary: &GraphSummary) -> String {
    let count = |n: usize, one: &str, many: &str| format!("{n} {}", if n == 1 { one } else { many });
    let mut text = format!(
        "{} ({}): {}, {}, {}, {}, {}\n",
        summary.method,
        summary.extent,
        count(summary.variables, "variable", "variables"),
        count(summary.factors, "factor", "factors"),
        count(summary.edges, "edge", "edges"),
        count(summary.components, "component", "components"),
        match summary.loops {
            0 => "no loop".to_owned(),
            n => count(n, "loop", "loops"),
        },
    );
    for form in &summary.forms {
        let edges = count(form.edges, "edge", "edges");
        text.push_str(&format!("  form.{} = {} on {edges}\n", form.kind, form.form));
    }
    for sentence in &summary.unconstrained {
        text.push_str(&format!("  warning: {sentence}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_graph_is_described_in_words() {
        let arguments = ScenarioArguments { scenario: "walk".into(), ..ScenarioArguments::default() };
        let document = setup::document(&arguments, &[]).unwrap();
        let summaries = dispatch(&document, Check(&arguments)).unwrap();
        let expected = "\
kf (one slice): 2 variables, 4 factors, 4 edges, 2 components, no loop
  form.measurement = gaussian on 2 edges
";
        assert_eq!(described(&summaries[0]), expected);
        assert_eq!(summaries.len(), 3);
    }
}
