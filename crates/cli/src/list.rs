//! `sumprod list`: the built-in scenarios.

use crate::builtin::BUILTINS;
use crate::document::Document;
use crate::failure::Failure;
use crate::print::print;
use crate::table::{Align, Table};
use sumprod_positioning::scenario::Scenario;

use crate::systems::{Action, dispatch};

struct Describe;

impl Action for Describe {
    type Output = [String; 3];

    fn on<S: Scenario>(self, document: &Document) -> Result<Self::Output, Failure> {
        let (settings, scenario) = document.read::<S>()?;
        Ok([settings.name, settings.description, scenario.methods().join(" ")])
    }
}

/// Prints name, description and, below, the methods of each.
pub fn execute() -> Result<(), Failure> {
    let mut table = Table::new(&[("scenario", Align::Left), ("about, and its methods", Align::Left)]);
    for builtin in BUILTINS {
        let document = Document::parse(builtin.name, builtin.text, &[])?;
        let [name, about, methods] = dispatch(&document, Describe)?;
        table.row(vec![name, about]);
        table.row(vec![String::new(), format!("  {methods}")]);
    }
    print(&table.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_scenario_reads_and_has_its_own_name() {
        for builtin in BUILTINS {
            let document = Document::parse(builtin.name, builtin.text, &[]).unwrap();
            let [name, about, methods] = dispatch(&document, Describe).unwrap();
            assert_eq!(name, builtin.name);
            assert!(!about.is_empty() && !methods.is_empty(), "{name}");
        }
    }
}
