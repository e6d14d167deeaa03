//! `quadrille bench`: measurements.

mod compare;
mod files;
mod kernels;
mod mapf;
mod paper;
mod screen;
mod table;
pub mod work;

use super::{Answer, CliError, input};

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// The paper's evaluation: families x sizes x guidances x trials, every plan judged
    Paper(paper::Arguments),
    /// Two results of `paper` against each other: ratios of medians, and which are more than noise
    Compare(compare::Arguments),
    /// Guidance on the mode graphs of generated problems: how many step counts are proved, how quickly
    Mapf(mapf::Arguments),
    /// Forward and inverse kinematics and collision checks on this machine, next to parry
    Kernels {
        /// Print the table as JSON
        #[arg(long)]
        json: bool,
    },
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    match &arguments.command {
        Command::Paper(arguments) => paper::run(arguments),
        Command::Compare(arguments) => compare::run(arguments),
        Command::Mapf(arguments) => mapf::run(arguments),
        Command::Kernels { json } => kernels(*json),
    }
}

fn kernels(json: bool) -> Result<Answer, CliError> {
    let table = kernels::measure();
    let text = if json {
        serde_json::to_string_pretty(&table)
            .map_err(|error| CliError::Write { path: "stdout".into(), source: error.into() })?
    } else {
        table.to_string()
    };
    input::write(None, &text)?;
    Ok(Answer::Yes)
}
