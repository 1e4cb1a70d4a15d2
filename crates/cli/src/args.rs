//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

/// Sum-product inference on factor graphs: scenarios in, tables, plots and reports out.
#[derive(Debug, Parser)]
#[command(name = "sumprod", version, disable_help_subcommand = true)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scenario and print its methods side by side
    Run(RunArguments),
    /// List the built-in scenarios
    List,
    /// Check a scenario and print the size, components, loops and forms of its graphs
    Check(CheckArguments),
}

/// What names and changes a scenario.
#[derive(Clone, Debug, Default, Args)]
pub struct ScenarioArguments {
    /// A TOML file, or the name of a built-in scenario
    pub scenario: String,

    /// Methods, separated by commas; all if left out
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub method: Vec<String>,

    /// Folder of one recording, or file of one graph
    ///
    /// Left out, it is $SUMPROD_DATA (or ../shared/data) joined with the scenario's own subfolder.
    #[arg(long, value_name = "PATH")]
    pub data: Option<PathBuf>,

    /// Seed of all random draws
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,

    /// Override a key, for instance world.steps=20; may be repeated
    ///
    /// The value is read as TOML, else as a bare string; an array is one value.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

#[derive(Clone, Debug, Default, Args)]
pub struct RunArguments {
    #[command(flatten)]
    pub scenario: ScenarioArguments,

    /// Number of runs
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub runs: Option<u32>,

    /// Run every one of these values of a key, for instance world.steps=20,40,60, and print one table; may be
    /// repeated for all combinations
    ///
    /// The values are separated by commas outside of brackets, braces and quotes, and read as those of --set.
    #[arg(long, value_name = "KEY=A,B,C")]
    pub sweep: Vec<String>,

    /// Folder for estimates.csv, metrics.json and plots; finished runs are kept there, and an interrupted command
    /// goes on from them
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Print the metrics as JSON, and nothing else, on standard output
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Debug, Args)]
pub struct CheckArguments {
    #[command(flatten)]
    pub scenario: ScenarioArguments,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_well_formed() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn methods_are_split_at_commas_and_sets_are_not() {
        let line =
            ["sumprod", "run", "s", "--method", "a,b", "--set", "world.start=[1,2]", "--set", "runs=3"];
        let Command::Run(run) = Arguments::try_parse_from(line).unwrap().command else {
            panic!("not run");
        };
        assert_eq!(run.scenario.method, ["a", "b"]);
        assert_eq!(run.scenario.set, ["world.start=[1,2]", "runs=3"]);
    }
}
