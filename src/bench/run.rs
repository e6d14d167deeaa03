//! One run, measured.

use std::path::PathBuf;
use std::time::Duration;

use crate::plan::Plan;
use crate::planner::{PlannerCache, PlannerEvent, Termination, plan_with};
use crate::problem::{GuidanceKind, Problem};
use crate::run::{CancelToken, Control, Deadline};
use crate::scenario::{ScenarioError, generate, to_text};
use crate::verify::verify;
use crate::wire::{Fault, KnownRobots, LibraryOnly, ReadLimits, Remembering, read_problem};

use super::bound::duration_lower_bound;
use super::memory;
use super::results::{Phases, Remark, Run, WorkcellAge};
use super::selection::{Case, guidance_name};

/// Seeds of the arrangements by which a workcell gets known are the trial's plus this, so that no problem
/// that is measured was planned before.
const OTHER_ARRANGEMENT: u64 = 1_000_000;

/// What getting to know a workcell is given at least.
const LEAST_ACQUAINTANCE: Duration = Duration::from_secs(10);

/// Why a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The problem cannot be generated.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The generated problem has faults.
    #[error("{case} with seed {seed} has faults: {}", faults.first().map_or("", |fault| fault.message.as_str()))]
    Faults {
        /// Which.
        case: Case,
        /// Its seed.
        seed: u64,
        /// All of them.
        faults: Vec<Fault>,
    },
}

/// What holds for all runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunSettings {
    /// Time budget, validation included.
    pub budget: Duration,
    /// Planner threads.
    pub threads: usize,
    /// Whether the workcell is known before.
    pub workcell: WorkcellAge,
    /// Whether to stop at the first plan.
    pub first_solution: bool,
    /// The folder of compiled workcells, for [`WorkcellAge::Stored`].
    pub cache_dir: Option<PathBuf>,
}

impl RunSettings {
    /// What a process knows that has just begun and looks into the folder.
    fn folder_cache(&self) -> PlannerCache {
        let cache = PlannerCache::new(0);
        match &self.cache_dir {
            Some(folder) => cache.with_folder(folder, None),
            None => cache,
        }
    }
}

/// Measures trial `trial` of `case`; `None` when it was cancelled. `observe` hears how long it has been
/// going on (s), a few times a second.
///
/// # Errors
/// [`BenchError`] when there is no such problem.
pub fn measure(
    case: Case,
    guidance: GuidanceKind,
    trial: u64,
    settings: &RunSettings,
    cancel: &CancelToken,
    observe: &mut (dyn FnMut(f64) + Send),
) -> Result<Option<(Run, Option<Remark>)>, BenchError> {
    let mut robots = KnownRobots::new();
    let cache = match settings.workcell {
        WorkcellAge::New => PlannerCache::new(0),
        WorkcellAge::Known => acquainted(PlannerCache::new(1), &robots, case, trial, settings, cancel)?,
        WorkcellAge::Stored => {
            acquainted(settings.folder_cache(), &robots, case, trial, settings, cancel)?;
            // As in another process.
            robots = KnownRobots::new();
            settings.folder_cache()
        }
    };
    let document = document(case, trial)?;
    memory::reset_peak();
    let deadline = Deadline::after(settings.budget);
    let mut problem = read(case, trial, &document, &robots)?;
    let mut record = Record { validation_s: deadline.elapsed_s(), ..Record::default() };
    problem.options.time_budget_s = settings.budget.as_secs_f64();
    problem.options.seed = trial;
    problem.options.guidance = guidance;
    problem.options.threads = settings.threads;
    problem.options.stop.first_solution = settings.first_solution;
    let control = Control::new(deadline, cancel.clone());
    let outcome = plan_with(&cache, &problem, &control, &mut |event| {
        if let PlannerEvent::Progress { elapsed_s, .. } = event {
            observe(elapsed_s);
        }
        record.hear(&event);
    });
    let end_s = deadline.elapsed_s();
    let peak_rss_mb = memory::peak_mb();
    if outcome.termination == Termination::Cancelled || cancel.is_cancelled() {
        return Ok(None);
    }
    // The planner has judged it; the plan that is handed over is judged once more.
    let accepted = outcome.best.filter(|plan| verify(&problem, plan).valid);
    let mut cause = outcome.diagnosis;
    if accepted.is_none() {
        cause = cause.or_else(|| Some("the judge rejects the plan that was handed over".to_owned()));
    }
    let run = record.conclude(case, guidance, trial, &problem, accepted.as_ref(), end_s, peak_rss_mb);
    let remark = (cause.is_some() || record.rejected > 0).then(|| Remark {
        family: run.family.clone(),
        size: run.size.clone(),
        guidance: run.guidance.clone(),
        trial,
        rejected: record.rejected,
        cause,
    });
    Ok(Some((run, remark)))
}

