//! From a document to an accepted job, for HTTP and gRPC alike.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use bytes::Bytes;
use serde_json::{Map, Value, json};

use super::client::Client;
use super::stream::CancelOnDrop;
use super::workcells::{Bundle, Workcells};
use super::{ApiError, App};
use crate::jobs::{Idempotency, JobId, JobRecord, JobRequest, ProblemReader, StoreError, Submission, Ticket};
use crate::plan::{Metrics, Plan, StepsProof};
use crate::problem::Problem;
use crate::wire::{
    self, Fault, FaultCode, JobFields, LibraryOnly, ReadLimits, ReadProblem, Remembering, Resources,
    read_job, unknown_workcell, with_workcell, workcell_reference,
};

/// Longest idempotency key (bytes).
const LONGEST_KEY: usize = 255;

/// A request for a job as it came in.
#[derive(Debug, Clone)]
pub enum Source {
    /// One document: a problem, or a problem with what belongs to the job around it.
    Document(Bytes),
    /// The same in parts.
    Parts {
        /// The problem, JSON.
        problem: Bytes,
        /// What stands around it.
        around: Map<String, Value>,
        /// The plan to begin from, JSON.
        warm_start: Option<Bytes>,
    },
}

impl Source {
    fn parse(&self, limits: &ReadLimits) -> Result<Value, ApiError> {
        let parse = |bytes: &[u8], pointer: &str| {
            if bytes.len() > limits.max_bytes {
                return Err(ApiError::TooLarge { limit: limits.max_bytes });
            }
            let parsed = wire::parse_json_bounded(bytes, limits.max_json_depth);
            parsed.map_err(|fault| ApiError::of_problem(below(pointer, vec![fault])))
        };
        match self {
            Source::Document(bytes) => parse(bytes, ""),
            Source::Parts { problem, around, warm_start } => {
                let mut whole = around.clone();
                let document = parse(problem, "/problem")?;
                if let Some(plan) = warm_start {
                    whole.insert("warm_start".to_owned(), parse(plan, "/warm_start")?);
                }
                whole.insert("problem".to_owned(), document);
                Ok(Value::Object(whole))
            }
        }
    }
}

/// A problem that has been read, with what it was read from.
pub struct Understood {
    /// The problem and its warnings.
    pub read: ReadProblem,
    /// What the job layer keeps.
    pub request: JobRequest,
    /// The plan to begin from.
    pub warm_start: Option<Plan>,
}

/// The faults with their pointers moved below `prefix`.
pub fn below(prefix: &str, mut faults: Vec<Fault>) -> Vec<Fault> {
    for fault in &mut faults {
        fault.pointer.insert_str(0, prefix);
    }
    faults
}

/// The files of a registered workcell, and its digest.
type Referred = (Bundle, String);

/// The problem with the workcell in it that it refers to, the files that go with it, and the
/// workcell's digest.
fn resolve<'a>(
    workcells: &Workcells,
    problem: &'a Value,
    pointer: &str,
) -> Result<(Cow<'a, Value>, Option<Referred>), ApiError> {
    let Some(reference) = workcell_reference(problem) else { return Ok((Cow::Borrowed(problem), None)) };
    let Some((registered, bundle)) = workcells.get(reference)? else {
        return Err(ApiError::InvalidProblem(vec![unknown_workcell(pointer, reference)]));
    };
    let whole = with_workcell(problem, &bundle.document);
    Ok((Cow::Owned(whole), Some((bundle, registered.digest))))
}

/// Reads a problem that may refer to a registered workcell; also gives that one's digest.
///
/// # Errors
/// All faults of the document, their places below `pointer`.
pub fn read_referring(
    workcells: &Workcells,
    problem: &Value,
    pointer: &str,
    limits: &ReadLimits,
) -> Result<(ReadProblem, Option<String>), ApiError> {
    let (whole, bundle) = resolve(workcells, problem, pointer)?;
    let (resources, digest): (&dyn Resources, _) = match &bundle {
        Some((bundle, digest)) => (bundle, Some(digest.clone())),
        None => (&LibraryOnly, None),
    };
    let resources = Remembering { resources, robots: workcells.robots() };
    let mut read = wire::read_problem_value(&whole, &resources, limits)
        .map_err(|faults| ApiError::of_problem(below(pointer, faults)))?;
    read.warnings = below(pointer, read.warnings);
    Ok((read, digest))
}

