//! `quadrille scenario`: problems of the benchmark families.

use std::path::PathBuf;

use super::{Answer, CliError, input};
use crate::scenario;

/// Arguments of `scenario`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Generate a problem
    Generate(Generate),
    /// List the problems that ship with the product
    List,
}

#[derive(Debug, clap::Args)]
struct Generate {
    /// The family, such as switch or in_place_swap
    #[arg(long)]
    family: String,
    /// How many arms
    #[arg(long)]
    arms: usize,
    /// How many objects
    #[arg(long)]
    objects: usize,
    /// Seed of the sampled poses
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Which robots, dealt out to the arms in turn: iiwa14, ur_type, panda_type
    #[arg(long, value_delimiter = ',', default_value = "iiwa14")]
    robots: Vec<String>,
    /// Where the problem goes, instead of stdout
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    match &arguments.command {
        Command::Generate(wanted) => {
            let family = wanted.family.parse().map_err(CliError::Scenario)?;
            let robots: Result<Vec<_>, _> = wanted.robots.iter().map(|name| name.parse()).collect();
            let robots = robots.map_err(CliError::Scenario)?;
            let (arms, objects) = (wanted.arms, wanted.objects);
            let document = scenario::generate_with(family, arms, objects, wanted.seed, &robots)
                .map_err(CliError::Scenario)?;
            input::write(wanted.out.as_deref(), &scenario::to_text(&document))?;
        }
        Command::List => {
            let names: Vec<&str> = scenario::catalog().iter().map(|entry| entry.name).collect();
            input::write(None, &names.join("\n"))?;
        }
    }
    Ok(Answer::Yes)
}
