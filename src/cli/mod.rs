//! The command line: `plan`, `verify`, `modes`, `scenario`, `bench`, `serve`, `health`.
//!
//! Exit codes: 0 for success (a plan was found, the plan is valid, the service ended as asked), 1
//! for a negative answer (no plan found, the plan is invalid, the service is not healthy), 2 for
//! input or surroundings that cannot be used.

mod bench;
mod budget;
mod guidance;
mod health;
mod input;
mod interrupt;
mod logging;
mod modes;
mod plan;
mod scenario;
mod serve;
mod settings;
mod verify;

pub use self::bench::work;

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use self::logging::LogFormat;
use crate::bench::BenchError;
use crate::guidance::InstanceError;
use crate::scenario::ScenarioError;
use crate::service::StartError;
use crate::wire::Fault;

/// Plans for robot arms that work together.
#[derive(Debug, Parser)]
#[command(
    name = "quadrille",
    version,
    about,
    after_help = "Exit codes: 0 success, 1 a negative answer \
    (no plan, invalid plan, not healthy), 2 input or surroundings that cannot be used.\n\
    QUADRILLE_LOG says what is logged, such as debug or quadrille=trace [default: info for serve, warn for the rest]."
)]
struct Arguments {
    /// How log lines are written to stderr
    #[arg(long, global = true, value_enum, default_value = "text", env = "QUADRILLE_LOG_FORMAT")]
    log_format: LogFormat,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plan for a problem file; the best plan goes to stdout
    Plan(plan::Arguments),
    /// Judge a plan for a problem
    Verify(verify::Arguments),
    /// Print the mode graph of a problem: who reaches what, who hands over to whom
    Modes(modes::Arguments),
    /// Problems of the benchmark families
    Scenario(scenario::Arguments),
    /// Measure: the paper's evaluation, two results against each other, the kernels
    Bench(bench::Arguments),
    /// Run the service
    Serve(Box<serve::Arguments>),
    /// Ask a running service whether it is ready
    Health(health::Arguments),
}

/// How a command ended, when it ended as it should.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// Exit code 0.
    Yes,
    /// Exit code 1.
    No,
}

/// Why a command could not do its work.
#[derive(Debug, thiserror::Error)]
enum CliError {
    /// A file could not be read.
    #[error("{}: {source}", shown(path))]
    Read { path: PathBuf, source: io::Error },
    /// Output could not be written.
    #[error("{}: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// A document has faults.
    #[error("{}: {} fault(s)", shown(path), faults.len())]
    Faults { path: PathBuf, faults: Vec<Fault> },
    /// Two documents cannot both come from stdin.
    #[error("problem and plan cannot both be `-`: give one of them as a file")]
    StdinTwice,
    /// No scenario can be made like this.
    #[error(transparent)]
    Scenario(ScenarioError),
    /// The settings of the service cannot be used.
    #[error("settings: {0}")]
    Settings(settings::SettingsError),
    /// Measurements could not be made.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// A mode graph is no instance of guidance.
    #[error("the mode graph makes no sense: {0}")]
    Graph(InstanceError),
    /// A file of results cannot be used.
    #[error("{}: {what}", path.display())]
    Results { path: PathBuf, what: String },
    /// The service failed.
    #[error("{0}: {1}")]
    Service(String, io::Error),
    /// The service could not be started.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// A path as people know it.
fn shown(path: &Path) -> String {
    if path == Path::new("-") { "stdin".to_owned() } else { path.display().to_string() }
}

/// An address and port as a flag.
///
/// # Errors
/// When it is none; a name is none.
fn socket_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| "give an IP address and a port, such as 127.0.0.1:8080 or [::1]:8080".to_owned())
}

/// Runs the command that the process was called with.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    logging::start(arguments.log_format, matches!(arguments.command, Command::Serve(_)));
    let answer = match arguments.command {
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Modes(arguments) => modes::run(&arguments),
        Command::Scenario(arguments) => scenario::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Serve(arguments) => serve::run(*arguments),
        Command::Health(arguments) => Ok(health::run(&arguments)),
    };
    match answer {
        Ok(Answer::Yes) => ExitCode::SUCCESS,
        Ok(Answer::No) => ExitCode::from(1),
        // Whoever reads our output has enough of it.
        Err(CliError::Write { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => {
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            if let CliError::Faults { faults, .. } = &error {
                for fault in faults {
                    eprintln!("  {}", input::fault_line(fault));
                }
            }
            ExitCode::from(2)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        Arguments::command().debug_assert();
    }
}
