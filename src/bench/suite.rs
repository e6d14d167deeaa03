//! All runs, one after the other.

use std::collections::BTreeSet;

use crate::problem::GuidanceKind;
use crate::run::{CancelToken, Deadline};

use super::machine::ThreadTimes;
use super::results::{Remark, Results, Run, RunKey, Setup};
use super::run::{BenchError, RunSettings, measure};
use super::selection::{Case, guidance_name};

/// What is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Suite {
    /// Families and sizes.
    pub cases: Vec<Case>,
    /// Guidances; within a trial they run right after each other, so that what else the machine does
    /// strikes them alike.
    pub guidances: Vec<GuidanceKind>,
    /// Trials of each.
    pub trials: u64,
    /// What holds for all runs.
    pub settings: RunSettings,
}

impl Suite {
    /// How many runs it has.
    pub fn len(&self) -> usize {
        self.cases.len() * self.guidances.len() * self.trials as usize
    }

    /// Whether there is nothing to measure.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What its results say was asked for.
    pub fn setup(&self) -> Setup {
        Setup {
            trials: self.trials,
            budget_s: self.settings.budget.as_secs_f64(),
            threads: self.settings.threads,
            workcell: self.settings.workcell,
            first_solution: self.settings.first_solution,
        }
    }
}

/// What is told while the runs go on.
#[derive(Debug)]
pub enum Notice<'a> {
    /// A run is under way.
    Running {
        /// Its family and size.
        case: Case,
        /// Its guidance.
        guidance: GuidanceKind,
        /// Its trial.
        trial: u64,
        /// Seconds since it started.
        elapsed_s: f64,
        /// Runs that are done.
        done: usize,
        /// All runs.
        total: usize,
        /// Seconds until all runs are done, as far as the runs so far tell.
        left_s: f64,
    },
    /// All runs of a case are done; all results so far.
    CaseDone {
        /// The case.
        case: Case,
        /// Results that hold all that was measured.
        results: &'a Results,
    },
}

/// Runs what of `suite` is not in `results` yet and adds it there, until `cancel` is raised; whether
/// all was run. A run that was cut short is not counted.
///
/// # Errors
/// What stops `observe`, or [`BenchError`] when a problem cannot be made.
pub fn run_suite<E: From<BenchError> + Send>(
    suite: &Suite,
    results: &mut Results,
    cancel: &CancelToken,
    observe: &mut (dyn FnMut(Notice<'_>) -> Result<(), E> + Send),
) -> Result<bool, E> {
    let known: BTreeSet<RunKey> = results.runs.iter().map(Run::key).collect();
    let clock = Deadline::never();
    let mut times = ThreadTimes::default();
    let mut progress =
        Progress { done: 0, measured: 0, total: suite.len(), budget_s: suite.setup().budget_s };
    for &case in &suite.cases {
        for trial in 0..suite.trials {
            for &guidance in &suite.guidances {
                if known.contains(&key(case, guidance, trial)) {
                    progress.done += 1;
                    continue;
                }
                let mut stopped = Ok(());
                let mut running = |elapsed_s: f64| {
                    let notice = Notice::Running {
                        case,
                        guidance,
                        trial,
                        elapsed_s,
                        done: progress.done,
                        total: progress.total,
                        left_s: progress.left_s(clock.elapsed_s(), elapsed_s),
                    };
                    if stopped.is_ok() {
                        stopped = observe(notice);
                    }
                };
                running(0.0);
                let before = ThreadTimes::now();
                let measured = measure(case, guidance, trial, &suite.settings, cancel, &mut running)?;
                stopped?;
                let Some((run, remark)) = measured else { return Ok(false) };
                if let (Some(from), Some(to), 1) = (before, ThreadTimes::now(), suite.settings.threads) {
                    times.add(from, to);
                    results.conditions.waited_share = times.waited_share();
                }
                add(results, run, remark);
                progress.done += 1;
                progress.measured += 1;
            }
        }
        observe(Notice::CaseDone { case, results: &*results })?;
    }
    Ok(true)
}

fn key(case: Case, guidance: GuidanceKind, trial: u64) -> RunKey {
    let (family, guidance) = (case.family.name().to_owned(), guidance_name(guidance).to_owned());
    RunKey { family, size: case.size.to_string(), guidance, trial }
}

fn add(results: &mut Results, run: Run, remark: Option<Remark>) {
    results.runs.push(run);
    results.remarks.extend(remark);
}

/// How far it has come.
struct Progress {
    /// Runs that need not be run any more.
    done: usize,
    /// Of them, those that were run just now.
    measured: usize,
    total: usize,
    budget_s: f64,
}

impl Progress {
    /// Seconds left, `now_s` after the start and `elapsed_s` into a run.
    fn left_s(&self, now_s: f64, elapsed_s: f64) -> f64 {
        let spent_s = (now_s - elapsed_s).max(0.0);
        let each_s = if self.measured == 0 { self.budget_s } else { spent_s / self.measured as f64 };
        let to_do = self.total.saturating_sub(self.done) as f64;
        (to_do * each_s - elapsed_s.min(each_s)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_comes_from_the_runs_so_far() {
        let mut progress = Progress { done: 0, measured: 0, total: 10, budget_s: 30.0 };
        assert_eq!(progress.left_s(0.0, 0.0), 300.0);
        assert_eq!(progress.left_s(10.0, 10.0), 290.0);
        // Four were there before, two took five seconds each.
        (progress.done, progress.measured) = (6, 2);
        assert_eq!(progress.left_s(10.0, 0.0), 20.0);
        assert_eq!(progress.left_s(12.0, 2.0), 18.0);
        assert_eq!(progress.left_s(30.0, 20.0), 15.0);
        progress.done = 10;
        assert_eq!(progress.left_s(40.0, 0.0), 0.0);
    }
}
