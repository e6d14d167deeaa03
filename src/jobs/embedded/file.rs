//! The file of the store: made whole or not at all.
//!
//! redb makes a new file in several synced steps, and does not open one of which it made a part. So a
//! new store is made under another name, and gets its own once all of it is on the disk: a process
//! that is killed meanwhile leaves nothing that the next one could trip over.

use std::fs::{self, File};
use std::path::Path;

use redb::{Database, DatabaseError, StorageError};
use tempfile::NamedTempFile;

use super::tables::{self, broken};
use crate::jobs::StoreError;

/// Name below the data directory.
pub(super) const FILE: &str = "quadrille.redb";
/// How the names of stores begin and end that are being made.
const UNFINISHED: (&str, &str) = ("quadrille-", ".redb.new");

/// The store in `folder`, made when there is none; `cache` is what it may keep in memory (bytes).
///
/// # Errors
/// When the folder cannot be used, another process has the store open, or the file is no store.
pub(super) fn open(folder: &Path, cache: usize) -> Result<Database, StoreError> {
    fs::create_dir_all(folder).map_err(broken)?;
    let path = folder.join(FILE);
    let database = match fs::exists(&path).map_err(broken)? {
        true => existing(&path, cache)?,
        false => match made(folder, cache)?.persist_noclobber(&path) {
            Ok(database) => database,
            // Another process was faster, and has it open; or here a name cannot be given in one step.
            Err(_) => existing(&path, cache)?,
        },
    };
    // The name is on the disk before anyone is told that something is kept under it.
    if let Err(error) = File::open(folder).and_then(|folder| folder.sync_all()) {
        tracing::warn!(?folder, %error, "the folder's list of files could not be synced");
    }
    remove_unfinished(folder);
    Ok(database)
}

fn existing(path: &Path, cache: usize) -> Result<Database, StoreError> {
    Database::builder().set_cache_size(cache).create(path).map_err(|error| match error {
        DatabaseError::DatabaseAlreadyOpen => broken(format!("{FILE} is in use by another process")),
        DatabaseError::Storage(StorageError::Io(why)) if why.kind() == std::io::ErrorKind::InvalidData => {
            broken(format!("{FILE}: {why}; put the file elsewhere to start with an empty store"))
        }
        error => broken(format!("{FILE}: {error}")),
    })
}

/// A new store under a name of its own; gone when dropped.
fn made(folder: &Path, cache: usize) -> Result<NamedTempFile<Database>, StoreError> {
    let make = |path: &Path| {
        Database::builder().set_cache_size(cache).create(path).map_err(|error| {
            // Begun, perhaps, and nobody else's.
            let _ = fs::remove_file(path);
            std::io::Error::other(error)
        })
    };
    let store = tempfile::Builder::new()
        .prefix(UNFINISHED.0)
        .suffix(UNFINISHED.1)
        .make_in(folder, make)
        .map_err(|error| broken(format!("{FILE}: {error}")))?;
    tables::create(store.as_file())?;
    Ok(store)
}

/// Removes what earlier processes did not finish. One that is still at it finds the store there.
fn remove_unfinished(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let unfinished =
            name.to_str().is_some_and(|name| name.starts_with(UNFINISHED.0) && name.ends_with(UNFINISHED.1));
        if unfinished && let Err(error) = fs::remove_file(entry.path()) {
            tracing::warn!(file = ?entry.path(), %error, "an unfinished store stays where it is");
        }
    }
}
