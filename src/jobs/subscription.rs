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
/// A reader that finds more unread incumbents than this is slow, and gets only the newest of them.
const MOST_UNREAD_INCUMBENTS: usize = 16;

/// An event on its way to one reader.
#[derive(Debug, Clone)]
pub struct Delivery {
    /// The event.
    pub event: Arc<Event>,
    /// How many incumbents before it were left out because the reader is slow.
    pub skipped: u64,
}

/// One reader's view of a job: every durable event in order, each once, and signs of life between
/// them. Ends after the terminal event. A [`Snapshot`] comes first in place of what is kept no longer. Events that were there when the reader came are replayed
/// without gaps; of later incumbents a slow reader gets the newest.
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
    ready: VecDeque<Delivery>,
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
        self.ready = conflate(events, self.replay_until);
        if let Some(event) = gap {
            self.ready.push_front(Delivery { event, skipped: 0 });
        }
    }
}

impl Subscription {
    /// Stands in for events up to number `seq`, which are kept no longer.
    fn snapshot(&self, seq: u64) -> Option<Arc<Event>> {
        let record = self.store.record(self.job).ok()?;
        let metrics = record.best.map(|best| best.metrics);
        let body = EventBody::Snapshot(Snapshot { state: record.state, metrics });
        Some(Arc::new(Event { seq, job: self.job, attempt: record.attempt, at: Timestamp::now(), body }))
    }
}

/// Leaves out all but the newest of the incumbents numbered above `replay_until`, if they are many.
fn conflate(events: Vec<Arc<Event>>, replay_until: u64) -> VecDeque<Delivery> {
    let may_go = |event: &Event| event.seq > replay_until && matches!(event.body, EventBody::Incumbent(_));
    let unread = events.iter().filter(|event| may_go(event)).count();
    let mut to_skip = if unread > MOST_UNREAD_INCUMBENTS { unread - 1 } else { 0 };
    let mut skipped = 0;
    let mut deliveries = VecDeque::with_capacity(events.len() - to_skip);
    for event in events {
        let incumbent = may_go(&event);
        if incumbent && to_skip > 0 {
            to_skip -= 1;
            skipped += 1;
            continue;
        }
        let skipped = if incumbent { std::mem::take(&mut skipped) } else { 0 };
        deliveries.push_back(Delivery { event, skipped });
    }
    deliveries
}

impl Stream for Subscription {
    type Item = Delivery;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Delivery>> {
        let this = &mut *self;
        if this.ready.is_empty() && !this.ended {
            this.live.wait(this.reader, context.waker());
            this.fetch();
        }
        if let Some(delivery) = this.ready.pop_front() {
            this.ended |= matches!(delivery.event.body, EventBody::Terminal(_));
            return Poll::Ready(Some(delivery));
        }
        if this.ended {
            return Poll::Ready(None);
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
    use super::*;
    use crate::jobs::{Incumbent, Timestamp};
    use crate::plan::{Metrics, StepsProof};

    fn events(count: u64) -> Vec<Arc<Event>> {
        let job = JobId::fresh();
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
        let incumbent = |revision| Incumbent { revision, metrics: metrics.clone(), document: "{}".into() };
        (1..=count)
            .map(|seq| {
                let body =
                    if seq == 1 { EventBody::Started } else { EventBody::Incumbent(incumbent(seq - 1)) };
                Arc::new(Event { seq, job, attempt: 1, at: Timestamp::now(), body })
            })
            .collect()
    }

    #[test]
    fn a_reader_that_keeps_up_misses_nothing() {
        let deliveries = conflate(events(10), 0);
        assert_eq!(deliveries.len(), 10);
        assert!(deliveries.iter().all(|delivery| delivery.skipped == 0));
    }

    #[test]
    fn a_slow_reader_gets_the_newest_and_the_count_of_the_rest() {
        let deliveries = conflate(events(40), 0);
        let seen: Vec<(u64, u64)> = deliveries.iter().map(|d| (d.event.seq, d.skipped)).collect();
        assert_eq!(seen, [(1, 0), (40, 38)]);
    }

    #[test]
    fn replay_has_no_gaps() {
        assert_eq!(conflate(events(40), 40).len(), 40);
        let deliveries = conflate(events(40), 10);
        assert_eq!(deliveries.len(), 11);
        assert_eq!(deliveries[10].skipped, 29);
    }
}
