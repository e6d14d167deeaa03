//! `quadrille modes`: prints the mode graph of a problem.

use std::path::PathBuf;
use std::time::Duration;

use clap::ValueEnum;

use super::{Answer, CliError, budget, input};
use crate::collision::CollisionWorld;
use crate::mode_graph::{ModeGraphOptions, build_mode_graph, find_witnesses, optimistic_mode_graph};
use crate::planner::settled_mode_graph;
use crate::run::{Control, Seed};
use crate::service::mode_graph_document;
use crate::transition::SampledReach;

/// Arguments of `modes`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The problem file; `-` for stdin
    file: PathBuf,
    /// How the graph is written
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// As `--format json`
    #[arg(long, conflicts_with_all = ["format", "dot"])]
    json: bool,
    /// As `--format dot`
    #[arg(long, conflicts_with = "format")]
    dot: bool,
    /// The graph that bounds instead of the one that guides
    #[arg(long)]
    optimistic: bool,
    /// Time budget, such as 10s or 500ms
    #[arg(long, value_parser = budget::parse)]
    budget: Option<Duration>,
    /// Seed of all randomness
    #[arg(long)]
    seed: Option<u64>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Lines of text
    Text,
    /// One JSON document
    Json,
    /// Graphviz's DOT
    Dot,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let problem = input::problem(&arguments.file)?.problem;
    let control = arguments.budget.map_or_else(Control::unbounded, Control::with_budget);
    let graph = if arguments.optimistic {
        optimistic_mode_graph(&problem)
    } else {
        let world = CollisionWorld::new(&problem);
        let seed = Seed(arguments.seed.unwrap_or(problem.options.seed));
        let mut reach = SampledReach::new(&problem, &world, seed);
        let mut graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &control);
        find_witnesses(&problem, &mut graph, &mut reach, &control);
        settled_mode_graph(&problem, &world, graph, reach, seed, &control)
    };
    let format = match (arguments.json, arguments.dot) {
        (true, _) => Format::Json,
        (_, true) => Format::Dot,
        _ => arguments.format,
    };
    let text = match format {
        Format::Text => graph.to_text(&problem),
        Format::Dot => graph.to_dot(&problem),
        Format::Json => serde_json::to_string_pretty(&mode_graph_document(&graph, &problem))
            .map_err(|error| CliError::Write { path: "stdout".into(), source: error.into() })?,
    };
    input::write(None, &text)?;
    Ok(if graph.complete { Answer::Yes } else { Answer::No })
}