/// Reads a plan for `problem` and has it judged.
fn read_warm_start(plan: &Value, problem: &Problem) -> Result<Plan, ApiError> {
    let pointer = "/warm_start";
    let refuse = |faults| ApiError::of_plan(below(pointer, faults));
    let plan = wire::plan::read_plan_value(plan, problem).map_err(refuse)?;
    let verdict = crate::verify::verify(problem, &plan);
    if verdict.valid {
        // What the plan says of all plans is not taken from a stranger: nothing is proved yet.
        let metrics = Metrics {
            mode_graph_optimum: None,
            steps_lower_bound: 0,
            steps_proof: StepsProof::None,
            found_after_s: 0.0,
            ..plan.metrics
        };
        return Ok(Plan { revision: 1, metrics, verification: Some(verdict.verification()), ..plan });
    }
    let why = verdict.first.map(|violation| violation.message).unwrap_or_default();
    let message = format!("a plan to begin from must be valid for the problem: {why}");
    let fault = Fault { pointer: String::new(), code: FaultCode::OutOfRange, message };
    Err(refuse(vec![fault]))
}

/// Reads all of a request for a job.
fn understand(
    workcells: &Workcells,
    limits: &ReadLimits,
    document: &Value,
    client: &Client,
) -> Result<Understood, ApiError> {
    let fields = read_job(document).map_err(ApiError::InvalidProblem)?;
    let (read, workcell) = read_referring(workcells, fields.problem, fields.pointer, limits)?;
    let warm_start = fields.warm_start.map(|plan| read_warm_start(plan, &read.problem)).transpose()?;
    let JobFields { problem, labels, priority, queue_ttl, .. } = fields;
    // A JSON value always serialises.
    let problem = serde_json::to_vec(problem).unwrap_or_default();
    let request = JobRequest {
        problem: problem.into(),
        workcell,
        warm_start: warm_start.as_ref().map(|plan| wire::plan::to_json(&read.problem, plan).into()),
        labels,
        priority,
        queue_ttl,
        client: client.0.to_string(),
        idempotency: None,
    };
    Ok(Understood { read, request, warm_start })
}

/// Validates a problem, or a request for a job, on a blocking thread; only so many at once.
///
/// # Errors
/// All faults of the document.
pub async fn validate(app: &Arc<App>, source: Source) -> Result<Understood, ApiError> {
    let shared = Arc::clone(app);
    blocking(app, move || {
        let limits = &shared.config.read_limits;
        let began = Instant::now();
        let document = source.parse(limits)?;
        let read = understand(&shared.workcells, limits, &document, &Client("".into()));
        shared.figures.validated(began.elapsed());
        read
    })
    .await
}

/// Runs `work` on a blocking thread; only so many at once.
///
/// # Errors
/// Those of `work`, and [`ApiError::Internal`] when it panics.
pub async fn blocking<T: Send + 'static>(
    app: &Arc<App>,
    work: impl FnOnce() -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let permit = Arc::clone(&app.validations).acquire_owned().await.map_err(|_| ApiError::Unavailable)?;
    aside(app, move |_| {
        // Held by the work itself: a client that leaves does not make room for more.
        let _permit = permit;
        work()
    })
    .await
}

/// Runs `work`, which may wait for the disk, on a thread of its own, so that no other request waits with it.
///
/// # Errors
/// Those of `work`, and [`ApiError::Internal`] when it panics.
pub async fn aside<T: Send + 'static>(
    app: &Arc<App>,
    work: impl FnOnce(&App) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let (shared, span) = (Arc::clone(app), tracing::Span::current());
    tokio::task::spawn_blocking(move || span.in_scope(|| work(&shared))).await.map_err(|error| {
        app.figures.panicked();
        tracing::error!(%error, "a request's work panicked");
        ApiError::Internal
    })?
}

/// Makes requests under one idempotency key wait for each other.
#[derive(Debug, Default)]
pub struct KeyLocks {
    locks: Mutex<BTreeMap<String, Weak<tokio::sync::Mutex<()>>>>,
}

impl KeyLocks {
    fn of(&self, key: &str) -> Arc<tokio::sync::Mutex<()>> {
        let mut locks = self.locks.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(lock) = locks.get(key).and_then(Weak::upgrade) {
            return lock;
        }
        locks.retain(|_, lock| lock.strong_count() > 0);
        let lock = Arc::new(tokio::sync::Mutex::new(()));
        locks.insert(key.to_owned(), Arc::downgrade(&lock));
        lock
    }
}

