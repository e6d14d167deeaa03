//! Following one job's events.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use futures::Stream;

use super::live::Live;
use super::{Event, EventBody, JobId, JobRecord, JobStore, Snapshot, Timestamp};

/// How many events are fetched at once.
const BATCH: usize = 256;
/// A reader that has more unread incumbents than this is slow, and gets only the newest of them.
const MOST_UNREAD_INCUMBENTS: u64 = 16;

/// An event on its way to one reader.
#[derive(Debug, Clone)]
pub struct Delivery {
    /// The event.
    pub event: Arc<Event>,
    /// How many incumbents before it were left out because the reader is slow.
    pub skipped: u64,
}

/// One reader's view of a job: every durable event in order, each once, and signs of life between
/// them. Ends after the terminal event. A [`Snapshot`] comes first in place of what is kept no longer.
/// Events that were there when the reader came are replayed without gaps; of later incumbents a slow
/// reader gets the newest.
///
/// Dropping it does nothing to the job.
pub struct Subscription {
    job: JobId,
    store: Arc<dyn JobStore>,
    live: Arc<Live>,
    reader: u64,
    /// Number of the last event taken from the store.
    last: u64,
    /// Events up to this number are never left out.
    replay_until: u64,
    /// Whether it began beyond the last event that there was: then it may never see the end.
    ahead: bool,
    progress_seen: u64,
    ready: VecDeque<Arc<Event>>,
    /// The revision that was the newest when the reader was found to be slow: older ones are left out.
    heading_for: u64,
    /// How many have been left out since the last incumbent that was delivered.
    skipped: u64,
    ended: bool,
}

impl Subscription {
    pub(super) fn new(
        job: JobId,
        store: Arc<dyn JobStore>,
        live: Arc<Live>,
        after: u64,
        replay_until: u64,
    ) -> Self {
        let reader = live.enter();
        Self {
            job,
            store,
            live,
            reader,
            last: after,
            replay_until,
            ahead: after > replay_until,
            progress_seen: 0,
            ready: VecDeque::new(),
            heading_for: 0,
            skipped: 0,
            ended: false,
        }
    }

    /// Moves what has happened since the last look into `ready`.
    fn fetch(&mut self) {
        let Ok(events) = self.store.events_after(self.job, self.last, BATCH) else {
            // The job has been forgotten meanwhile: there is nothing more to tell.
            self.ended = true;
            return;
        };
        let (Some(oldest), Some(newest)) = (events.first(), events.last()) else {
            let ended = |record: JobRecord| record.state.is_terminal() && record.last_seq <= self.last;
            self.ended = self.ahead && self.store.record(self.job).is_ok_and(ended);
            return;
        };
        self.ahead = false;
        let gap = (oldest.seq > self.last + 1).then(|| self.snapshot(oldest.seq - 1)).flatten();
        self.last = newest.seq;
        self.ready = events.into();
        if let Some(event) = gap {
            self.ready.push_front(event);
        }
    }

    /// The event as the reader gets it; `None` when it is left out.
    fn deliver(&mut self, event: Arc<Event>) -> Option<Delivery> {
        let EventBody::Incumbent(incumbent) = &event.body else {
            return Some(Delivery { event, skipped: 0 });
        };
        let revision = incumbent.revision;
        if event.seq <= self.replay_until {
            return Some(Delivery { event, skipped: 0 });
        }
        // The one that it was heading for is delivered even if there are many newer ones by now: the
        // slowest reader gets on.
        if revision > self.heading_for && self.newest().saturating_sub(revision) >= MOST_UNREAD_INCUMBENTS {
            self.heading_for = self.newest();
        }
        if revision < self.heading_for {
            self.skipped += 1;
            return None;
        }
        Some(Delivery { event, skipped: std::mem::take(&mut self.skipped) })
    }

    /// The job's newest revision.
    fn newest(&self) -> u64 {
        let best = self.store.record(self.job).ok().and_then(|record| record.best);
        best.map_or(0, |best| best.revision)
    }

    /// Stands in for events up to number `seq`, which are kept no longer.
    fn snapshot(&self, seq: u64) -> Option<Arc<Event>> {
        let record = self.store.record(self.job).ok()?;
        let metrics = record.best.map(|best| best.metrics);
        let body = EventBody::Snapshot(Snapshot { state: record.state, metrics });
        Some(Arc::new(Event { seq, job: self.job, attempt: record.attempt, at: Timestamp::now(), body }))
    }
}

