//! The thread that minds the clock: signs of life for what runs, the end of what waited too long,
//! and the end of what was kept long enough.

use std::time::{Duration, Instant};

use super::pool::Shared;
use super::{Lease, StoreError, TerminationReason, Timestamp};

/// How often old jobs are looked for, and jobs of lost workers.
const SWEEP: Duration = Duration::from_secs(30);
/// Longest time between two looks at the clock.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

impl Shared {
    /// Runs until the service stops.
    pub(super) fn keep(&self) {
        let renewal = self.config.lease / 3;
        let (mut renewed, mut swept) = (Instant::now(), Instant::now());
        loop {
            let mut queue = self.queue();
            if queue.stopping {
                return;
            }
            let now = Timestamp::now();
            let next = queue.next_expiry().map_or(LONGEST_WAIT, |at| at.since(now)).min(LONGEST_WAIT);
            if !next.is_zero() {
                let wait = next.min(renewal).max(Duration::from_millis(1));
                let (woken, _) =
                    self.kept.wait_timeout(queue, wait).unwrap_or_else(std::sync::PoisonError::into_inner);
                queue = woken;
            }
            if queue.stopping {
                return;
            }
            let expired = queue.take_expired(Timestamp::now());
            let leases: Vec<Lease> = queue.running.values().filter_map(|running| running.lease).collect();
            drop(queue);
            for job in expired {
                let diagnosis = "it waited longer than `queue_ttl_s` allows".to_owned();
                self.end(job, None, TerminationReason::QueueTimeout, Some(diagnosis));
            }
            if renewed.elapsed() >= renewal {
                renewed = Instant::now();
                self.renew(&leases);
            }
            if swept.elapsed() >= SWEEP {
                swept = Instant::now();
                if let Err(error) = self.sweep() {
                    tracing::error!(%error, "old jobs could not be looked for");
                }
            }
        }
    }

    fn renew(&self, leases: &[Lease]) {
        let now = Timestamp::now();
        for lease in leases {
            match self.parts.store.renew(*lease, now, now.plus(self.config.lease)) {
                // It has ended meanwhile.
                Ok(()) | Err(StoreError::UnknownJob(_)) => {}
                Err(StoreError::Fenced { job, .. }) => {
                    // Someone else has it: what is done here is in vain.
                    if let Some(running) = self.queue().running.get(&job) {
                        running.control.cancel.cancel();
                    }
                }
                Err(error) => tracing::error!(job = %lease.job, %error, "no sign of life could be left"),
            }
        }
    }

    fn sweep(&self) -> Result<(), StoreError> {
        self.parts.store.sweep(Timestamp::now())?;
        for record in self.retry_lost()? {
            self.live().entry(record.id).or_default();
            self.queue().push(&record, None, self.config.aging);
            self.changed.notify_one();
        }
        Ok(())
    }
}
