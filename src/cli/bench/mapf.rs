//! The benchmark of guidance: mode graphs of generated problems, as the planner makes them, solved with
//! both efforts, and for comparison by the paper's single integer program; every answer goes through the
//! independent checker.

use std::fmt;
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::bench::Size;
use crate::cli::{Answer as Reply, CliError, budget, input};
use crate::collision::CollisionWorld;
use crate::guidance::{Answer, Cuts, Effort, Instance, Network, check, single_call, solve};
use crate::mode_graph::{ModeGraphOptions, build_mode_graph};
use crate::run::{Control, Seed};
use crate::scenario::{Family, generate};
use crate::transition::SampledReach;
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

/// Solutions of which the quickest counts, where one takes less than [`SHORT`].
const ROUNDS: usize = 25;

/// What is short enough to be repeated.
const SHORT: Duration = Duration::from_millis(50);

/// Arguments of `bench mapf`.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// Sizes as arms x objects
    #[arg(long, value_delimiter = ',', default_value = "9x4,9x20,16x50", value_parser = str::parse::<Size>)]
    sizes: Vec<Size>,
    /// The family of problems
    #[arg(long, default_value = "random", value_parser = str::parse::<Family>)]
    family: Family,
    /// Problems of each size: seeds 0, 1, ...
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    trials: u64,
    /// How long a thorough solution may take
    #[arg(long, default_value = "2s", value_parser = budget::parse)]
    limit: Duration,
    /// Solve by the paper's single integer program per object, too, given the number of steps that was found
    #[arg(long)]
    single_call: bool,
    /// Print the table as JSON, with every problem
    #[arg(long)]
    json: bool,
}

/// One solution.
#[derive(Debug, Clone, Serialize)]
struct Solved {
    ms: f64,
    steps: Option<usize>,
    lower_bound: usize,
    proved: bool,
    /// Whether the checker accepted the plan; `None` without a plan.
    valid: Option<bool>,
}

/// One problem.
#[derive(Debug, Clone, Serialize)]
struct Trial {
    seed: u64,
    nodes: usize,
    edges: usize,
    blocks: usize,
    quick: Solved,
    thorough: Solved,
    #[serde(skip_serializing_if = "Option::is_none")]
    single_call: Option<Solved>,
}

impl Trial {
    /// All solutions of the problem.
    fn all(&self) -> impl Iterator<Item = &Solved> {
        [&self.quick, &self.thorough].into_iter().chain(&self.single_call)
    }
}

/// The problems of one size.
#[derive(Debug, Clone, Serialize)]
struct Sized {
    size: String,
    trials: Vec<Trial>,
}

/// All measurements.
#[derive(Debug, Clone, Serialize)]
struct Table {
    family: &'static str,
    limit_s: f64,
    sizes: Vec<Sized>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Reply, CliError> {
    let mut table =
        Table { family: arguments.family.name(), limit_s: arguments.limit.as_secs_f64(), sizes: Vec::new() };
    for &size in &arguments.sizes {
        let trials = (0..arguments.trials).map(|seed| trial(arguments, size, seed));
        let trials: Result<Vec<Trial>, CliError> = trials.collect();
        table.sizes.push(Sized { size: size.to_string(), trials: trials? });
    }
    let mut solutions = table.sizes.iter().flat_map(|size| &size.trials).flat_map(Trial::all);
    let all_valid = solutions.all(|solved| solved.valid != Some(false));
    let text = if arguments.json {
        serde_json::to_string_pretty(&table)
            .map_err(|error| CliError::Write { path: "stdout".into(), source: error.into() })?
    } else {
        table.to_string()
    };
    input::write(None, &text)?;
    Ok(if all_valid { Reply::Yes } else { Reply::No })
}

/// Makes a problem's mode graph and solves it.
fn trial(arguments: &Arguments, size: Size, seed: u64) -> Result<Trial, CliError> {
    let document = generate(arguments.family, size.arms, size.objects, seed).map_err(CliError::Scenario)?;
    let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default())
        .map_err(|faults| CliError::Faults { path: "generated".into(), faults })?
        .problem;
    let world = CollisionWorld::new(&problem);
    let mut reach = SampledReach::new(&problem, &world, Seed(seed));
    let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &Control::unbounded());
    let instance = Instance::from(&graph);
    let (nodes, edges, blocks) = (instance.nodes.len(), instance.edges.len(), instance.blocks.len());
    let network = Network::new(instance).map_err(CliError::Graph)?;
    let quick = solved(&network, &Effort::quick(), None);
    let thorough = solved(&network, &Effort::thorough(), Some(arguments.limit));
    let single_call = arguments.single_call.then(|| solved_at_once(&network, &thorough, arguments.limit));
    Ok(Trial { seed, nodes, edges, blocks, quick, thorough, single_call })
}

