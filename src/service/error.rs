//! What can go wrong with a request, and how HTTP and gRPC say it. The one place that maps errors
//! to statuses.

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tonic::metadata::{MetadataMap, MetadataValue};

use super::workcells::RegistryError;
use crate::jobs::{BadJobId, JobId, QueueRefusal};
use crate::wire::{Fault, FaultCode};

/// Media type of problem documents.
pub const PROBLEM_JSON: &str = "application/problem+json";
/// gRPC metadata that carries the problem document.
pub const PROBLEM_METADATA: &str = "quadrille-problem-bin";
/// gRPC metadata that carries the problem document's code alone.
pub const CODE_METADATA: &str = "quadrille-code";
/// When to try again to connect (s).
const CONNECTION_RETRY_S: u64 = 5;
/// Most bytes of a problem document in gRPC metadata: a third more in base64, where clients take 8 KiB.
const METADATA_BYTES: usize = 4096;
/// Longest detail there, and longest message of the status (characters).
const METADATA_DETAIL: usize = 500;

/// Why a request is refused.
#[derive(Debug, thiserror::Error)]
pub enum ApiError {
    /// The body is no JSON.
    #[error("the body is not a JSON document")]
    InvalidJson(Vec<Fault>),
    /// The document breaks rules of the format or of geometry.
    #[error("the problem has {} fault(s)", .0.len())]
    InvalidProblem(Vec<Fault>),
    /// Goals lie beyond the greatest reach of every arm.
    #[error("a goal lies beyond the greatest reach of every arm: {}", unreachable(.0))]
    GoalUnreachable(Vec<Fault>),
    /// The document is no plan for the problem.
    #[error("the plan cannot be read: it has {} fault(s)", .0.len())]
    InvalidPlan(Vec<Fault>),
    /// The body is no bundle of a workcell.
    #[error("the bundle cannot be used: {0}")]
    BadBundle(String),
    /// The idempotency key belongs to another request.
    #[error("this idempotency key came with another request before; use a fresh one")]
    KeyTaken,
    /// The idempotency key belongs to this job, whose request has this digest. Never leaves the
    /// intake.
    #[error("the idempotency key belongs to job {0}")]
    KeyHeld(JobId, String),
    /// The job has not ended.
    #[error("job {0} has not ended; cancel it first")]
    NotEnded(JobId),
    /// As many workcells are registered as may be.
    #[error("{limit} workcells are registered already; delete one first")]
    WorkcellsFull {
        /// How many may be.
        limit: usize,
    },
    /// Workcells would take more room than they may.
    #[error("registered workcells take at most {limit} bytes in all; delete one first")]
    NoRoomForWorkcell {
        /// How many bytes they may take.
        limit: u64,
    },
    /// As many streams are open as may be.
    #[error("{limit} streams of events are open already; close one, or try again in {retry_after_s} s")]
    TooManyStreams {
        /// How many may be.
        limit: usize,
        /// When to try again (s).
        retry_after_s: u64,
    },
    /// As many connections are open as may be.
    #[error("{limit} connections are open already; close one, or try again in {CONNECTION_RETRY_S} s")]
    TooManyConnections {
        /// How many may be.
        limit: usize,
    },
    /// The body is too large.
    #[error("the body is larger than {limit} bytes")]
    TooLarge {
        /// What is taken at most.
        limit: usize,
    },
    /// The body did not arrive in time.
    #[error("the body did not arrive within {seconds} s")]
    BodyTimeout {
        /// How long was waited.
        seconds: u64,
    },
    /// The body broke off.
    #[error("the body could not be read to its end")]
    BodyBroken,
    /// The body has a media type or encoding that is not read here.
    #[error("the body must be {expected}, not encoded further, and not {found}")]
    UnsupportedMediaType {
        /// What is read here.
        expected: &'static str,
        /// What it says it is.
        found: String,
    },
    /// None of the media types that the client accepts is written here.
    #[error("this resource comes as {0} only")]
    NotAcceptable(&'static str),
    /// A parameter of the path, the query or a header is no good.
    #[error("{name}: {message}")]
    BadParameter {
        /// Which one.
        name: &'static str,
        /// What is wrong.
        message: String,
    },
    /// Nothing is there.
    #[error("there is no {what} here")]
    NotFound {
        /// What was looked for.
        what: String,
    },
    /// The job has no such plan, or none yet.
    #[error("the job has no such plan")]
    NoSolution,
    /// The resource does not know the method.
    #[error("this resource does not take that method")]
    MethodNotAllowed,
    /// The queue takes no more, or no more of this client.
    #[error("no room: {0}")]
    QueueFull(QueueRefusal, u64),
    /// There is no memory for another body now.
    #[error("too much is being sent or worked on at once")]
    TooManyBodies {
        /// When to come back.
        retry_after_s: u64,
    },
    /// As many mode graphs are asked for as may be.
    #[error("mode graphs are made one after the other, and enough requests wait for theirs")]
    TooManyModeGraphs {
        /// When to come back.
        retry_after_s: u64,
    },
    /// The service is not up, or about to end.
    #[error("the service is not ready")]
    Unavailable,
    /// What is to be kept cannot be written: nothing of the request has happened.
    #[error("the service cannot keep anything now, so it takes nothing in")]
    StorageFailed,
    /// Our fault.
    #[error("the service failed on this request")]
    Internal,
}

fn unreachable(faults: &[Fault]) -> String {
    faults.first().map(|fault| fault.message.clone()).unwrap_or_default()
}

/// A problem document, RFC 9457 with FORMAT.md's members.
#[derive(Debug, Serialize)]
pub struct ProblemDocument {
    r#type: String,
    title: &'static str,
    status: u16,
    detail: String,
    code: &'static str,
    retryable: bool,
    errors: Vec<Fault>,
}

/// Goes with a refusal on its way out, for whoever counts: its code.
#[derive(Debug, Clone, Copy)]
pub struct Refused(pub &'static str);

impl ProblemDocument {
    /// The faults of the document.
    pub fn faults(&self) -> &[Fault] {
        &self.errors
    }
}

impl ApiError {
    /// Every code that a refusal may have.
    pub const CODES: [&'static str; 26] = [
        "invalid_json",
        "invalid_problem",
        "goal_unreachable",
        "invalid_plan",
        "too_large",
        "body_timeout",
        "body_broken",
        "unsupported_media_type",
        "not_acceptable",
        "bad_parameter",
        "not_found",
        "no_solution",
        "method_not_allowed",
        "too_many_jobs",
        "queue_full",
        "too_many_streams",
        "too_many_bodies",
        "too_many_connections",
        "too_many_mode_graphs",
        "bad_bundle",
        "idempotency_mismatch",
        "job_not_ended",
        "workcells_full",
        "unavailable",
        "storage_failed",
        "internal",
    ];

    /// The refusal of a problem document with these faults.
    pub fn of_problem(faults: Vec<Fault>) -> Self {
        let all = |code| faults.iter().all(|fault| fault.code == code);
        if all(FaultCode::InvalidJson) {
            ApiError::InvalidJson(faults)
        } else if all(FaultCode::GoalUnreachable) {
            ApiError::GoalUnreachable(faults)
        } else {
            ApiError::InvalidProblem(faults)
        }
    }

    /// The refusal of a plan document with these faults.
    pub fn of_plan(faults: Vec<Fault>) -> Self {
        ApiError::InvalidPlan(faults)
    }

    /// HTTP status, stable code and title.
    fn kind(&self) -> (StatusCode, &'static str, &'static str) {
        use ApiError as E;
        match self {
            E::InvalidJson(_) => (StatusCode::BAD_REQUEST, "invalid_json", "Not a JSON document"),
            E::InvalidProblem(_) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "invalid_problem", "The problem cannot be used")
            }
            E::GoalUnreachable(_) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "goal_unreachable", "A goal is out of reach")
            }
            E::InvalidPlan(_) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "invalid_plan", "The plan cannot be read")
            }
            E::TooLarge { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "too_large", "The body is too large"),
            E::BodyTimeout { .. } => {
                (StatusCode::REQUEST_TIMEOUT, "body_timeout", "The body came too slowly")
            }
            E::BodyBroken => (StatusCode::BAD_REQUEST, "body_broken", "The body broke off"),
            E::UnsupportedMediaType { .. } => {
                (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", "Unsupported media type")
            }
            E::NotAcceptable(_) => (StatusCode::NOT_ACCEPTABLE, "not_acceptable", "Not acceptable"),
            E::BadParameter { .. } => (StatusCode::BAD_REQUEST, "bad_parameter", "Unusable parameter"),
            E::NotFound { .. } => (StatusCode::NOT_FOUND, "not_found", "Not found"),
            E::NoSolution => (StatusCode::NOT_FOUND, "no_solution", "No such plan"),
            E::MethodNotAllowed => {
                (StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", "Method not allowed")
            }
            E::QueueFull(QueueRefusal::ClientFull { .. }, _) => {
                (StatusCode::TOO_MANY_REQUESTS, "too_many_jobs", "Too many jobs of one client")
            }
            E::QueueFull(..) => (StatusCode::TOO_MANY_REQUESTS, "queue_full", "The queue is full"),
            E::TooManyStreams { .. } => {
                (StatusCode::TOO_MANY_REQUESTS, "too_many_streams", "Too many open streams")
            }
            E::TooManyConnections { .. } => {
                (StatusCode::TOO_MANY_REQUESTS, "too_many_connections", "Too many connections")
            }
            E::TooManyBodies { .. } => {
                (StatusCode::TOO_MANY_REQUESTS, "too_many_bodies", "Too many bodies at once")
            }
            E::TooManyModeGraphs { .. } => {
                (StatusCode::TOO_MANY_REQUESTS, "too_many_mode_graphs", "Too many mode graphs at once")
            }
            E::BadBundle(_) => (StatusCode::UNPROCESSABLE_ENTITY, "bad_bundle", "The bundle cannot be used"),
            E::KeyTaken | E::KeyHeld(..) => (
                StatusCode::UNPROCESSABLE_ENTITY,
                "idempotency_mismatch",
                "The key belongs to another request",
            ),
            E::NotEnded(_) => (StatusCode::CONFLICT, "job_not_ended", "The job has not ended"),
            E::WorkcellsFull { .. } | E::NoRoomForWorkcell { .. } => {
                (StatusCode::CONFLICT, "workcells_full", "No room for another workcell")
            }
            E::Unavailable => (StatusCode::SERVICE_UNAVAILABLE, "unavailable", "Not ready"),
            E::StorageFailed => (StatusCode::SERVICE_UNAVAILABLE, "storage_failed", "Nothing can be kept"),
            E::Internal => (StatusCode::INTERNAL_SERVER_ERROR, "internal", "Internal error"),
        }
    }

    /// The HTTP status.
    pub fn status(&self) -> StatusCode {
        self.kind().0
    }

    /// The gRPC status code.
    pub fn grpc_code(&self) -> tonic::Code {
        use ApiError as E;
        match self {
            E::InvalidJson(_)
            | E::InvalidProblem(_)
            | E::GoalUnreachable(_)
            | E::InvalidPlan(_)
            | E::BadParameter { .. }
            | E::UnsupportedMediaType { .. }
            | E::BadBundle(_)
            | E::NotAcceptable(_)
            | E::BodyBroken => tonic::Code::InvalidArgument,
            E::KeyTaken | E::KeyHeld(..) => tonic::Code::AlreadyExists,
            E::NotEnded(_) => tonic::Code::FailedPrecondition,
            E::TooLarge { .. }
            | E::QueueFull(..)
            | E::TooManyStreams { .. }
            | E::TooManyBodies { .. }
            | E::TooManyConnections { .. }
            | E::TooManyModeGraphs { .. }
            | E::WorkcellsFull { .. }
            | E::NoRoomForWorkcell { .. } => tonic::Code::ResourceExhausted,
            E::BodyTimeout { .. } => tonic::Code::DeadlineExceeded,
            E::NotFound { .. } | E::NoSolution => tonic::Code::NotFound,
            E::MethodNotAllowed => tonic::Code::Unimplemented,
            E::Unavailable | E::StorageFailed => tonic::Code::Unavailable,
            E::Internal => tonic::Code::Internal,
        }
    }

    /// The problem document.
    pub fn document(&self) -> ProblemDocument {
        let (status, code, title) = self.kind();
        let errors = match self {
            ApiError::InvalidJson(faults)
            | ApiError::InvalidProblem(faults)
            | ApiError::GoalUnreachable(faults)
            | ApiError::InvalidPlan(faults) => faults.clone(),
            ApiError::TooLarge { .. } => {
                vec![Fault { pointer: String::new(), code: FaultCode::TooLarge, message: self.to_string() }]
            }
            _ => Vec::new(),
        };
        let retryable = matches!(
            self,
            ApiError::QueueFull(..)
                | ApiError::TooManyStreams { .. }
                | ApiError::TooManyBodies { .. }
                | ApiError::TooManyConnections { .. }
                | ApiError::TooManyModeGraphs { .. }
                | ApiError::Unavailable
                | ApiError::StorageFailed
                | ApiError::BodyTimeout { .. }
                | ApiError::BodyBroken
        );
        ProblemDocument {
            r#type: format!("urn:quadrille:error:{code}"),
            title,
            status: status.as_u16(),
            detail: self.to_string(),
            code,
            retryable,
            errors,
        }
    }

    /// The stable code.
    pub fn code(&self) -> &'static str {
        self.kind().1
    }

    /// The whole reply as it goes over a connection that is closed after it.
    pub fn http_text(&self) -> String {
        let body = serde_json::to_string(&self.document()).unwrap_or_default();
        let retry =
            self.retry_after_s().map(|seconds| format!("retry-after: {seconds}\r\n")).unwrap_or_default();
        format!(
            "HTTP/1.1 {}\r\ncontent-type: {PROBLEM_JSON}\r\ncontent-length: {}\r\n{retry}connection: close\r\n\r\n{body}",
            self.status(),
            body.len(),
        )
    }

    fn retry_after_s(&self) -> Option<u64> {
        match self {
            ApiError::QueueFull(_, seconds) => Some(*seconds),
            ApiError::TooManyStreams { retry_after_s, .. }
            | ApiError::TooManyBodies { retry_after_s }
            | ApiError::TooManyModeGraphs { retry_after_s } => Some(*retry_after_s),
            ApiError::TooManyConnections { .. } => Some(CONNECTION_RETRY_S),
            ApiError::Unavailable | ApiError::StorageFailed => Some(5),
            _ => None,
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let text = serde_json::to_vec(&self.document()).unwrap_or_default();
        let mut response = Response::new(Body::from(text));
        *response.status_mut() = self.status();
        response.extensions_mut().insert(Refused(self.kind().1));
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(seconds) = self.retry_after_s() {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}

impl From<ApiError> for tonic::Status {
    fn from(error: ApiError) -> Self {
        let mut document = error.document();
        // The first faults, as many as fit.
        let mut left = METADATA_BYTES;
        let fits = document.errors.iter().take_while(|fault| {
            let bytes = serde_json::to_vec(fault).map_or(usize::MAX, |text| text.len() + 1);
            left.checked_sub(bytes).inspect(|rest| left = *rest).is_some()
        });
        let fits = fits.count();
        document.errors.truncate(fits);
        if let Some((end, _)) = document.detail.char_indices().nth(METADATA_DETAIL) {
            document.detail.truncate(end);
        }
        let mut metadata = MetadataMap::new();
        metadata.insert(CODE_METADATA, MetadataValue::from_static(document.code));
        if let Ok(text) = serde_json::to_vec(&document) {
            metadata.insert_bin(PROBLEM_METADATA, MetadataValue::from_bytes(&text));
        }
        tonic::Status::with_metadata(error.grpc_code(), document.detail, metadata)
    }
}

impl From<QueueRefusal> for ApiError {
    fn from(refusal: QueueRefusal) -> Self {
        match refusal {
            QueueRefusal::Full { retry_after_s, .. } | QueueRefusal::ClientFull { retry_after_s, .. } => {
                ApiError::QueueFull(refusal, retry_after_s)
            }
            QueueRefusal::Stopping => ApiError::Unavailable,
        }
    }
}

impl From<RegistryError> for ApiError {
    fn from(error: RegistryError) -> Self {
        match error {
            RegistryError::Full(limit) => ApiError::WorkcellsFull { limit },
            RegistryError::NoRoom(limit) => ApiError::NoRoomForWorkcell { limit },
            RegistryError::Store(error) => error.into(),
        }
    }
}

impl From<BadJobId> for ApiError {
    fn from(_: BadJobId) -> Self {
        ApiError::NotFound { what: "job of that id".to_owned() }
    }
}
