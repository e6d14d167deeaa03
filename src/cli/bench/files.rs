//! The files of a folder of results.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::bench::{self, Results};
use crate::cli::{CliError, input};

/// The file from which results can be read again.
const RESULTS: &str = "results.json";

/// Longest results that are read (bytes).
const LONGEST: usize = 1 << 30;

/// The path of the results in `folder`.
pub(super) fn results_of(folder: &Path) -> PathBuf {
    folder.join(RESULTS)
}

/// Reads results from a folder or a file.
pub(super) fn read(path: &Path) -> Result<Results, CliError> {
    let path = if path.is_dir() { results_of(path) } else { path.to_owned() };
    let content = input::bytes(&path, LONGEST)?;
    let results: Results =
        serde_json::from_slice(&content).map_err(|error| unusable(&path, error.to_string()))?;
    if results.schema != Results::SCHEMA {
        let what = format!("`schema` is not {}", Results::SCHEMA);
        return Err(unusable(&path, what));
    }
    Ok(results)
}

/// Writes `results.json`, `results.csv` and `report.html` into `folder`. What was there before stays whole
/// until the new file is complete.
pub(super) fn write(folder: &Path, results: &Results) -> Result<(), CliError> {
    let json = results.to_json().map_err(|error| unusable(folder, error.to_string()))?;
    let files = [
        (RESULTS, json),
        ("results.csv", bench::to_csv(&results.runs)),
        ("report.html", bench::to_html(results)),
    ];
    for (name, content) in files {
        let path = folder.join(name);
        let begun = folder.join(format!("{name}.part"));
        fs::write(&begun, content)
            .and_then(|()| fs::rename(&begun, &path))
            .map_err(|source| CliError::Write { path, source })?;
    }
    Ok(())
}

/// Makes sure that there is a folder.
pub(super) fn folder(path: &Path) -> Result<(), CliError> {
    let failed = |source: io::Error| CliError::Write { path: path.to_owned(), source };
    fs::create_dir_all(path).map_err(failed)
}

/// An error about what a file of results holds.
pub(super) fn unusable(path: &Path, what: impl Into<String>) -> CliError {
    CliError::Results { path: path.to_owned(), what: what.into() }
}
