//! Registered workcells: PUT once, referred to by id or digest from then on.
//!
//! A version stays for as long as an id leads to it or a job that has not ended refers to it; beyond
//! that it makes room for newer ones, oldest first.

mod archive;
mod bundle;

pub use archive::{ArchiveError, ArchiveLimits, Files, unpack_tar_gz, unpack_zip};
pub use bundle::{Bundle, BundleError};

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

use redb::{Database, ReadableDatabase, ReadableTable, TableDefinition};

use crate::jobs::{StoreError, Timestamp};
use crate::wire::KnownRobots;

/// Bundles by digest.
const BUNDLES: TableDefinition<'static, &str, &[u8]> = TableDefinition::new("workcell_bundles");
/// Digest, and when it was registered (ms), by id.
const NAMES: TableDefinition<'static, &str, (&str, u64)> = TableDefinition::new("workcell_names");
/// Bytes of a bundle as it is kept, by digest.
const SIZES: TableDefinition<'static, &str, u64> = TableDefinition::new("workcell_sizes");
/// When a digest was registered first (ms).
const VERSIONS: TableDefinition<'static, &str, u64> = TableDefinition::new("workcell_versions");

/// A registered workcell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Registered {
    /// Its id.
    pub id: String,
    /// The digest that the id leads to.
    pub digest: String,
    /// When it was registered.
    pub at: Timestamp,
}

/// What a registration did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The id is new.
    Created,
    /// The id led elsewhere before.
    Replaced,
    /// Nothing has changed.
    Unchanged,
}

/// Why a workcell was not registered or found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RegistryError {
    /// As many are kept as may be, and all are in use.
    #[error("{0} workcells are registered already; delete one first")]
    Full(usize),
    /// They would take more room than they may, though nothing is kept that is not in use.
    #[error("workcells take at most {0} bytes; delete one first")]
    NoRoom(u64),
    /// The store does not work.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The registry, in the same file as the jobs.
pub struct Workcells {
    database: Arc<Database>,
    limit: usize,
    most_bytes: u64,
    writing: Mutex<()>,
    robots: KnownRobots,
}

fn broken(error: impl std::fmt::Display) -> RegistryError {
    RegistryError::Store(StoreError::Broken(error.to_string()))
}

impl Workcells {
    /// The registry in `database`, of at most `limit` workcells and `most_bytes` bytes.
    ///
    /// # Errors
    /// When the database does not work.
    pub fn open(database: Arc<Database>, limit: usize, most_bytes: u64) -> Result<Self, RegistryError> {
        let transaction = database.begin_write().map_err(broken)?;
        transaction.open_table(NAMES).map_err(broken)?;
        {
            let bundles = transaction.open_table(BUNDLES).map_err(broken)?;
            let mut sizes = transaction.open_table(SIZES).map_err(broken)?;
            let versions = transaction.open_table(VERSIONS).map_err(broken)?;
            // Those that were kept before sizes were.
            for entry in versions.iter().map_err(broken)? {
                let (digest, _) = entry.map_err(broken)?;
                if sizes.get(digest.value()).map_err(broken)?.is_none() {
                    let bytes = bundles.get(digest.value()).map_err(broken)?;
                    let bytes = bytes.map_or(0, |bundle| bundle.value().len() as u64);
                    sizes.insert(digest.value(), bytes).map_err(broken)?;
                }
            }
        }
        transaction.commit().map_err(broken)?;
        Ok(Self { database, limit, most_bytes, writing: Mutex::default(), robots: KnownRobots::new() })
    }