/// `cache` (and `robots`) with what is known after another arrangement of the same workcell was planned.
fn acquainted(
    cache: PlannerCache,
    robots: &KnownRobots,
    case: Case,
    trial: u64,
    settings: &RunSettings,
    cancel: &CancelToken,
) -> Result<PlannerCache, BenchError> {
    let seed = trial + OTHER_ARRANGEMENT;
    let mut problem = read(case, seed, &document(case, seed)?, robots)?;
    problem.options.threads = settings.threads;
    problem.options.stop.first_solution = true;
    let deadline = Deadline::after(settings.budget.max(LEAST_ACQUAINTANCE));
    plan_with(&cache, &problem, &Control::new(deadline, cancel.clone()), &mut |_| {});
    Ok(cache)
}

fn document(case: Case, seed: u64) -> Result<String, BenchError> {
    Ok(to_text(&generate(case.family, case.size.arms, case.size.objects, seed)?))
}

fn read(case: Case, seed: u64, document: &str, robots: &KnownRobots) -> Result<Problem, BenchError> {
    let resources = Remembering { resources: &LibraryOnly, robots };
    let read = read_problem(document.as_bytes(), &resources, &ReadLimits::default());
    Ok(read.map_err(|faults| BenchError::Faults { case, seed, faults })?.problem)
}

/// What the planner told.
#[derive(Debug, Default)]
struct Record {
    validation_s: f64,
    /// When each phase began (s), in order.
    began: Vec<(&'static str, f64)>,
    steps_lower_bound: Option<usize>,
    rejected: u64,
    /// When the first accepted candidate was ready (s).
    candidate_s: Option<f64>,
    /// Judging until the first plan (s).
    judge_s: Option<f64>,
    /// Timing of paths until the first plan (s).
    timing_s: Option<f64>,
    incumbents: Vec<(f64, f64)>,
}

impl Record {
    fn hear(&mut self, event: &PlannerEvent<'_>) {
        match *event {
            PlannerEvent::Progress { elapsed_s, phase, steps_lower_bound, .. } => {
                if self.began.iter().all(|(name, _)| *name != phase) {
                    self.began.push((phase, elapsed_s));
                }
                self.steps_lower_bound = steps_lower_bound.or(self.steps_lower_bound);
            }
            PlannerEvent::Judged { candidate_s, handed_in_s, timing_s, judged_s, valid } => {
                self.rejected += u64::from(!valid);
                if self.incumbents.is_empty() {
                    *self.judge_s.get_or_insert(0.0) += judged_s - handed_in_s;
                    if self.candidate_s.is_none() {
                        self.timing_s = Some(timing_s);
                    }
                }
                if valid {
                    self.candidate_s.get_or_insert(candidate_s);
                }
            }
            PlannerEvent::Incumbent(plan) => {
                self.incumbents.push((plan.metrics.found_after_s, plan.metrics.duration_s));
            }
        }
    }

    /// Seconds per phase until the first plan, or until `end_s`.
    fn phases(&self, end_s: f64) -> Phases {
        let end_s = self.incumbents.first().map_or(end_s, |(t, _)| *t);
        let begin = |phase: &str| self.began.iter().find(|(name, _)| *name == phase).map(|(_, t)| *t);
        let span = |phase: &str, next: &str| {
            let to = begin(next).unwrap_or(end_s);
            begin(phase).map(|from| (to - from).max(0.0))
        };
        let others_s = self.judge_s.unwrap_or(0.0) + self.timing_s.unwrap_or(0.0);
        Phases {
            validation_s: Some(self.validation_s),
            workcell_s: span("workcell", "mode_graph"),
            mode_graph_s: span("mode_graph", "guidance"),
            guidance_s: span("guidance", "search"),
            search_s: begin("search").map(|from| (end_s - from - others_s).max(0.0)),
            timing_s: self.timing_s,
            judge_s: self.judge_s,
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn conclude(
        &self,
        case: Case,
        guidance: GuidanceKind,
        trial: u64,
        problem: &Problem,
        plan: Option<&Plan>,
        end_s: f64,
        peak_rss_mb: Option<f64>,
    ) -> Run {
        let metrics = plan.map(|plan| &plan.metrics);
        let incumbents = if plan.is_some() { self.incumbents.clone() } else { Vec::new() };
        Run {
            family: case.family.name().to_owned(),
            size: case.size.to_string(),
            guidance: guidance_name(guidance).to_owned(),
            trial,
            solved: plan.is_some(),
            candidate_s: plan.and(self.candidate_s),
            first_plan_s: incumbents.first().map(|(t, _)| *t),
            steps: metrics.map(|metrics| metrics.steps),
            mode_graph_optimum: metrics.and_then(|metrics| metrics.mode_graph_optimum),
            steps_lower_bound: metrics.map(|metrics| metrics.steps_lower_bound).or(self.steps_lower_bound),
            actions: metrics.map(|metrics| metrics.actions),
            duration_first_s: incumbents.first().map(|(_, duration)| *duration),
            duration_s: metrics.map(|metrics| metrics.duration_s),
            duration_lower_bound_s: plan.and_then(|plan| duration_lower_bound(&problem.workcell, plan)),
            arc_length: metrics.map(|metrics| metrics.arc_length),
            peak_rss_mb,
            incumbents,
            phases: self.phases(end_s),
        }
    }
}
