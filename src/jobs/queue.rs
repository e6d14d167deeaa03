//! The queue in front of the planner threads: bounded, fair to clients, ordered by priority and age.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::plan::Plan;
use crate::problem::Problem;
use crate::run::Control;

use super::{JobId, JobRecord, JobsConfig, Lease, Timestamp};

/// The queue does not take a job now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum QueueRefusal {
    /// As many jobs wait as may.
    #[error("{limit} jobs are waiting already; try again in {retry_after_s} s")]
    Full {
        /// How many may wait.
        limit: usize,
        /// When a place may be free (s).
        retry_after_s: u64,
    },
    /// The client has as many jobs as it may.
    #[error("you have {limit} jobs that wait or run already; try again in {retry_after_s} s")]
    ClientFull {
        /// How many it may have.
        limit: usize,
        /// When a place may be free (s).
        retry_after_s: u64,
    },
    /// The service is about to end.
    #[error("the service is shutting down")]
    Stopping,
}

/// Where a job stands. It is the instant of its arrival, moved ahead by the aging time for each
/// step of priority: so an urgent job overtakes those that came shortly before it, and none waits
/// for ever, because nobody overtakes what has waited longer than the priorities differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    virtual_arrival_ms: i64,
    job: JobId,
}

impl Place {
    fn new(record: &JobRecord, aging: Duration) -> Self {
        let arrival = i64::try_from(record.created_at.unix_millis()).unwrap_or(i64::MAX);
        let aging = i64::try_from(aging.as_millis()).unwrap_or(i64::MAX);
        let ahead = i64::from(record.priority).saturating_mul(aging);
        Self { virtual_arrival_ms: arrival.saturating_sub(ahead), job: record.id }
    }
}

/// What a planner thread needs, when this process has it at hand.
pub(super) struct Ready {
    pub problem: Problem,
    pub warm_start: Option<Plan>,
    /// What the client's wait has used of the time budget already.
    pub spent: Duration,
}

/// A job that waits.
pub(super) struct Waiting {
    pub job: JobId,
    pub client: String,
    pub expires_at: Option<Timestamp>,
    /// `None` for a job of an earlier process.
    pub ready: Option<Box<Ready>>,
}

/// A job that a planner thread works on.
pub(super) struct Running {
    pub control: Control,
    pub client: String,
    pub since: Timestamp,
    /// Once the store has given it.
    pub lease: Option<Lease>,
    /// Whether a client, and not the end of the process, has raised the token.
    pub cancelled: bool,
}

#[derive(Default)]
pub(super) struct Queue {
    waiting: BTreeMap<Place, Waiting>,
    places: BTreeMap<JobId, Place>,
    pub running: BTreeMap<JobId, Running>,
    /// Places promised to jobs that are being validated, by client.
    reserved: BTreeMap<String, usize>,
    pub stopping: bool,
}

impl Queue {
    /// Promises a place to `client`.
    pub fn reserve(&mut self, client: &str, config: &JobsConfig) -> Result<(), QueueRefusal> {
        if self.stopping {
            return Err(QueueRefusal::Stopping);
        }
        let promised: usize = self.reserved.values().sum();
        let retry_after_s = self.retry_after_s();
        if self.running.len() + self.waiting.len() + promised >= config.workers + config.queue_limit {
            return Err(QueueRefusal::Full { limit: config.queue_limit, retry_after_s });
        }
        if self.of_client(client) >= config.client_limit {
            return Err(QueueRefusal::ClientFull { limit: config.client_limit, retry_after_s });
        }
        *self.reserved.entry(client.to_owned()).or_default() += 1;
        Ok(())
    }

    /// Takes a promise back.
    pub fn release(&mut self, client: &str) {
        if let Some(count) = self.reserved.get_mut(client) {
            *count -= 1;
            if *count == 0 {
                self.reserved.remove(client);
            }
        }
    }

    fn of_client(&self, client: &str) -> usize {
        self.reserved.get(client).copied().unwrap_or(0)
            + self.waiting.values().filter(|waiting| waiting.client == client).count()
            + self.running.values().filter(|running| running.client == client).count()
    }

