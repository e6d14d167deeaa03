//! From a document to an accepted job, for HTTP and gRPC alike.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use bytes::Bytes;
use serde_json::{Map, Value, json};

use super::client::Client;
use super::workcells::{Bundle, Workcells};
use super::{ApiError, App};
use crate::jobs::{Idempotency, JobId, JobRecord, JobRequest, ProblemReader, StoreError, Submission, Ticket};
use crate::plan::{Metrics, Plan, StepsProof};
use crate::problem::Problem;
use crate::wire::{
    self, Fault, FaultCode, JobFields, LibraryOnly, ReadLimits, ReadProblem, Resources, read_job,
    unknown_workcell, with_workcell, workcell_reference,
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
    let mut read = wire::read_problem_value(&whole, resources, limits)
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
    let canonical = serde_json_canonicalizer::to_vec(&asked).map_err(|_| ApiError::Internal)?;
    Ok(wire::sha256(&canonical))
}

/// Accepts a request for a job. A client that leaves before that has happened leaves no job behind.
/// Under an idempotency key that is known, the job of that key is given.
///
/// # Errors
/// When the queue is full, the document has faults, or the key belongs to another request.
pub async fn accept(
    app: &Arc<App>,
    source: Source,
    client: &Client,
    key: Option<String>,
) -> Result<JobRecord, ApiError> {
    let arrived = Instant::now();
    let Some(key) = key else {
        // A full queue refuses before any work is done.
        let ticket = app.jobs.reserve(&client.0)?;
        return accept_new(app, ticket, Parsed::Not(source), client, None, arrived).await;
    };
    let lock = app.keys.of(&key);
    let _alone = lock.lock().await;
    let place = match app.jobs.store().keyed(&key)? {
        Some(known) => Place::Known(known),
        None => Place::Reserved(app.jobs.reserve(&client.0)?),
    };
    let shared = Arc::clone(app);
    let (document, digest) = blocking(app, move || {
        let document = source.parse(&shared.config.read_limits)?;
        let digest = digest(&document)?;
        Ok((document, digest))
    })
    .await?;
    let same = |job, known: &str| {
        if known == digest { Ok(app.jobs.store().record(job)?) } else { Err(ApiError::KeyTaken) }
    };
    let ticket = match place {
        Place::Known((job, known)) => return same(job, &known),
        Place::Reserved(ticket) => ticket,
    };
    let idempotency = Idempotency { key, digest: digest.clone() };
    match accept_new(app, ticket, Parsed::Yes(document), client, Some(idempotency), arrived).await {
        // Another process was faster.
        Err(ApiError::KeyHeld(job, known)) => same(job, &known),
        result => result,
    }
}

/// Where a request under an idempotency key belongs.
enum Place {
    /// To this job, made by a request with this digest.
    Known((JobId, String)),
    /// Into the queue.
    Reserved(Ticket),
}

enum Parsed {
    Not(Source),
    Yes(Value),
}

async fn accept_new(
    app: &Arc<App>,
    ticket: Ticket,
    parsed: Parsed,
    client: &Client,
    idempotency: Option<Idempotency>,
    arrived: Instant,
) -> Result<JobRecord, ApiError> {
    let (shared, owner) = (Arc::clone(app), client.clone());
    let record = blocking(app, move || {
        let limits = &shared.config.read_limits;
        let document = match parsed {
            Parsed::Not(source) => source.parse(limits)?,
            Parsed::Yes(document) => document,
        };
        let began = Instant::now();
        let understood = understand(&shared.workcells, limits, &document, &owner);
        shared.figures.validated(began.elapsed());
        let Understood { read, request, warm_start } = understood?;
        let request = JobRequest { idempotency, ..request };
        let submission = Submission { request, problem: read.problem, warm_start, spent: arrived.elapsed() };
        Ok(shared.jobs.submit(ticket, submission)?)
    })
    .await?;
    tracing::info!(job = %record.id, spent_s = arrived.elapsed().as_secs_f64(), "job accepted");
    Ok(record)
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
