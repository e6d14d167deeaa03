//! Events that were read from the file and that some reader still holds: whoever else reads them gets
//! the same, so that many readers of one long job cost the memory of one.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use super::{Event, JobId, StoreError};

/// Entries beyond which those that nobody holds any more are dropped.
const FEW: usize = 1024;

/// The events on loan.
#[derive(Debug, Default)]
pub(super) struct Loaned {
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    events: BTreeMap<(JobId, u64), Weak<Event>>,
    /// Entries at which they are looked through again.
    tidy_at: usize,
}

impl Loaned {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The event with number `seq` of `job`: the one that someone holds, or what `read` gives.
    pub(super) fn get(
        &self,
        job: JobId,
        seq: u64,
        read: impl FnOnce() -> Result<Event, StoreError>,
    ) -> Result<Arc<Event>, StoreError> {
        if let Some(held) = self.lock().events.get(&(job, seq)).and_then(Weak::upgrade) {
            return Ok(held);
        }
        let event = Arc::new(read()?);
        let mut inner = self.lock();
        inner.events.insert((job, seq), Arc::downgrade(&event));
        if inner.events.len() > inner.tidy_at.max(FEW) {
            inner.events.retain(|_, event| event.strong_count() > 0);
            inner.tidy_at = 2 * inner.events.len();
        }
        Ok(event)
    }
}