    /// Registers `bundle`, whose digest is `digest`, under `id`. Versions in `used` stay whatever
    /// happens.
    ///
    /// # Errors
    /// [`RegistryError::Full`], [`RegistryError::NoRoom`], or when the store fails.
    pub fn put(
        &self,
        id: &str,
        digest: &str,
        bundle: &Bundle,
        used: &BTreeSet<String>,
    ) -> Result<(Outcome, Registered), RegistryError> {
        let _one_at_a_time = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Timestamp::now();
        let transaction = self.database.begin_write().map_err(broken)?;
        let outcome = {
            let mut names = transaction.open_table(NAMES).map_err(broken)?;
            let mut bundles = transaction.open_table(BUNDLES).map_err(broken)?;
            let mut versions = transaction.open_table(VERSIONS).map_err(broken)?;
            let mut sizes = transaction.open_table(SIZES).map_err(broken)?;
            let before = names.get(id).map_err(broken)?.map(|entry| {
                let (digest, at) = entry.value();
                (digest.to_owned(), at)
            });
            let outcome = match &before {
                None => Outcome::Created,
                Some((present, at)) if present == digest => {
                    let at = Timestamp::from_unix_millis(*at);
                    let registered = Registered { id: id.to_owned(), digest: digest.to_owned(), at };
                    return Ok((Outcome::Unchanged, registered));
                }
                Some(_) => Outcome::Replaced,
            };
            if before.is_none() && names.iter().map_err(broken)?.count() >= self.limit {
                return Err(RegistryError::Full(self.limit));
            }
            names.insert(id, (digest, now.unix_millis())).map_err(broken)?;
            if versions.get(digest).map_err(broken)?.is_none() {
                versions.insert(digest, now.unix_millis()).map_err(broken)?;
                let packed = bundle.pack();
                bundles.insert(digest, packed.as_slice()).map_err(broken)?;
                sizes.insert(digest, packed.len() as u64).map_err(broken)?;
            }
            // Superseded versions make room.
            let mut named = used.clone();
            for entry in names.iter().map_err(broken)? {
                named.insert(entry.map_err(broken)?.1.value().0.to_owned());
            }
            let (mut loose, mut count, mut bytes) = (Vec::new(), 0, 0);
            for entry in versions.iter().map_err(broken)? {
                let (digest, at) = entry.map_err(broken)?;
                let size = sizes.get(digest.value()).map_err(broken)?.map_or(0, |size| size.value());
                count += 1;
                bytes += size;
                if !named.contains(digest.value()) {
                    loose.push((at.value(), digest.value().to_owned(), size));
                }
            }
            loose.sort();
            for (_, digest, size) in loose {
                if count <= 2 * self.limit && bytes <= self.most_bytes {
                    break;
                }
                versions.remove(digest.as_str()).map_err(broken)?;
                bundles.remove(digest.as_str()).map_err(broken)?;
                sizes.remove(digest.as_str()).map_err(broken)?;
                count -= 1;
                bytes -= size;
            }
            if bytes > self.most_bytes {
                // Nothing of this is committed.
                return Err(RegistryError::NoRoom(self.most_bytes));
            }
            outcome
        };
        transaction.commit().map_err(broken)?;
        Ok((outcome, Registered { id: id.to_owned(), digest: digest.to_owned(), at: now }))
    }

    /// All registered workcells, by id.
    ///
    /// # Errors
    /// When the store fails.
    pub fn list(&self) -> Result<Vec<Registered>, RegistryError> {
        let read = self.database.begin_read().map_err(broken)?;
        let names = read.open_table(NAMES).map_err(broken)?;
        let entries = names.iter().map_err(broken)?;
        entries
            .map(|entry| {
                let (id, value) = entry.map_err(broken)?;
                let (digest, at) = value.value();
                let at = Timestamp::from_unix_millis(at);
                Ok(Registered { id: id.value().to_owned(), digest: digest.to_owned(), at })
            })
            .collect()
    }

    /// The robots of what was read before.
    pub fn robots(&self) -> &KnownRobots {
        &self.robots
    }

    /// The workcell of that id or digest.
    ///
    /// # Errors
    /// When the store fails.
    pub fn get(&self, reference: &str) -> Result<Option<(Registered, Bundle)>, RegistryError> {
        let read = self.database.begin_read().map_err(broken)?;
        let names = read.open_table(NAMES).map_err(broken)?;
        let versions = read.open_table(VERSIONS).map_err(broken)?;
        let bundles = read.open_table(BUNDLES).map_err(broken)?;
        let (digest, at) = match names.get(reference).map_err(broken)? {
            Some(entry) => {
                let (digest, at) = entry.value();
                (digest.to_owned(), at)
            }
            None => match versions.get(reference).map_err(broken)? {
                Some(at) => (reference.to_owned(), at.value()),
                None => return Ok(None),
            },
        };
        let Some(packed) = bundles.get(digest.as_str()).map_err(broken)? else { return Ok(None) };
        let bundle = Bundle::unpack(packed.value()).map_err(broken)?;
        let at = Timestamp::from_unix_millis(at);
        Ok(Some((Registered { id: reference.to_owned(), digest, at }, bundle)))
    }

