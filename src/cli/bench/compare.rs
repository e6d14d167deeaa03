//! `quadrille bench compare`.

use std::path::PathBuf;

use super::files;
use crate::bench;
use crate::cli::{Answer, CliError, input};

/// Arguments of `bench compare`.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// Results to compare with: a folder that `bench paper` has written, or its results.json
    a: PathBuf,
    /// Results that are compared
    b: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let (a, b) = (files::read(&arguments.a)?, files::read(&arguments.b)?);
    input::write(None, &bench::compare(&a, &b).to_string())?;
    Ok(Answer::Yes)
}