/// Solves from the start by one integer program with as many steps as a plan that is `known` has.
fn solved_at_once(network: &Network, known: &Solved, limit: Duration) -> Solved {
    let start = network.instance().start();
    let horizon = known.steps.unwrap_or(known.lower_bound);
    let began = Instant::now();
    let answer = single_call(network, &start, horizon, limit.as_secs_f64());
    let ms = began.elapsed().as_secs_f64() * 1e3;
    let steps = answer.as_ref().ok().map(|plan| plan.steps.len());
    Solved {
        ms,
        steps,
        lower_bound: known.lower_bound,
        proved: steps == Some(known.lower_bound),
        valid: answer.ok().map(|plan| check(network.instance(), &plan).is_ok()),
    }
}

/// Solves from the start, again and again where that is quick.
fn solved(network: &Network, effort: &Effort, limit: Option<Duration>) -> Solved {
    let start = network.instance().start();
    let mut least = Duration::MAX;
    let mut answer = None;
    for _ in 0..ROUNDS {
        let control = limit.map_or_else(Control::unbounded, Control::with_budget);
        let began = Instant::now();
        answer = solve(network, &start, &Cuts::none(), effort, Seed(1), &control).ok();
        least = least.min(began.elapsed());
        if least > SHORT {
            break;
        }
    }
    let valid =
        answer.as_ref().and_then(Answer::solution).map(|plan| check(network.instance(), plan).is_ok());
    let certificate = answer.as_ref().and_then(Answer::certificate);
    Solved {
        ms: least.as_secs_f64() * 1e3,
        steps: certificate.map(|certificate| certificate.steps),
        lower_bound: match &answer {
            Some(Answer::Unknown { lower_bound }) => *lower_bound,
            _ => certificate.map_or(0, |certificate| certificate.lower_bound),
        },
        proved: certificate.is_some_and(|certificate| certificate.optimum.is_some()),
        valid,
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "guidance on mode graphs of generated `{}` problems, one thread; thorough within {} s",
            self.family, self.limit_s
        )?;
        writeln!(
            f,
            "{:<8} {:<9} {:>7} {:>8} {:>11} {:>11} {:>10} {:>10} {:>8}",
            "size", "effort", "proved", "valid", "median ms", "worst ms", "steps", "bound", "gap"
        )?;
        for size in &self.sizes {
            let quick = size.trials.iter().map(|trial| &trial.quick).collect();
            let thorough = size.trials.iter().map(|trial| &trial.thorough).collect();
            row(f, &size.size, "quick", quick)?;
            row(f, &size.size, "thorough", thorough)?;
            let single: Vec<&Solved> = size.trials.iter().filter_map(|t| t.single_call.as_ref()).collect();
            if !single.is_empty() {
                row(f, &size.size, "one call", single)?;
            }
        }
        Ok(())
    }
}

fn row(f: &mut fmt::Formatter<'_>, size: &str, effort: &str, solved: Vec<&Solved>) -> fmt::Result {
    let count = solved.len();
    let mut times: Vec<f64> = solved.iter().map(|solved| solved.ms).collect();
    times.sort_by(f64::total_cmp);
    let median = times.get(count / 2).copied().unwrap_or(f64::NAN);
    let worst = times.last().copied().unwrap_or(f64::NAN);
    let of = |test: &dyn Fn(&Solved) -> bool| {
        format!("{}/{count}", solved.iter().filter(|solved| test(solved)).count())
    };
    let range = |values: Vec<usize>| match (values.iter().min(), values.iter().max()) {
        (Some(least), Some(most)) => format!("{least}-{most}"),
        _ => "none".to_owned(),
    };
    let gap = solved.iter().map(|solved| solved.steps.map(|steps| steps - solved.lower_bound)).max_by_key(
        // No plan at all is the greatest gap.
        |gap| gap.unwrap_or(usize::MAX),
    );
    writeln!(
        f,
        "{size:<8} {effort:<9} {:>7} {:>8} {median:>11.3} {worst:>11.3} {:>10} {:>10} {:>8}",
        of(&|solved| solved.proved),
        of(&|solved| solved.valid == Some(true)),
        range(solved.iter().filter_map(|solved| solved.steps).collect()),
        range(solved.iter().map(|solved| solved.lower_bound).collect()),
        gap.flatten().map_or("no plan".to_owned(), |gap| gap.to_string()),
    )
}
