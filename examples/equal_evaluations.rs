//! Every optimizer at equal likelihood evaluations: error, coverage and seconds over budgets from 50 to 2,000.
//!
//! `cargo run --release --example equal_evaluations -- [RUNS] [FOLDER] [WORD]…` prints the table and writes
//! `equal-evaluations.svg` and `equal-evaluations.csv` to the folder (50 runs, and the present folder, where left
//! out). Words keep the problems whose name holds one of them, and likewise the optimizers; all, where none does. All
//! optimizers see the same draws of each problem, so that runs are paired: `wins` is the share of runs whose error is
//! smaller than the regularised filter's at the same budget, with one half for chance and a standard error of
//! 0.5 / sqrt(runs).

#[path = "equal_evaluations/plot.rs"]
mod plot;
#[path = "equal_evaluations/problems.rs"]
mod problems;

use std::fmt::Write as _;
use std::time::Instant;

use sumprod::optimizers::{
    BoardSettings, Independence, KnowledgeBoard, Move, QuantumImportance, QuantumLiteral, QuantumMetropolis,
    RandomWalk, Regularised, Weigh,
};

use problems::{PROBLEMS, Problem, Tally};

/// Likelihood evaluations a step.
pub const BUDGETS: [usize; 6] = [50, 100, 200, 500, 1000, 2000];

type Failure = Box<dyn std::error::Error + Send + Sync>;
type Made = Result<Box<dyn Move>, Failure>;

/// An optimizer by name, and how many likelihoods it may evaluate for each particle.
struct Entry {
    name: &'static str,
    evaluations: usize,
    make: fn() -> Made,
}

const ENTRIES: &[Entry] = &[
    Entry { name: "bootstrap", evaluations: 1, make: || Ok(Box::new(Weigh)) },
    Entry { name: "regularised", evaluations: 1, make: || Ok(Box::new(Regularised::default())) },
    Entry { name: "random walk, 2 steps", evaluations: 3, make: || Ok(Box::new(RandomWalk::new(2, 1.0)?)) },
    Entry { name: "independence, 1 step", evaluations: 2, make: || Ok(Box::new(Independence::new(1, 1.2)?)) },
    Entry {
        name: "independence, 5 steps",
        evaluations: 6,
        make: || Ok(Box::new(Independence::new(5, 1.2)?)),
    },
    Entry { name: "quantum, literal", evaluations: 6, make: || Ok(Box::new(QuantumLiteral::default())) },
    Entry {
        name: "quantum, importance",
        evaluations: 5,
        make: || Ok(Box::new(QuantumImportance::default())),
    },
    Entry { name: "quantum, Metropolis", evaluations: 6, make: || quantum(5) },
    Entry { name: "quantum, Metropolis, 1 generation", evaluations: 2, make: || quantum(1) },
    Entry { name: "swarm, literal", evaluations: 9, make: || board(BoardSettings::literal()) },
    Entry { name: "swarm", evaluations: 7, make: || swarm(10, 5) },
    Entry { name: "swarm that does not move", evaluations: 2, make: || swarm(10, 0) },
    Entry { name: "one sub-swarm", evaluations: 4, make: || swarm(1, 2) },
    Entry { name: "one sub-swarm that does not move", evaluations: 2, make: || swarm(1, 0) },
];

fn quantum(generations: usize) -> Made {
    Ok(Box::new(QuantumMetropolis { generations, ..Default::default() }))
}

fn board(settings: BoardSettings) -> Made {
    Ok(Box::new(KnowledgeBoard::new(settings)?))
}

/// The valid swarm: where it does not move, particles are drawn from the Gaussians of the weighed sub-swarms.
fn swarm(sub_swarms: usize, iterations: usize) -> Made {
    board(BoardSettings { iterations, sub_swarms, ..Default::default() })
}

