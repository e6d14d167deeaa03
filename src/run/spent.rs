//! Where the time of a run goes.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A part of a run whose time is told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Solving for the guidance, by whatever means.
    Guidance,
    /// The solver of integer programs (HiGHS) within that.
    IntegerProgram,
}

/// Time that the threads of a run have spent in its parts; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Spent(Arc<[Spending; 2]>);

#[derive(Debug, Default)]
struct Spending {
    nanoseconds: AtomicU64,
    times: AtomicU64,
}

impl Spent {
    fn part(&self, part: Part) -> &Spending {
        let [guidance, program] = &*self.0;
        match part {
            Part::Guidance => guidance,
            Part::IntegerProgram => program,
        }
    }

    /// Does `work`, and counts its time as spent in `part`.
    pub fn during<T>(&self, part: Part, work: impl FnOnce() -> T) -> T {
        let began = Instant::now();
        let done = work();
        let took = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.part(part).nanoseconds.fetch_add(took, Ordering::Relaxed);
        self.part(part).times.fetch_add(1, Ordering::Relaxed);
        done
    }

    /// The time in `part`, summed over all threads.
    pub fn time(&self, part: Part) -> Duration {
        Duration::from_nanos(self.part(part).nanoseconds.load(Ordering::Relaxed))
    }

    /// How often `part` was entered.
    pub fn times(&self, part: Part) -> u64 {
        self.part(part).times.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_what_is_spent_and_parts_do_not() {
        let spent = Spent::default();
        let other = spent.clone();
        let pause = Duration::from_millis(2);
        assert_eq!(
            other.during(Part::Guidance, || {
                std::thread::sleep(pause);
                7
            }),
            7
        );
        assert_eq!((spent.times(Part::Guidance), spent.times(Part::IntegerProgram)), (1, 0));
        assert!(spent.time(Part::Guidance) >= pause);
        assert!(spent.time(Part::IntegerProgram).is_zero());
    }
}