    pub fn push(&mut self, record: &JobRecord, ready: Option<Box<Ready>>, aging: Duration) {
        let place = Place::new(record, aging);
        self.places.insert(record.id, place);
        let (client, expires_at) = (record.client.clone(), record.expires_at());
        self.waiting.insert(place, Waiting { job: record.id, client, expires_at, ready });
    }

    pub fn pop(&mut self) -> Option<Waiting> {
        let (place, waiting) = self.waiting.pop_first()?;
        self.places.remove(&place.job);
        Some(waiting)
    }

    pub fn remove(&mut self, job: JobId) -> Option<Waiting> {
        self.waiting.remove(&self.places.remove(&job)?)
    }

    /// The job's place; 1 is next.
    pub fn position(&self, job: JobId) -> Option<usize> {
        let place = self.places.get(&job)?;
        Some(self.waiting.range(..=*place).count())
    }

    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Removes what has waited too long.
    pub fn take_expired(&mut self, now: Timestamp) -> Vec<JobId> {
        let late = |waiting: &&Waiting| waiting.expires_at.is_some_and(|at| at <= now);
        let expired: Vec<JobId> = self.waiting.values().filter(late).map(|waiting| waiting.job).collect();
        expired.iter().for_each(|job| {
            self.remove(*job);
        });
        expired
    }

    /// When the next job expires.
    pub fn next_expiry(&self) -> Option<Timestamp> {
        self.waiting.values().filter_map(|waiting| waiting.expires_at).min()
    }

    /// When a running job's budget ends, at the latest.
    fn retry_after_s(&self) -> u64 {
        let left = self.running.values().filter_map(|running| running.control.deadline.remaining());
        left.min().map_or(1, |left| left.as_secs() + 1).clamp(1, 60)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{JobRequest, NewJob};

    const AGING: Duration = Duration::from_secs(30);

    fn record(created_at_ms: u64, priority: i32) -> JobRecord {
        JobRecord::new(&NewJob {
            id: JobId::fresh(),
            created_at: Timestamp::from_unix_millis(created_at_ms),
            position: 1,
            request: JobRequest { priority, ..JobRequest::default() },
        })
    }

    fn order(records: &[&JobRecord]) -> Vec<JobId> {
        let mut queue = Queue::default();
        records.iter().for_each(|record| queue.push(record, None, AGING));
        for (index, record) in records.iter().enumerate() {
            assert!((1..=records.len()).contains(&queue.position(record.id).unwrap()), "{index}");
        }
        std::iter::from_fn(|| queue.pop().map(|waiting| waiting.job)).collect()
    }

    #[test]
    fn equals_go_in_the_order_of_arrival_and_urgent_ones_first() {
        let (first, second, urgent) = (record(1000, 0), record(1001, 0), record(2000, 1));
        assert_eq!(order(&[&second, &urgent, &first]), [urgent.id, first.id, second.id]);
    }

    #[test]
    fn nobody_starves() {
        // A stream of urgent jobs, one a second: the old one is overtaken by what comes within ten
        // steps of aging, and by nothing after.
        let old = record(0, 0);
        let urgent: Vec<JobRecord> = (0..1000).map(|second| record(second * 1000, 10)).collect();
        let all: Vec<&JobRecord> = std::iter::once(&old).chain(&urgent).collect();
        let place = order(&all).iter().position(|job| *job == old.id).unwrap();
        assert_eq!(place, 300);
    }

    #[test]
    fn a_client_takes_no_more_than_its_share() {
        let config = JobsConfig { workers: 1, queue_limit: 9, client_limit: 2, ..JobsConfig::default() };
        let mut queue = Queue::default();
        queue.reserve("a", &config).unwrap();
        queue.reserve("a", &config).unwrap();
        let refused = queue.reserve("a", &config).unwrap_err();
        assert!(matches!(refused, QueueRefusal::ClientFull { limit: 2, .. }));
        queue.reserve("b", &config).unwrap();
        queue.release("a");
        queue.reserve("a", &config).unwrap();
    }
}
