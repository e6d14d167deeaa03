//! What `/metrics` shows. The recorder belongs to the service, not to the process, so that several
//! services in one process do not mix.

use std::time::Duration;

use metrics::{Counter, Gauge, Histogram, Key, Label, Level, Metadata, Recorder, SharedString, Unit};
use metrics_exporter_prometheus::{
    BuildError, Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder,
};

use crate::jobs::{Load, Observer, Occurrence, RetryCause, TerminationReason};

const METADATA: Metadata<'static> = Metadata::new("quadrille", Level::INFO, Some("quadrille"));
/// Bounds of the histograms' buckets (s).
const BUCKETS: [f64; 15] =
    [0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0];

/// The service's figures.
pub struct Figures {
    recorder: PrometheusRecorder,
    handle: PrometheusHandle,
    accepted: Counter,
    panics: Counter,
    store_failures: Counter,
    incumbents: Counter,
    busy: Histogram,
    guidance: Histogram,
    programs: Histogram,
    programs_solved: Counter,
    waited: Histogram,
    first_plan: Histogram,
    duration: Histogram,
    validation: Histogram,
    waiting: Gauge,
    running: Gauge,
    workers: Gauge,
    streams: Gauge,
}

fn key(name: &'static str, labels: Vec<Label>) -> Key {
    Key::from_parts(name, labels)
}

impl Figures {
    /// Figures that are all zero.
    ///
    /// # Errors
    /// Never, with the buckets above.
    pub fn new() -> Result<Self, BuildError> {
        let recorder = PrometheusBuilder::new()
            .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &BUCKETS)?
            .build_recorder();
        let counter = |name: &'static str, help: &'static str| {
            recorder.describe_counter(name.into(), None, SharedString::const_str(help));
            recorder.register_counter(&key(name, Vec::new()), &METADATA)
        };
        let gauge = |name: &'static str, help: &'static str| {
            recorder.describe_gauge(name.into(), None, SharedString::const_str(help));
            recorder.register_gauge(&key(name, Vec::new()), &METADATA)
        };
        let histogram = |name: &'static str, help: &'static str| {
            recorder.describe_histogram(name.into(), Some(Unit::Seconds), SharedString::const_str(help));
            recorder.register_histogram(&key(name, Vec::new()), &METADATA)
        };
        for (name, help) in [
            ("quadrille_jobs_ended_total", "Jobs that ended, by state and reason"),
            ("quadrille_jobs_retried_total", "Attempts that were over without an end, by cause"),
            ("quadrille_rejects_total", "Requests that were refused, by code"),
        ] {
            recorder.describe_counter(name.into(), None, SharedString::const_str(help));
        }
        Ok(Self {
            accepted: counter("quadrille_jobs_accepted_total", "Jobs that were accepted"),
            panics: counter("quadrille_panics_total", "Panics that were caught"),
            store_failures: counter("quadrille_store_failures_total", "Events that the store failed to keep"),
            incumbents: counter("quadrille_incumbents_total", "Plans that were published"),
            busy: histogram("quadrille_planner_busy_seconds", "Time of planner threads per attempt"),
            guidance: histogram(
                "quadrille_guidance_seconds",
                "Time in it for solving on the mode graph, by all means, over all threads of the job",
            ),
            programs: histogram(
                "quadrille_solver_seconds",
                "Time in it for integer programs (the HiGHS solver), over all threads of the job",
            ),
            programs_solved: counter("quadrille_solver_calls_total", "Integer programs given to HiGHS"),
            waited: histogram("quadrille_job_wait_seconds", "Time from acceptance to the first start"),
            first_plan: histogram("quadrille_first_plan_seconds", "Time from acceptance to the first plan"),
            duration: histogram("quadrille_job_duration_seconds", "Time from acceptance to the end"),
            validation: histogram("quadrille_validation_seconds", "Time to read and validate a problem"),
            waiting: gauge("quadrille_queue_depth", "Jobs that wait"),
            running: gauge("quadrille_jobs_running", "Jobs that run"),
            workers: gauge("quadrille_workers", "Planner threads"),
            streams: gauge("quadrille_streams_open", "Open streams of events"),
            handle: recorder.handle(),
            recorder,
        })
    }

    fn labelled(&self, name: &'static str, labels: &[(&'static str, String)]) -> Counter {
        let labels = labels.iter().map(|(key, value)| Label::new(*key, value.clone())).collect();
        self.recorder.register_counter(&key(name, labels), &METADATA)
    }

    /// A request was refused.
    pub fn refused(&self, code: &str) {
        self.labelled("quadrille_rejects_total", &[("code", code.to_owned())]).increment(1);
    }

    /// A panic was caught.
    pub fn panicked(&self) {
        self.panics.increment(1);
    }

    /// A problem was read.
    pub fn validated(&self, took: Duration) {
        self.validation.record(took.as_secs_f64());
    }

    /// All figures in Prometheus' text format.
    pub fn render(&self, load: Load, streams: usize) -> String {
        self.waiting.set(load.waiting as f64);
        self.running.set(load.running as f64);
        self.workers.set(load.workers as f64);
        self.streams.set(streams as f64);
        self.handle.render()
    }

    /// Keeps what is recorded from piling up between two renderings.
    pub fn tidy(&self) {
        self.handle.run_upkeep();
    }
}

