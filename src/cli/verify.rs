//! `quadrille verify`: judges a plan.

use std::path::PathBuf;

use super::{Answer, CliError, input};
use crate::verify;

/// Largest plan file that is read (bytes).
const LARGEST_PLAN: usize = 256 << 20;

/// Arguments of `verify`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The problem file; `-` for stdin
    problem: PathBuf,
    /// The plan file; `-` for stdin
    plan: PathBuf,
    /// Print the verdict as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    if [&arguments.problem, &arguments.plan].iter().all(|path| path.as_os_str() == "-") {
        return Err(CliError::StdinTwice);
    }
    let problem = input::problem(&arguments.problem)?.problem;
    let content = input::bytes(&arguments.plan, LARGEST_PLAN)?;
    let plan = crate::wire::plan::read_plan(&content, &problem)
        .map_err(|faults| CliError::Faults { path: arguments.plan.clone(), faults })?;
    let verdict = verify::verify(&problem, &plan);
    let text = if arguments.json {
        serde_json::to_string_pretty(&verdict)
            .map_err(|error| CliError::Write { path: "stdout".into(), source: error.into() })?
    } else {
        verdict.to_string()
    };
    input::write(None, &text)?;
    Ok(if verdict.valid { Answer::Yes } else { Answer::No })
}
