//! The store that forgets everything when the process ends.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{
    Event, EventBody, Incumbent, JobId, JobRecord, JobStore, NewJob, Revision, StoreError, Timestamp,
};

/// How much the store remembers of jobs that have ended. Jobs that have not are always kept.
#[derive(Debug, Clone, Copy)]
pub struct Retention {
    /// Most ended jobs.
    pub jobs: usize,
    /// Most bytes of their plans.
    pub plan_bytes: usize,
}

impl Default for Retention {
    fn default() -> Self {
        Self { jobs: 1000, plan_bytes: 512 << 20 }
    }
}

/// A [`JobStore`] in memory.
#[derive(Debug, Default)]
pub struct MemoryStore {
    retention: Retention,
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    jobs: BTreeMap<JobId, Entry>,
    /// Ended jobs, in the order in which they ended.
    ended: VecDeque<JobId>,
    ended_plan_bytes: usize,
}

#[derive(Debug)]
struct Entry {
    record: JobRecord,
    events: Vec<Arc<Event>>,
    plan_bytes: usize,
}

impl MemoryStore {
    /// An empty store.
    pub fn new(retention: Retention) -> Self {
        Self { retention, inner: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing below panics between two changes that belong together.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn entry(&self, job: JobId) -> Result<&Entry, StoreError> {
        self.jobs.get(&job).ok_or(StoreError::UnknownJob(job))
    }

    fn forget_surplus(&mut self, retention: Retention) {
        while self.ended.len() > retention.jobs
            || (self.ended_plan_bytes > retention.plan_bytes && self.ended.len() > 1)
        {
            let Some(oldest) = self.ended.pop_front() else { return };
            if let Some(entry) = self.jobs.remove(&oldest) {
                self.ended_plan_bytes -= entry.plan_bytes;
            }
        }
    }
}

impl JobStore for MemoryStore {
    fn create(&self, job: NewJob) -> Result<(), StoreError> {
        let record = JobRecord::new(job.id, job.created_at);
        self.lock().jobs.insert(job.id, Entry { record, events: Vec::new(), plan_bytes: 0 });
        Ok(())
    }

    fn append(&self, job: JobId, at: Timestamp, body: EventBody) -> Result<Arc<Event>, StoreError> {
        let mut inner = self.lock();
        let entry = inner.jobs.get_mut(&job).ok_or(StoreError::UnknownJob(job))?;
        if !entry.record.admits(&body) {
            return Err(StoreError::OutOfTurn { job, state: entry.record.state, event: body.kind() });
        }
        if let EventBody::Incumbent(incumbent) = &body {
            entry.plan_bytes += incumbent.document.len();
        }
        let (seq, attempt) = (entry.record.last_seq + 1, entry.record.attempt);
        let event = Arc::new(Event { seq, job, attempt, at, body });
        entry.record.apply(&event);
        entry.events.push(Arc::clone(&event));
        if entry.record.state.is_terminal() {
            let bytes = entry.plan_bytes;
            inner.ended_plan_bytes += bytes;
            inner.ended.push_back(job);
            inner.forget_surplus(self.retention);
        }
        Ok(event)
    }

    fn record(&self, job: JobId) -> Result<JobRecord, StoreError> {
        Ok(self.lock().entry(job)?.record.clone())
    }

    fn list(&self, before: Option<JobId>, limit: usize) -> Result<Vec<JobRecord>, StoreError> {
        let inner = self.lock();
        let older = inner.jobs.iter().rev().filter(|(id, _)| before.is_none_or(|before| **id < before));
        Ok(older.take(limit).map(|(_, entry)| entry.record.clone()).collect())
    }

    fn events_after(&self, job: JobId, after: u64, limit: usize) -> Result<Vec<Arc<Event>>, StoreError> {
        let inner = self.lock();
        // Event number n stands at place n - 1.
        let first = usize::try_from(after).unwrap_or(usize::MAX);
        Ok(inner.entry(job)?.events.iter().skip(first).take(limit).cloned().collect())
    }

    fn solution(&self, job: JobId, revision: Revision) -> Result<Option<Incumbent>, StoreError> {
        let inner = self.lock();
        let mut incumbents = inner.entry(job)?.events.iter().rev().filter_map(|event| match &event.body {
            EventBody::Incumbent(incumbent) => Some(incumbent),
            _ => None,
        });
        Ok(match revision {
            Revision::Best => incumbents.next(),
            Revision::Number(number) => incumbents.find(|incumbent| incumbent.revision == number),
        }
        .cloned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{JobState, Terminal, TerminationReason};
    use crate::plan::{Metrics, StepsProof};

    fn metrics() -> Metrics {
        Metrics {
            duration_s: 2.0,
            duration_synchronous_s: 2.0,
            arc_length: 1.0,
            actions: 2,
            steps: 2,
            mode_graph_optimum: None,
            steps_lower_bound: 2,
            steps_proof: StepsProof::None,
            found_after_s: 0.1,
        }
    }

    fn incumbent(revision: u64, bytes: usize) -> EventBody {
        EventBody::Incumbent(Incumbent { revision, metrics: metrics(), document: "x".repeat(bytes).into() })
    }

    fn end() -> EventBody {
        let reason = TerminationReason::TimeLimit;
        EventBody::Terminal(Terminal { reason, metrics: None, diagnosis: None })
    }

    fn started(store: &MemoryStore) -> JobId {
        let id = JobId::fresh();
        let at = Timestamp::now();
        store.create(NewJob { id, created_at: at }).unwrap();
        store.append(id, at, EventBody::Queued { position: 1 }).unwrap();
        store.append(id, at, EventBody::Started).unwrap();
        id
    }

    #[test]
    fn events_are_numbered_without_gaps_and_the_record_is_their_fold() {
        let store = MemoryStore::default();
        let at = Timestamp::now();
        let id = started(&store);
        store.append(id, at, incumbent(1, 3)).unwrap();
        store.append(id, at, incumbent(2, 3)).unwrap();
        store.append(id, at, end()).unwrap();
        let events = store.events_after(id, 0, 100).unwrap();
        assert_eq!(events.iter().map(|event| event.seq).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
        assert_eq!(store.events_after(id, 3, 1).unwrap()[0].seq, 4);
        assert!(store.events_after(id, u64::MAX, 1).unwrap().is_empty());
        let mut folded = JobRecord::new(id, at);
        events.iter().for_each(|event| folded.apply(event));
        let kept = store.record(id).unwrap();
        assert_eq!(format!("{folded:?}"), format!("{:?}", JobRecord { created_at: at, ..kept.clone() }));
        assert_eq!((kept.state, kept.last_seq), (JobState::Succeeded, 5));
        assert_eq!(store.solution(id, Revision::Best).unwrap().unwrap().revision, 2);
        assert_eq!(store.solution(id, Revision::Number(1)).unwrap().unwrap().revision, 1);
        assert!(store.solution(id, Revision::Number(3)).unwrap().is_none());
    }

    #[test]
    fn nothing_follows_the_end_and_nothing_comes_out_of_turn() {
        let store = MemoryStore::default();
        let at = Timestamp::now();
        let id = started(&store);
        for body in [EventBody::Started, EventBody::Queued { position: 1 }] {
            assert!(matches!(store.append(id, at, body), Err(StoreError::OutOfTurn { .. })));
        }
        store.append(id, at, incumbent(2, 1)).unwrap();
        assert!(matches!(store.append(id, at, incumbent(2, 1)), Err(StoreError::OutOfTurn { .. })));
        store.append(id, at, end()).unwrap();
        for body in [end(), incumbent(3, 1), EventBody::Started] {
            assert!(matches!(store.append(id, at, body), Err(StoreError::OutOfTurn { .. })));
        }
        let stranger = JobId::fresh();
        assert_eq!(store.append(stranger, at, end()).unwrap_err(), StoreError::UnknownJob(stranger));
    }

    #[test]
    fn ended_jobs_are_forgotten_oldest_first_and_running_ones_never() {
        let store = MemoryStore::new(Retention { jobs: 3, plan_bytes: 100 });
        let at = Timestamp::now();
        let running = started(&store);
        let ended: Vec<JobId> = (0..5)
            .map(|_| {
                let id = started(&store);
                store.append(id, at, incumbent(1, 40)).unwrap();
                store.append(id, at, end()).unwrap();
                id
            })
            .collect();
        // Three by number, two by bytes.
        let kept: Vec<JobId> = store.list(None, 10).unwrap().iter().map(|record| record.id).collect();
        assert_eq!(kept, [ended[4], ended[3], running]);
        assert_eq!(store.list(Some(ended[3]), 10).unwrap().len(), 1);
    }
}