impl Stream for Subscription {
    type Item = Delivery;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Delivery>> {
        let this = &mut *self;
        if this.ready.is_empty() && !this.ended {
            this.live.wait(this.reader, context.waker());
            this.fetch();
        }
        let mut left_out = false;
        while let Some(event) = this.ready.pop_front() {
            if let Some(delivery) = this.deliver(event) {
                this.ended |= matches!(delivery.event.body, EventBody::Terminal(_));
                return Poll::Ready(Some(delivery));
            }
            left_out = true;
        }
        if this.ended {
            return Poll::Ready(None);
        }
        if left_out {
            // There is more; but others get a turn before it is read.
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        if let Some((number, event)) = this.live.progress_after(this.progress_seen) {
            this.progress_seen = number;
            // A sign of life from before what the reader has seen is stale.
            if event.seq >= this.last {
                return Poll::Ready(Some(Delivery { event, skipped: 0 }));
            }
        }
        Poll::Pending
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.live.leave(self.reader);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use futures::executor::block_on;
    use futures::{FutureExt, StreamExt};

    use super::*;
    use crate::jobs::{
        EmbeddedStore, Incumbent, JobRequest, Lease, NewJob, Retention, RetryCause, Retrying, Terminal,
        TerminationReason,
    };
    use crate::plan::{Metrics, StepsProof};

    /// Plans of which a few fill a batch.
    const LARGE: usize = 200_000;

    /// A job that runs, with its events 1 and 2.
    struct Running {
        store: Arc<EmbeddedStore>,
        lease: Lease,
        revision: u64,
    }

    impl Running {
        fn new() -> Self {
            let store = Arc::new(EmbeddedStore::in_memory(Retention::default()).unwrap());
            let at = Timestamp::now();
            let job =
                NewJob { id: JobId::fresh(), created_at: at, position: 1, request: JobRequest::default() };
            let id = store.create(job).unwrap().id;
            let lease = store.lease(id, at, at).unwrap();
            let mut running = Self { store, lease, revision: 0 };
            running.append(EventBody::Started);
            running
        }

        fn append(&mut self, body: EventBody) {
            self.store.append(self.lease.job, Some(self.lease), Timestamp::now(), body).unwrap();
        }

        fn plans(&mut self, count: u64, bytes: usize) {
            let metrics = Metrics {
                duration_s: 2.0,
                duration_synchronous_s: 2.0,
                arc_length: 1.0,
                actions: 2,
                steps: 2,
                mode_graph_optimum: None,
                steps_lower_bound: 2,
                steps_proof: StepsProof::None,
                found_after_s: 0.1,
            };
            for _ in 0..count {
                self.revision += 1;
                let document = "x".repeat(bytes).into();
                self.append(EventBody::Incumbent(Incumbent {
                    revision: self.revision,
                    metrics: metrics.clone(),
                    document,
                }));
            }
        }

        fn begin_again(&mut self) {
            let attempt = self.lease.attempt + 1;
            let cause = RetryCause::Shutdown;
            self.append(EventBody::Retrying(Retrying { attempt, cause, spent: Duration::ZERO }));
            let now = Timestamp::now();
            self.lease = self.store.lease(self.lease.job, now, now).unwrap();
            self.append(EventBody::Started);
        }

        fn end(&mut self) {
            let reason = TerminationReason::TimeLimit;
            self.append(EventBody::Terminal(Terminal { reason, metrics: None, diagnosis: None }));
        }

        /// A reader who comes now and has seen all up to `after`.
        fn reader(&self, after: u64) -> Subscription {
            let newest = self.store.record(self.lease.job).unwrap().last_seq;
            let store: Arc<dyn JobStore> = Arc::clone(&self.store) as Arc<dyn JobStore>;
            Subscription::new(self.lease.job, store, Arc::default(), after, newest)
        }
    }

    fn seen(delivery: &Delivery) -> (u64, u64) {
        (delivery.event.seq, delivery.skipped)
    }

    /// Numbers and left-out incumbents of the next so many events.
    fn next(reader: &mut Subscription, count: usize) -> Vec<(u64, u64)> {
        block_on(reader.take(count).map(|delivery| seen(&delivery)).collect())
    }

    #[test]
    fn a_reader_that_keeps_up_misses_nothing() {
        let mut job = Running::new();
        let mut reader = job.reader(0);
        assert_eq!(next(&mut reader, 2), [(1, 0), (2, 0)]);
        let mut seq = 2;
        for count in [1, 16, 5, 16] {
            job.plans(count, LARGE);
            let expected: Vec<_> = (seq + 1..=seq + count).map(|seq| (seq, 0)).collect();
            assert_eq!(next(&mut reader, count as usize), expected);
            seq += count;
        }
        assert!(reader.next().now_or_never().is_none());
        job.end();
        assert_eq!(next(&mut reader, 9), [(seq + 1, 0)]);
    }

    #[test]
    fn a_slow_reader_gets_the_newest_and_the_count_of_the_rest_however_large_they_are() {
        for bytes in [1, LARGE] {
            let mut job = Running::new();
            let mut reader = job.reader(2);
            job.plans(100, bytes);
            assert_eq!(next(&mut reader, 1), [(102, 99)], "{bytes}");
            job.plans(5, bytes);
            let expected: Vec<_> = (103..=107).map(|seq| (seq, 0)).collect();
            assert_eq!(next(&mut reader, 5), expected, "{bytes}");
            job.plans(40, bytes);
            job.end();
            assert_eq!(next(&mut reader, 9), [(147, 39), (148, 0)], "{bytes}");
        }
    }

    #[test]
    fn what_is_no_incumbent_is_never_left_out() {
        let mut job = Running::new();
        let mut reader = job.reader(0);
        job.plans(20, LARGE);
        job.begin_again();
        job.plans(20, LARGE);
        job.end();
        assert_eq!(next(&mut reader, 9), [(1, 0), (2, 0), (23, 0), (24, 0), (44, 39), (45, 0)]);
    }

    #[test]
    fn a_reader_gets_on_while_the_newest_moves_away() {
        let mut job = Running::new();
        let mut reader = job.reader(2);
        job.plans(40, LARGE);
        assert!(reader.next().now_or_never().is_none(), "a batch is left out, and the next comes later");
        job.plans(40, LARGE);
        assert_eq!(next(&mut reader, 2), [(42, 39), (82, 39)]);
    }

    #[test]
    fn replay_has_no_gaps() {
        let mut job = Running::new();
        job.plans(30, LARGE);
        let mut early = job.reader(0);
        job.plans(30, LARGE);
        let expected: Vec<_> = (1..=62).map(|seq| (seq, 0)).collect();
        assert_eq!(next(&mut job.reader(0), 62), expected);
        assert_eq!(next(&mut job.reader(60), 2), [(61, 0), (62, 0)]);
        // What came later may go, what was there may not.
        let expected: Vec<_> = (1..=32).map(|seq| (seq, 0)).chain([(62, 29)]).collect();
        assert_eq!(next(&mut early, 33), expected);
    }
}
