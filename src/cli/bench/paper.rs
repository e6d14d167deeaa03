//! `quadrille bench paper`.

use std::path::PathBuf;
use std::time::Duration;

use super::files;
use super::screen::Screen;
use crate::bench::{
    Case, Conditions, Machine, Notice, Results, RunSettings, Size, Suite, WorkcellAge, run_suite, select,
};
use crate::cli::guidance::Guidance;
use crate::cli::{Answer, CliError, budget, input, interrupt};
use crate::jobs::Timestamp;
use crate::run::CancelToken;
use crate::scenario::Family;

/// Arguments of `bench paper`.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// Trials of each case and guidance; trial n has scenario seed n and planner seed n, from 0
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    trials: u64,
    /// Time budget of a run, validation included, such as 30s or 500ms
    #[arg(long, default_value = "30s", value_parser = budget::parse)]
    budget: Duration,
    /// Families, with commas between; all by default
    #[arg(long, value_delimiter = ',', value_parser = str::parse::<Family>)]
    families: Vec<Family>,
    /// Sizes as arms x objects, such as 2x2,9x4; those that ship by default
    #[arg(long, value_delimiter = ',', value_parser = str::parse::<Size>)]
    sizes: Vec<Size>,
    /// Guidances
    #[arg(long, value_delimiter = ',', default_value = "smart,sequential,greedy")]
    guidance: Vec<Guidance>,
    /// Planner threads
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: u64,
    /// Folder of compiled workcells, for `--workcell stored`
    #[arg(long, env = "QUADRILLE_CACHE_DIR")]
    cache_dir: Option<PathBuf>,
    /// Whether another arrangement of the same workcell is planned before each run
    #[arg(long, value_enum, default_value = "new", requires_if("stored", "cache_dir"))]
    workcell: Workcell,
    /// End each run at its first plan
    #[arg(long)]
    first_solution: bool,
    /// Go on with the results in the folder, measured with the same arguments
    #[arg(long)]
    resume: bool,
    /// The folder for results.json, results.csv and report.html; written after every case
    #[arg(long)]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Workcell {
    /// Nothing is known of it
    New,
    /// It has been planned in before
    Known,
    /// It has been planned in before, and is read from the folder
    Stored,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let suite = suite(arguments)?;
    let mut results = Results {
        schema: Results::SCHEMA.to_owned(),
        machine: Machine::this(),
        conditions: Conditions::at_start(Timestamp::now().to_string()),
        setup: suite.setup(),
        runs: Vec::new(),
        remarks: Vec::new(),
    };
    let path = files::results_of(&arguments.out);
    if arguments.resume && path.exists() {
        let before = files::read(&path)?;
        let same = (&before.setup, &before.machine) == (&results.setup, &results.machine);
        if !same {
            let what = "was measured with other arguments or on another machine; give another folder";
            return Err(files::unusable(&path, what));
        }
        results = before;
    }
    files::folder(&arguments.out)?;
    let cancel = CancelToken::new();
    interrupt::cancels(cancel.clone());
    let mut screen = Screen::new();
    let complete = run_suite(&suite, &mut results, &cancel, &mut |notice| -> Result<(), CliError> {
        screen.show(&notice);
        match notice {
            Notice::CaseDone { results, .. } => files::write(&arguments.out, results),
            Notice::Running { .. } => Ok(()),
        }
    });
    screen.clear();
    let complete = complete?;
    files::write(&arguments.out, &results)?;
    let report = arguments.out.join("report.html");
    let done = format!("{} runs; see {}", results.runs.len(), report.display());
    input::write(None, &if complete { done } else { format!("ended before all was run: {done}") })?;
    Ok(if complete { Answer::Yes } else { Answer::No })
}

fn suite(arguments: &Arguments) -> Result<Suite, CliError> {
    let families = if arguments.families.is_empty() { &Family::ALL[..] } else { &arguments.families };
    let found = select(families, &arguments.sizes, arguments.trials).map_err(CliError::Scenario)?;
    if !found.skipped.is_empty() {
        let names: Vec<String> = found.skipped.iter().map(Case::to_string).collect();
        eprintln!("left out, for there is no such case: {}", names.join(", "));
    }
    let mut guidances = Vec::new();
    for guidance in arguments.guidance.iter().map(|guidance| (*guidance).into()) {
        if !guidances.contains(&guidance) {
            guidances.push(guidance);
        }
    }
    Ok(Suite {
        cases: found.cases,
        guidances,
        trials: arguments.trials,
        settings: RunSettings {
            budget: arguments.budget,
            threads: usize::try_from(arguments.threads).unwrap_or(1),
            workcell: match arguments.workcell {
                Workcell::New => WorkcellAge::New,
                Workcell::Known => WorkcellAge::Known,
                Workcell::Stored => WorkcellAge::Stored,
            },
            first_solution: arguments.first_solution,
            cache_dir: arguments.cache_dir.clone(),
        },
    })
}