/// Checks an idempotency key.
///
/// # Errors
/// When it is empty, too long, or not visible ASCII.
pub fn checked_key(key: &str) -> Result<String, ApiError> {
    let visible = key.bytes().all(|byte| byte.is_ascii_graphic());
    if key.is_empty() || key.len() > LONGEST_KEY || !visible {
        let message = format!("give 1 to {LONGEST_KEY} visible ASCII characters");
        return Err(ApiError::BadParameter { name: "Idempotency-Key", message });
    }
    Ok(key.to_owned())
}

/// Digest of what a request asks for, however it is written.
fn digest(document: &Value) -> Result<String, ApiError> {
    let fields = read_job(document).map_err(ApiError::InvalidProblem)?;
    let asked = json!({
        "problem": fields.problem, "labels": fields.labels, "priority": fields.priority,
        "queue_ttl_ms": fields.queue_ttl.map(|ttl| ttl.as_millis() as u64), "warm_start": fields.warm_start,
    });
    wire::digest_of(&asked).ok_or(ApiError::Internal)
}

/// A request for a job, with all that accepting it takes.
struct Arrival {
    source: Source,
    client: Client,
    /// Its idempotency key.
    key: Option<String>,
    place: Place,
    /// Whether the job ends when its client leaves.
    cancel: bool,
    at: Instant,
}

/// Where a request belongs.
enum Place {
    /// To this job, made by a request under the same key and with this digest.
    Known(JobId, String),
    /// Into the queue.
    Reserved(Ticket),
}

/// Accepts a request for a job. Under an idempotency key that is known, the job of that key is given.
/// A client that leaves while its request waits for its turn leaves no job behind. From then on the job
/// is made, and the guard that comes with it cancels it when it is dropped, here or by whoever has it, if
/// `cancel` says so and this request made the job.
///
/// # Errors
/// When the queue is full, the document has faults, or the key belongs to another request.
pub async fn accept(
    app: &Arc<App>,
    source: Source,
    client: &Client,
    key: Option<String>,
    cancel: bool,
) -> Result<(JobRecord, CancelOnDrop), ApiError> {
    let at = Instant::now();
    let lock = key.as_deref().map(|key| app.keys.of(key));
    let _alone = match &lock {
        Some(lock) => Some(lock.lock().await),
        None => None,
    };
    let known = key.as_deref().map(|key| app.jobs.store().keyed(key)).transpose()?.flatten();
    let place = match known {
        Some((job, digest)) => Place::Known(job, digest),
        // A full queue refuses before any work is done.
        None => Place::Reserved(app.jobs.reserve(&client.0)?),
    };
    let arrival = Arrival { source, client: client.clone(), key, place, cancel, at };
    let shared = Arc::clone(app);
    // All in one: what is parsed is never held without the right to be worked on.
    blocking(app, move || take_in(&shared, arrival)).await
}

/// Reads a request and makes its job, or finds the one that it has made before.
fn take_in(app: &Arc<App>, arrival: Arrival) -> Result<(JobRecord, CancelOnDrop), ApiError> {
    // The source, and with it the room of the body, is held to the end.
    let Arrival { source, client, key, place, cancel, at } = arrival;
    let limits = &app.config.read_limits;
    let document = source.parse(limits)?;
    let digest = key.as_ref().map(|_| digest(&document)).transpose()?;
    let guarded = |record: JobRecord, armed| {
        let guard = CancelOnDrop::new(Arc::clone(app), record.id, armed);
        (record, guard)
    };
    let same = |job, known: &str| {
        if digest.as_deref() != Some(known) {
            return Err(ApiError::KeyTaken);
        }
        // Somebody else may be waiting for that job.
        Ok(guarded(app.jobs.store().record(job)?, false))
    };
    let ticket = match place {
        Place::Known(job, known) => return same(job, &known),
        Place::Reserved(ticket) => ticket,
    };
    let began = Instant::now();
    let understood = understand(&app.workcells, limits, &document, &client);
    app.figures.validated(began.elapsed());
    let Understood { read, request, warm_start } = understood?;
    let idempotency = key.zip(digest.clone()).map(|(key, digest)| Idempotency { key, digest });
    let request = JobRequest { idempotency, ..request };
    let submission = Submission { request, problem: read.problem, warm_start, spent: at.elapsed() };
    match app.jobs.submit(ticket, submission).map_err(ApiError::from) {
        Ok(record) => {
            tracing::info!(job = %record.id, spent_s = at.elapsed().as_secs_f64(), "job accepted");
            Ok(guarded(record, cancel))
        }
        // Another process was faster.
        Err(ApiError::KeyHeld(job, known)) => same(job, &known),
        Err(error) => Err(error),
    }
}

/// Reads jobs of earlier processes again.
pub struct Reader {
    /// Where the workcells are.
    pub workcells: Arc<Workcells>,
    /// Bounds on problems.
    pub limits: ReadLimits,
}

