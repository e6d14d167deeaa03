//! `quadrille bench`: measurements.

mod compare;
mod files;
mod paper;
mod screen;

use super::{Answer, CliError};

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
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    match &arguments.command {
        Command::Paper(arguments) => paper::run(arguments),
        Command::Compare(arguments) => compare::run(arguments),
    }
}
