//! Deadlines and cancellation.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::Spent;

/// A point in time after which a run must end, and the clock that started with the run.
#[derive(Debug, Clone, Copy)]
pub struct Deadline {
    started: Instant,
    at: Option<Instant>,
}

impl Deadline {
    /// Starts the clock now; the run must end `budget` later.
    pub fn after(budget: Duration) -> Self {
        let started = Instant::now();
        Self { started, at: started.checked_add(budget) }
    }

    /// A clock that reads `spent` now; the run must end when it reads `budget`.
    pub fn resumed(spent: Duration, budget: Duration) -> Self {
        let now = Instant::now();
        let started = now.checked_sub(spent).unwrap_or(now);
        Self { started, at: now.checked_add(budget.saturating_sub(spent)) }
    }

    /// Starts the clock now, with no end.
    pub fn never() -> Self {
        Self { started: Instant::now(), at: None }
    }

    /// Seconds since the clock started.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Whether the end has come.
    pub fn passed(&self) -> bool {
        self.at.is_some_and(|at| Instant::now() >= at)
    }

    /// Time left; `None` without an end, zero once it has come.
    pub fn remaining(&self) -> Option<Duration> {
        self.at.map(|at| at.saturating_duration_since(Instant::now()))
    }
}

/// A flag that anyone may raise to stop a run; clones share it.
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// A token that nobody has raised.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the run to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether someone asked the run to stop.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Deadline and cancellation together: every loop of the planner asks [`Control::should_stop`].
#[derive(Debug, Clone)]
pub struct Control {
    /// When the run must end.
    pub deadline: Deadline,
    /// Who may end it earlier.
    pub cancel: CancelToken,
    /// Where its time goes.
    pub spent: Spent,
}

impl Control {
    /// A run that ends at `deadline`, or when `cancel` is raised.
    pub fn new(deadline: Deadline, cancel: CancelToken) -> Self {
        Self { deadline, cancel, spent: Spent::default() }
    }

    /// A run of at most `budget` from now on.
    pub fn with_budget(budget: Duration) -> Self {
        Self::new(Deadline::after(budget), CancelToken::new())
    }

    /// A run that ends only by itself or by cancellation.
    pub fn unbounded() -> Self {
        Self::new(Deadline::never(), CancelToken::new())
    }

    /// The same run, of which a part has to end within `most` from now.
    pub fn within(&self, most: Duration) -> Self {
        let part = Instant::now().checked_add(most);
        let at = [self.deadline.at, part].into_iter().flatten().min();
        Self { deadline: Deadline { at, ..self.deadline }, ..self.clone() }
    }

    /// Whether the run must stop now.
    pub fn should_stop(&self) -> bool {
        self.cancel.is_cancelled() || self.deadline.passed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_ends_with_the_run_at_the_latest() {
        let second = Duration::from_secs(1);
        let run = Control::with_budget(10 * second);
        assert!(run.within(second).deadline.remaining().unwrap() <= second);
        assert!(run.within(60 * second).deadline.remaining().unwrap() <= 10 * second);
        assert!(Control::unbounded().within(second).deadline.remaining().unwrap() <= second);
        let part = run.within(second);
        run.cancel.cancel();
        assert!(part.should_stop() && !Control::unbounded().within(60 * second).should_stop());
    }
}