impl ProblemReader for Reader {
    fn read(&self, request: &JobRequest) -> Result<(Problem, Option<Plan>), String> {
        let told = |error: ApiError| {
            let faults = error.document().faults().first().map(ToString::to_string);
            faults.unwrap_or_else(|| error.to_string())
        };
        let mut document = wire::parse_json(&request.problem).map_err(|fault| fault.to_string())?;
        // The version that it was accepted with, whatever the id leads to now.
        if let (Some(digest), Some(fields)) = (&request.workcell, document.as_object_mut()) {
            fields.insert("workcell".to_owned(), Value::String(digest.clone()));
        }
        let (read, _) = read_referring(&self.workcells, &document, "", &self.limits).map_err(told)?;
        let plan =
            request.warm_start.as_ref().map(|text| wire::plan::read_plan(text.as_bytes(), &read.problem));
        let plan = plan.transpose().map_err(|faults| ApiError::of_plan(faults).to_string())?;
        Ok((read.problem, plan))
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::UnknownJob(job) => ApiError::NotFound { what: format!("job {job}") },
            StoreError::NotEnded(job) => ApiError::NotEnded(job),
            StoreError::KeyTaken { job, digest } => ApiError::KeyHeld(job, digest),
            StoreError::Broken(why) => {
                tracing::error!(why, "the store failed");
                ApiError::StorageFailed
            }
            StoreError::OutOfTurn { .. } | StoreError::Fenced { .. } | StoreError::Leased(_) => {
                tracing::error!(%error, "the store refused");
                ApiError::Internal
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::{JobState, JobsConfig, ListQuery};
    use crate::planner::{Outcome, PlannerEvent, Termination};
    use crate::run::Control;
    use crate::service::{Service, ServiceConfig};
    use std::time::Duration;
    use tokio_util::sync::CancellationToken;

    /// Plans nothing until it is told to stop.
    fn idle(_: &Problem, control: &Control, _: &mut (dyn FnMut(PlannerEvent<'_>) + Send)) -> Outcome {
        while !control.should_stop() {
            std::thread::sleep(Duration::from_millis(1));
        }
        Outcome { termination: Termination::Cancelled, best: None, diagnosis: None }
    }

    fn source() -> Source {
        Source::Document(Bytes::from_static(crate::scenario::find("switch/2x2").unwrap().text.as_bytes()))
    }

    fn state(app: &App, job: JobId) -> JobState {
        app.jobs.store().record(job).unwrap().state
    }

    #[test]
    fn who_leaves_early_cancels_its_own_job_and_no_other() {
        // One thread for such work, so that it can be kept waiting.
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let runtime = builder.enable_all().max_blocking_threads(1).build().unwrap();
        runtime.block_on(async {
            let jobs = JobsConfig { workers: 1, ..JobsConfig::default() };
            let config = ServiceConfig { jobs, ..ServiceConfig::default() };
            let app = Service::start(config, Arc::new(idle), CancellationToken::new()).unwrap().app;
            let client = Client("me".into());
            for cancel in [true, false] {
                let (go, wait) = std::sync::mpsc::channel::<()>();
                let busy = tokio::task::spawn_blocking(move || wait.recv().is_err());
                let mut accepting = Box::pin(accept(&app, source(), &client, None, cancel));
                assert!(futures::poll!(&mut accepting).is_pending());
                // The client leaves while its request is worked on.
                drop(accepting);
                drop(go);
                assert!(busy.await.unwrap());
                // What is asked for now comes after it.
                let newest = ListQuery { limit: 1, ..ListQuery::default() };
                let found = aside(&app, move |app| Ok(app.jobs.store().list(&newest)?)).await.unwrap();
                let job = found[0].id;
                if cancel {
                    while state(&app, job) != JobState::Cancelled {
                        tokio::time::sleep(Duration::from_millis(1)).await;
                    }
                } else {
                    tokio::time::sleep(Duration::from_millis(50)).await;
                    assert!(!state(&app, job).is_terminal());
                }
            }
            // The only planner is busy with the job that goes on: this one waits.
            let accepting = async || accept(&app, source(), &client, Some("key".to_owned()), true).await;
            let (made, own) = accepting().await.unwrap();
            let (found, other) = accepting().await.unwrap();
            assert_eq!(found.id, made.id);
            drop(other);
            assert_eq!(state(&app, made.id), JobState::Queued, "it is somebody else's");
            drop(own);
            assert_eq!(state(&app, made.id), JobState::Cancelled);
        });
    }
}
