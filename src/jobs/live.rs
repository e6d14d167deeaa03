//! Telling a job's readers that something has happened.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use super::Event;

/// What the readers of one job that has not ended share: who waits, and the latest sign of life.
#[derive(Debug, Default)]
pub(super) struct Live {
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    next_reader: u64,
    waiting: BTreeMap<u64, Waker>,
    progress: Option<(u64, Arc<Event>)>,
}

impl Live {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A number for a new reader.
    pub(super) fn enter(&self) -> u64 {
        let mut inner = self.lock();
        inner.next_reader += 1;
        inner.next_reader
    }

    /// The reader is gone.
    pub(super) fn leave(&self, reader: u64) {
        self.lock().waiting.remove(&reader);
    }

    /// Asks to be woken at the next event. To be called before the store is looked at, so that
    /// nothing falls between.
    pub(super) fn wait(&self, reader: u64, waker: &Waker) {
        let mut inner = self.lock();
        match inner.waiting.get_mut(&reader) {
            Some(present) => present.clone_from(waker),
            None => {
                inner.waiting.insert(reader, waker.clone());
            }
        }
    }

    /// Wakes everyone who waits.
    pub(super) fn wake(&self) {
        let waiting = std::mem::take(&mut self.lock().waiting);
        waiting.into_values().for_each(Waker::wake);
    }

    /// Replaces the latest sign of life and wakes everyone.
    pub(super) fn set_progress(&self, event: Arc<Event>) {
        let mut inner = self.lock();
        let number = inner.progress.as_ref().map_or(1, |(number, _)| number + 1);
        inner.progress = Some((number, event));
        drop(inner);
        self.wake();
    }

    /// The latest sign of life and its number, when that is above `seen`.
    pub(super) fn progress_after(&self, seen: u64) -> Option<(u64, Arc<Event>)> {
        self.lock().progress.as_ref().filter(|(number, _)| *number > seen).cloned()
    }
}