/// One line of the table.
pub struct Row {
    problem: &'static str,
    name: &'static str,
    budget: usize,
    tally: Tally,
    /// Share of runs nearer the truth than the regularised filter's.
    wins: Option<f64>,
    seconds: f64,
}

/// What others are compared with, run by run.
const REGULARISED: &str = "regularised";

/// The names that hold one of the words; all, where none does.
fn chosen<'a, T>(all: &'a [T], name: impl Fn(&T) -> &str, words: &[String]) -> Vec<&'a T> {
    let named = |item: &&T| words.iter().any(|word| name(item).contains(word.as_str()));
    let some: Vec<&T> = all.iter().filter(named).collect();
    if some.is_empty() { all.iter().collect() } else { some }
}

/// Runs the comparison.
fn compare(runs: u64, budgets: &[usize], words: &[String]) -> Result<Vec<Row>, Failure> {
    let entries = chosen(ENTRIES, |entry| entry.name, words);
    let problems = chosen(PROBLEMS, |problem| problem.name, words);
    let of_problem = |problem: &'static Problem| -> Result<Vec<Row>, Failure> {
        let mut rows: Vec<Row> = Vec::new();
        for entry in &entries {
            for &budget in budgets {
                let (count, start) = ((budget / entry.evaluations).max(1), Instant::now());
                let mut tally = Tally::default();
                for run in 0..runs {
                    (problem.track)(run, count, (entry.make)()?, &mut tally)?;
                }
                let seconds = start.elapsed().as_secs_f64();
                let (problem, name) = (problem.name, entry.name);
                rows.push(Row { problem, name, budget, tally, wins: None, seconds });
            }
        }
        for k in 0..rows.len() {
            let row = &rows[k];
            let other = rows.iter().find(|other| other.name == REGULARISED && other.budget == row.budget);
            rows[k].wins = other.map(|other| row.tally.wins_over(&other.tally));
        }
        Ok(rows)
    };
    let mut rows = Vec::new();
    std::thread::scope(|scope| -> Result<(), Failure> {
        let threads: Vec<_> = problems.iter().map(|problem| scope.spawn(|| of_problem(problem))).collect();
        for thread in threads {
            rows.extend(thread.join().map_err(|_| "a problem's thread stopped")??);
        }
        Ok(())
    })?;
    Ok(rows)
}

fn table(rows: &[Row]) -> Result<String, std::fmt::Error> {
    let mut text =
        String::from("problem,optimizer,budget,evaluations,rmse,se,coverage95,wins,failed,seconds\n");
    for Row { problem, name, budget, tally, wins, seconds } in rows {
        let (rmse, error) = tally.rmse();
        let wins = wins.map_or(String::new(), |wins| format!("{wins:.3}"));
        writeln!(
            text,
            "\"{problem}\",\"{name}\",{budget},{:.0},{rmse:.4},{error:.4},{:.3},{wins},{},{seconds:.2}",
            tally.evaluations_a_step(),
            tally.coverage(),
            tally.failed
        )?;
    }
    Ok(text)
}

/// Prints the table and draws the plot.
pub fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let runs = arguments.next().map_or(Ok(50), |text| text.parse::<u64>())?;
    let folder = std::path::PathBuf::from(arguments.next().unwrap_or_else(|| ".".into()));
    let words: Vec<String> = arguments.collect();
    let rows = compare(runs.max(2), &BUDGETS, &words)?;
    let text = table(&rows)?;
    print!("{text}");
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join("equal-evaluations.csv"), text)?;
    std::fs::write(folder.join("equal-evaluations.svg"), plot::draw(&rows)?)?;
    Ok(())
}

/// The comparison in small, for the tests: every optimizer runs on every problem.
#[cfg(test)]
pub fn in_small() -> Result<(), Failure> {
    let rows = compare(2, &[60], &[])?;
    let whole = rows.len() == PROBLEMS.len() * ENTRIES.len() && plot::draw(&rows)?.contains("</svg>");
    whole.then_some(()).ok_or_else(|| "some optimizer is missing".into())
}