    /// Forgets an id; `false` when there is none. Its versions stay until they make room.
    ///
    /// # Errors
    /// When the store fails.
    pub fn delete(&self, id: &str) -> Result<bool, RegistryError> {
        let _one_at_a_time = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let transaction = self.database.begin_write().map_err(broken)?;
        let found = {
            let mut names = transaction.open_table(NAMES).map_err(broken)?;
            names.remove(id).map_err(broken)?.is_some()
        };
        transaction.commit().map_err(broken)?;
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{EmbeddedStore, Retention};
    use serde_json::json;

    fn bundle(number: usize) -> (String, Bundle) {
        (format!("sha256:{number}"), Bundle { document: json!({ "number": number }), files: Files::new() })
    }

    #[test]
    fn ids_lead_to_the_newest_and_digests_to_their_own() {
        let store = EmbeddedStore::in_memory(Retention::default()).unwrap();
        let cells = Workcells::open(store.database(), 2, 1 << 20).unwrap();
        let none = BTreeSet::new();
        let put = |id: &str, number| {
            let (digest, bundle) = bundle(number);
            cells.put(id, &digest, &bundle, &none).map(|(outcome, _)| outcome)
        };
        assert_eq!(put("a", 1), Ok(Outcome::Created));
        assert_eq!(put("a", 1), Ok(Outcome::Unchanged));
        assert_eq!(put("a", 2), Ok(Outcome::Replaced));
        assert_eq!(cells.get("a").unwrap().unwrap().1, bundle(2).1);
        assert_eq!(cells.get("sha256:1").unwrap().unwrap().1, bundle(1).1);
        assert_eq!(put("b", 1), Ok(Outcome::Created));
        assert_eq!(put("c", 1), Err(RegistryError::Full(2)));
        assert!(cells.delete("b").unwrap() && !cells.delete("b").unwrap());
        assert_eq!(cells.list().unwrap().len(), 1);
        assert!(cells.get("b").unwrap().is_none());
    }

    #[test]
    fn superseded_versions_make_room_unless_they_are_used() {
        let store = EmbeddedStore::in_memory(Retention::default()).unwrap();
        let cells = Workcells::open(store.database(), 2, 1 << 20).unwrap();
        let used = BTreeSet::from([bundle(0).0]);
        for number in 0..10 {
            let (digest, bundle) = bundle(number);
            cells.put("a", &digest, &bundle, &used).unwrap();
        }
        let kept: Vec<usize> =
            (0..10).filter(|number| cells.get(&bundle(*number).0).unwrap().is_some()).collect();
        assert_eq!(kept.len(), 4);
        assert!(kept.contains(&0) && kept.contains(&9), "{kept:?}");
    }

    #[test]
    fn they_take_no_more_room_than_they_may() {
        let store = EmbeddedStore::in_memory(Retention::default()).unwrap();
        let cells = Workcells::open(store.database(), 9, 4000).unwrap();
        let put = |id: &str, number: usize, used: &[String]| {
            let (digest, mut bundle) = bundle(number);
            bundle.files.insert("x".to_owned(), vec![7_u8; 1500].into());
            cells.put(id, &digest, &bundle, &used.iter().cloned().collect())
        };
        put("a", 1, &[]).unwrap();
        put("b", 2, &[]).unwrap();
        assert_eq!(put("c", 3, &[]).unwrap_err(), RegistryError::NoRoom(4000));
        assert!(cells.get("c").unwrap().is_none() && cells.get("sha256:3").unwrap().is_none());
        // What is superseded makes room, unless a job needs it.
        assert_eq!(put("a", 3, &["sha256:1".to_owned()]).unwrap_err(), RegistryError::NoRoom(4000));
        put("a", 3, &[]).unwrap();
        assert!(cells.get("sha256:1").unwrap().is_none());
        put("c", 2, &[]).unwrap();
    }
}
