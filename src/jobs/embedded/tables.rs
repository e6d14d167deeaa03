//! The tables in the file.

use redb::{Database, ReadableTable, TableDefinition, WriteTransaction};

use super::codec::decode_record;
use crate::jobs::{JobId, StoreError, Timestamp};

/// Records by job.
pub(super) const RECORDS: TableDefinition<'static, u128, &[u8]> = TableDefinition::new("records");
/// Problems as they came, by job.
pub(super) const PROBLEMS: TableDefinition<'static, u128, &[u8]> = TableDefinition::new("problems");
/// The rest of the requests, by job.
pub(super) const REQUESTS: TableDefinition<'static, u128, &[u8]> = TableDefinition::new("requests");
/// Events by job and number, without their plans.
pub(super) const EVENTS: TableDefinition<'static, (u128, u64), &[u8]> = TableDefinition::new("events");
/// Plans by job and revision.
pub(super) const PLANS: TableDefinition<'static, (u128, u64), &[u8]> = TableDefinition::new("plans");
/// Job and digest of the request by idempotency key.
pub(super) const KEYS: TableDefinition<'static, &str, (u128, &str)> = TableDefinition::new("keys");
/// Last sign of life of whoever runs a job (ms), by job.
pub(super) const LEASES: TableDefinition<'static, u128, u64> = TableDefinition::new("leases");

/// Any failure of the database.
pub(super) fn broken(error: impl std::fmt::Display) -> StoreError {
    StoreError::Broken(error.to_string())
}

/// Makes the tables that are not there yet.
pub(super) fn create(database: &Database) -> Result<(), StoreError> {
    let transaction = database.begin_write().map_err(broken)?;
    for table in [RECORDS, PROBLEMS, REQUESTS] {
        transaction.open_table(table).map_err(broken)?;
    }
    for table in [EVENTS, PLANS] {
        transaction.open_table(table).map_err(broken)?;
    }
    transaction.open_table(KEYS).map_err(broken)?;
    transaction.open_table(LEASES).map_err(broken)?;
    transaction.commit().map_err(broken)
}

pub(super) fn put(
    transaction: &WriteTransaction,
    table: TableDefinition<'static, u128, &[u8]>,
    id: u128,
    value: &[u8],
) -> Result<(), StoreError> {
    let mut table = transaction.open_table(table).map_err(broken)?;
    table.insert(id, value).map_err(broken)?;
    Ok(())
}

pub(super) fn sign_of_life(
    transaction: &WriteTransaction,
    id: u128,
    now: Timestamp,
) -> Result<(), StoreError> {
    let mut leases = transaction.open_table(LEASES).map_err(broken)?;
    leases.insert(id, now.unix_millis()).map_err(broken)?;
    Ok(())
}

/// Removes what a job's client asked for.
pub(super) fn forget_request(transaction: &WriteTransaction, id: u128) -> Result<(), StoreError> {
    for table in [PROBLEMS, REQUESTS] {
        let mut table = transaction.open_table(table).map_err(broken)?;
        table.remove(id).map_err(broken)?;
    }
    Ok(())
}

/// Removes all of a job.
pub(super) fn forget(transaction: &WriteTransaction, job: JobId) -> Result<(), StoreError> {
    let id = job.as_u128();
    let mut records = transaction.open_table(RECORDS).map_err(broken)?;
    let kept = match records.remove(id).map_err(broken)? {
        Some(value) => decode_record(job, value.value())?,
        None => return Err(StoreError::UnknownJob(job)),
    };
    forget_request(transaction, id)?;
    for table in [EVENTS, PLANS] {
        let mut table = transaction.open_table(table).map_err(broken)?;
        table.retain_in((id, 0)..=(id, u64::MAX), |_, _| false).map_err(broken)?;
    }
    let mut leases = transaction.open_table(LEASES).map_err(broken)?;
    leases.remove(id).map_err(broken)?;
    if let Some(key) = kept.key {
        let mut keys = transaction.open_table(KEYS).map_err(broken)?;
        let own = keys.get(key.as_str()).map_err(broken)?.is_some_and(|value| value.value().0 == id);
        if own {
            keys.remove(key.as_str()).map_err(broken)?;
        }
    }
    Ok(())
}
