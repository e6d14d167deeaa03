//! `quadrille plan`: plans for a problem file.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::guidance::Guidance;
use super::{Answer, CliError, budget, input, interrupt};
use crate::plan::Metrics;
use crate::planner::{self, PlannerCache, PlannerEvent, Termination};
use crate::problem::Options;
use crate::run::{CancelToken, Control, Deadline};

/// Arguments of `plan`. Those that stand here come before the problem's own options.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The problem file; `-` for stdin
    file: PathBuf,
    /// Time budget, such as 10s or 500ms [default: the problem's own, else 30s]
    #[arg(long, value_parser = budget::parse)]
    budget: Option<Duration>,
    /// Seed of all randomness [default: the problem's own, else 0]
    #[arg(long)]
    seed: Option<u64>,
    /// What steers the search [default: the problem's own, else smart]
    #[arg(long, value_enum)]
    guidance: Option<Guidance>,
    /// Planner threads [default: the problem's own, else 1]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: Option<u64>,
    /// Iteration budget; with it, a run on one thread repeats bit for bit
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: Option<u64>,
    /// Stop at the first plan
    #[arg(long)]
    first_solution: bool,
    /// Folder in which compiled workcells are kept from one run to the next
    #[arg(long, env = "QUADRILLE_CACHE_DIR")]
    cache_dir: Option<PathBuf>,
    /// Where the best plan goes, instead of stdout
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let began = Instant::now();
    let mut problem = input::problem(&arguments.file)?.problem;
    override_options(&mut problem.options, arguments);
    let time_budget = Duration::try_from_secs_f64(problem.options.time_budget_s).unwrap_or(Duration::MAX);
    let cancel = CancelToken::new();
    interrupt::cancels(cancel.clone());
    let control = Control::new(Deadline::resumed(began.elapsed(), time_budget), cancel);
    let mut screen = Screen::new();
    let mut cache = PlannerCache::new(0);
    if let Some(folder) = &arguments.cache_dir {
        cache = cache.with_folder(folder, None);
    }
    let outcome = planner::plan_with(&cache, &problem, &control, &mut |event| screen.show(&event));
    screen.clear();
    match &outcome.best {
        Some(best) => {
            input::write(arguments.out.as_deref(), &crate::wire::plan::to_json(&problem, best))?;
            Ok(Answer::Yes)
        }
        None => {
            let ending = match outcome.termination {
                Termination::Infeasible => "no plan exists",
                Termination::Cancelled => "cancelled before a plan was found",
                _ => "no plan was found",
            };
            match &outcome.diagnosis {
                Some(cause) => eprintln!("{ending}: {cause}"),
                None => eprintln!("{ending}"),
            }
            Ok(Answer::No)
        }
    }
}

fn override_options(options: &mut Options, arguments: &Arguments) {
    if let Some(budget) = arguments.budget {
        options.time_budget_s = budget.as_secs_f64();
    }
    if let Some(seed) = arguments.seed {
        options.seed = seed;
    }
    if let Some(guidance) = arguments.guidance {
        options.guidance = guidance.into();
    }
    if let Some(threads) = arguments.threads {
        options.threads = usize::try_from(threads).unwrap_or(1);
    }
    if arguments.max_iterations.is_some() {
        options.max_iterations = arguments.max_iterations;
    }
    options.stop.first_solution |= arguments.first_solution;
}

/// What a run shows on stderr: a line per incumbent, and on a terminal a line that moves.
struct Screen {
    terminal: bool,
    moving: bool,
}

impl Screen {
    fn new() -> Self {
        Self { terminal: std::io::stderr().is_terminal(), moving: false }
    }

    fn show(&mut self, event: &PlannerEvent<'_>) {
        match event {
            PlannerEvent::Incumbent(plan) => {
                self.clear();
                eprintln!("{}", incumbent_line(&plan.metrics));
            }
            PlannerEvent::Progress { elapsed_s, phase, iterations, .. } if self.terminal => {
                eprint!("\r\x1b[2K{elapsed_s:.1} s  {phase}  {iterations} iterations");
                // A line that cannot be shown is no reason to stop.
                let _ = std::io::stderr().flush();
                self.moving = true;
            }
            PlannerEvent::Progress { .. } | PlannerEvent::Judged { .. } => {}
        }
    }

    fn clear(&mut self) {
        if std::mem::take(&mut self.moving) {
            eprint!("\r\x1b[2K");
        }
    }
}

/// `found_after_s=0.041 steps=6/6 duration_s=11.2`: the steps of the plan and the optimum on the
/// mode graph, `?` while that is not proved.
fn incumbent_line(metrics: &Metrics) -> String {
    let optimum = metrics.mode_graph_optimum.map_or("?".to_owned(), |steps| steps.to_string());
    format!(
        "found_after_s={:.3} steps={}/{optimum} duration_s={:.3}",
        metrics.found_after_s, metrics.steps, metrics.duration_s
    )
}