impl Observer for Figures {
    fn observe(&self, occurrence: Occurrence) {
        match occurrence {
            Occurrence::Accepted => self.accepted.increment(1),
            Occurrence::Started { waited } => self.waited.record(waited.as_secs_f64()),
            Occurrence::Incumbent { first_after } => {
                self.incumbents.increment(1);
                if let Some(after) = first_after {
                    self.first_plan.record(after.as_secs_f64());
                }
            }
            Occurrence::Planned { busy, guidance, programs, programs_solved } => {
                self.busy.record(busy.as_secs_f64());
                self.guidance.record(guidance.as_secs_f64());
                self.programs.record(programs.as_secs_f64());
                self.programs_solved.increment(programs_solved);
            }
            Occurrence::Ended { reason, after } => {
                self.ended(reason);
                self.duration.record(after.as_secs_f64());
            }
            Occurrence::Retried(cause) => self.retried(cause),
            Occurrence::Panicked => self.panics.increment(1),
            Occurrence::StoreFailed => self.store_failures.increment(1),
        }
    }
}

impl Figures {
    fn ended(&self, reason: TerminationReason) {
        let labels = [("state", reason.state().as_str().to_owned()), ("reason", reason.as_str().to_owned())];
        self.labelled("quadrille_jobs_ended_total", &labels).increment(1);
    }

    fn retried(&self, cause: RetryCause) {
        self.labelled("quadrille_jobs_retried_total", &[("cause", cause.as_str().to_owned())]).increment(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_counted_shows() {
        let figures = Figures::new().unwrap();
        figures.observe(Occurrence::Accepted);
        figures.observe(Occurrence::Incumbent { first_after: Some(Duration::from_millis(20)) });
        let reason = TerminationReason::TimeLimit;
        figures.observe(Occurrence::Ended { reason, after: Duration::from_secs(3) });
        let (busy, guidance) = (Duration::from_secs(2), Duration::from_millis(400));
        let programs = Duration::from_millis(30);
        figures.observe(Occurrence::Planned { busy, guidance, programs, programs_solved: 2 });
        figures.refused("queue_full");
        figures.panicked();
        let text = figures.render(Load { workers: 3, running: 2, waiting: 1 }, 7);
        for line in [
            "quadrille_jobs_accepted_total 1",
            "quadrille_incumbents_total 1",
            "quadrille_planner_busy_seconds_sum 2",
            "quadrille_guidance_seconds_sum 0.4",
            "quadrille_solver_seconds_sum 0.03",
            "quadrille_solver_calls_total 2",
            "quadrille_first_plan_seconds_bucket{le=\"0.025\"} 1",
            "quadrille_first_plan_seconds_bucket{le=\"0.01\"} 0",
            "quadrille_jobs_ended_total{state=\"SUCCEEDED\",reason=\"TIME_LIMIT\"} 1",
            "quadrille_rejects_total{code=\"queue_full\"} 1",
            "quadrille_panics_total 1",
            "quadrille_queue_depth 1",
            "quadrille_streams_open 7",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} in\n{text}");
        }
    }
}
