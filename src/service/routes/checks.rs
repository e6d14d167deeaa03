//! `POST /v1/validate` and `POST /v1/verify`: reading and judging without planning.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use bytes::Bytes;
use serde::Serialize;
use serde_json::Value;

use super::super::body::read_json;
use super::super::intake::{Source, Understood, below, blocking, read_referring, validate as read};
use super::super::{ApiError, App};
use crate::verify::Verdict;
use crate::wire::{self, Fault, FaultCode, ReadProblem};

#[derive(Serialize)]
struct Validated {
    valid: bool,
    name: String,
    problem_digest: String,
    arms: usize,
    objects: usize,
    warnings: Vec<Fault>,
}

/// `POST /v1/validate`: reads the problem, or request for a job, in the body; 200 with the warnings,
/// or its faults.
pub(super) async fn validate(
    State(app): State<Arc<App>>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let document = read_json(&app.bodies, &headers, body, app.config.read_limits.max_bytes).await?;
    let Understood { read: ReadProblem { problem, warnings }, .. } =
        read(&app, Source::Document(document)).await?;
    Ok(super::json(&Validated {
        valid: true,
        arms: problem.workcell.arms.len(),
        objects: problem.objects.len(),
        name: problem.name,
        problem_digest: problem.digest,
        warnings,
    }))
}

/// `POST /v1/verify`: judges `{"problem", "plan"}`; 200 with the verdict, valid or not.
pub(super) async fn verify(
    State(app): State<Arc<App>>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    // A problem and a plan, each within the bound.
    let limit = app.config.read_limits.max_bytes.saturating_mul(2);
    let document = read_json(&app.bodies, &headers, body, limit).await?;
    Ok(super::json(&verdict(&app, Judged::Together(document)).await?))
}

/// A plan to be judged, and its problem.
pub enum Judged {
    /// As `{"problem", "plan"}`.
    Together(Bytes),
    /// Each on its own.
    Apart {
        /// The problem.
        problem: Bytes,
        /// The plan.
        plan: Bytes,
    },
}

/// What the judge says.
///
/// # Errors
/// The faults of problem or plan.
pub async fn verdict(app: &Arc<App>, judged: Judged) -> Result<Verdict, ApiError> {
    let shared = Arc::clone(app);
    blocking(app, move || {
        let limits = &shared.config.read_limits;
        let parse = |bytes: &[u8], pointer: &str| {
            let parsed = wire::parse_json_bounded(bytes, limits.max_json_depth);
            parsed.map_err(|fault| ApiError::of_problem(below(pointer, vec![fault])))
        };
        let (problem, plan) = match judged {
            Judged::Together(document) => {
                let mut whole = parse(&document, "")?;
                parts(&whole).map_err(ApiError::InvalidProblem)?;
                (whole["problem"].take(), whole["plan"].take())
            }
            Judged::Apart { problem, plan } => {
                if problem.len().max(plan.len()) > limits.max_bytes {
                    return Err(ApiError::TooLarge { limit: limits.max_bytes });
                }
                (parse(&problem, "/problem")?, parse(&plan, "/plan")?)
            }
        };
        let (read, _) = read_referring(&shared.workcells, &problem, "/problem", limits)?;
        let plan = wire::plan::read_plan_value(&plan, &read.problem)
            .map_err(|faults| ApiError::of_plan(below("/plan", faults)))?;
        Ok(crate::verify::verify(&read.problem, &plan))
    })
    .await
}

/// The two members of the body, and nothing else.
fn parts(body: &Value) -> Result<(&Value, &Value), Vec<Fault>> {
    let fault = |pointer: String, code, message: &str| Fault { pointer, code, message: message.to_owned() };
    let Some(fields) = body.as_object() else {
        let message = "send an object with `problem` and `plan`";
        return Err(vec![fault(String::new(), FaultCode::WrongType, message)]);
    };
    let mut faults: Vec<Fault> = fields
        .keys()
        .filter(|key| !["problem", "plan"].contains(&key.as_str()))
        .map(|key| {
            let pointer = format!("/{}", key.replace('~', "~0").replace('/', "~1"));
            fault(pointer, FaultCode::UnknownField, "only `problem` and `plan` stand here; remove it")
        })
        .collect();
    for key in ["problem", "plan"] {
        if !fields.contains_key(key) {
            faults.push(fault(String::new(), FaultCode::MissingField, &format!("add `{key}`")));
        }
    }
    match (fields.get("problem"), fields.get("plan")) {
        (Some(problem), Some(plan)) if faults.is_empty() => Ok((problem, plan)),
        _ => Err(faults),
    }
}
