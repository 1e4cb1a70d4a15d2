//! The `sumprod` program: scenario files in, tables, plots and reports out.
//!
//! Exit status: 0 done, 1 failed while running, 2 the input was wrong.

mod args;
mod builtin;
mod check;
mod document;
mod failure;
mod list;
mod output;
mod plots;
mod print;
mod run;
mod setup;
mod systems;
mod table;
#[cfg(test)]
mod testing;

use std::process::ExitCode;

use clap::Parser;

use args::{Arguments, Command};

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Run(arguments) => run::execute(&arguments),
        Command::List => list::execute(),
        Command::Check(arguments) => check::execute(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
