//! Reading problems and plans from files, and writing results.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::CliError;
use crate::wire::{Fault, Folder, ReadLimits, ReadProblem, read_problem};

/// The bytes of a file, or of stdin when the path is `-`; at most one more than `limit`.
pub(super) fn bytes(path: &Path, limit: usize) -> Result<Vec<u8>, CliError> {
    let read = |source| CliError::Read { path: path.to_owned(), source };
    let mut content = Vec::new();
    let limit = limit as u64 + 1;
    if path == Path::new("-") {
        std::io::stdin().lock().take(limit).read_to_end(&mut content).map_err(read)?;
    } else {
        File::open(path).map_err(read)?.take(limit).read_to_end(&mut content).map_err(read)?;
    }
    Ok(content)
}

/// Reads and validates a problem. Files that it refers to are looked for from its own folder. Warnings go to
/// stderr.
pub(super) fn problem(path: &Path) -> Result<ReadProblem, CliError> {
    let limits = ReadLimits::default();
    let folder = match path.parent() {
        Some(folder) if path != Path::new("-") && !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    };
    let content = bytes(path, limits.max_bytes)?;
    let read = read_problem(&content, &Folder::new(folder), &limits)
        .map_err(|faults| CliError::Faults { path: path.to_owned(), faults })?;
    for warning in &read.warnings {
        eprintln!("warning: {}", fault_line(warning));
    }
    Ok(read)
}

/// One line for a fault: pointer, code, message.
pub(super) fn fault_line(fault: &Fault) -> String {
    let pointer = if fault.pointer.is_empty() { "(document)" } else { &fault.pointer };
    format!("{pointer}: {}: {}", fault.code, fault.message)
}

/// Writes a document and a line's end to a file, or to stdout.
pub(super) fn write(path: Option<&Path>, document: &str) -> Result<(), CliError> {
    let shown = || path.unwrap_or(Path::new("stdout")).to_owned();
    let write = |out: &mut dyn Write| {
        out.write_all(document.as_bytes())?;
        if !document.ends_with('\n') {
            out.write_all(b"\n")?;
        }
        out.flush()
    };
    match path {
        Some(path) => File::create(path).and_then(|mut file| write(&mut file)),
        None => write(&mut std::io::stdout().lock()),
    }
    .map_err(|source| CliError::Write { path: shown(), source })
}
