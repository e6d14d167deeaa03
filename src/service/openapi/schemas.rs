//! Schemas of what is written. Readers pass over what they do not know, so further members are open.

use serde_json::{Value, json};

use super::reference;
use crate::jobs::{JobState, TerminationReason};
use crate::service::ApiError;
use crate::wire::FaultCode;

/// An object that has these properties at least.
fn open(required: &[&str], properties: Value) -> Value {
    json!({ "type": "object", "required": required, "properties": properties })
}

/// As [`open`], with all properties required.
fn full(properties: Value) -> Value {
    let required: Vec<String> =
        properties.as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect();
    json!({ "type": "object", "required": required, "properties": properties })
}

fn list(item: Value) -> Value {
    json!({ "type": "array", "items": item })
}

fn nullable(schema: &Value) -> Value {
    json!({ "anyOf": [schema, { "type": "null" }] })
}

fn instant() -> Value {
    json!({ "type": "string", "format": "date-time" })
}

fn count() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn digest() -> Value {
    json!({ "type": "string", "pattern": "^sha256:[0-9a-f]{64}$" })
}

/// An event of one type, with its further members.
fn event(kind: &str, required: &[&str], properties: Value) -> Value {
    let mut all = json!({
        "seq": count(), "job_id": { "type": "string", "format": "uuid" },
        "attempt": { "type": "integer", "minimum": 1 }, "at": instant(), "type": { "const": kind },
    });
    if let (Some(all), Value::Object(own)) = (all.as_object_mut(), properties) {
        all.extend(own);
    }
    open(&[&["seq", "job_id", "attempt", "at", "type"], required].concat(), all)
}

/// Schemas by name.
pub(super) fn schemas() -> Vec<(&'static str, Value)> {
    let mut all = plans();
    all.extend(jobs());
    all.extend(rest());
    all
}

fn plans() -> Vec<(&'static str, Value)> {
    let number = || json!({ "type": "number" });
    let numbers = || list(json!({ "type": "number" }));
    let action = |kind: &str, further: &[&str]| {
        let required = [&["id", "step", "t", "kind", "object", "arm", "object_in_tcp"], further].concat();
        open(
            &required,
            json!({
                "id": count(), "step": count(), "t": number(), "kind": { "const": kind }, "object": text(),
                "arm": text(), "to_arm": text(), "object_in_tcp": reference("Pose"),
                "to_object_in_tcp": reference("Pose"), "object_pose": reference("Pose"), "surface": text(),
            }),
        )
    };
    vec![
        (
            "Metrics",
            open(
                &["duration_s", "arc_length", "actions", "steps"],
                json!({
                    "duration_s": number(), "duration_synchronous_s": number(), "arc_length": number(),
                    "actions": count(), "steps": count(), "mode_graph_optimum": nullable(&count()),
                    "steps_lower_bound": count(), "steps_proof": { "enum": ["none", "bounds", "ilp"] },
                    "found_after_s": number(),
                }),
            ),
        ),
        (
            "Plan",
            open(
                &["schema", "problem_digest", "revision", "schedule", "metrics", "arms", "actions"],
                json!({
                    "schema": { "const": "quadrille.plan/1" }, "problem_digest": digest(), "revision": count(),
                    "schedule": { "enum": ["synchronous", "asynchronous"] }, "metrics": reference("Metrics"),
                    "arms": list(open(&["id", "joint_names", "points"], json!({
                        "id": text(), "joint_names": list(text()),
                        "points": list(open(&["t", "q", "qd", "qdd"], json!({
                            "t": number(), "q": numbers(), "qd": numbers(), "qdd": numbers(),
                        }))),
                    }))),
                    "actions": list(json!({ "anyOf": [
                        action("pick", &["surface"]),
                        action("place", &["object_pose", "surface"]),
                        action("handoff", &["to_arm", "to_object_in_tcp"]),
                    ] })),
                    "precedence": list(json!({ "type": "object" })),
                    "verification": nullable(&open(&["valid"], json!({
                        "valid": { "type": "boolean" }, "min_clearance_m": nullable(&number()),
                        "at": nullable(&open(&["t", "bodies"], json!({
                            "t": number(), "bodies": { "type": "array", "items": text(), "minItems": 2, "maxItems": 2 },
                        }))),
                    }))),
                }),
            ),
        ),
    ]
}

fn jobs() -> Vec<(&'static str, Value)> {
    let figures = || nullable(&reference("Metrics"));
    let second = || json!({ "type": "number", "minimum": 0 });
    vec![
        ("JobState", json!({ "enum": JobState::ALL.map(JobState::as_str) })),
        ("TerminationReason", json!({ "enum": TerminationReason::ALL.map(TerminationReason::as_str) })),
        (
            "Event",
            json!({ "oneOf": [
                event("queued", &["position"], json!({ "position": count() })),
                event("started", &[], json!({})),
                event("progress", &["elapsed_s", "phase", "iterations", "steps_lower_bound"], json!({
                    "elapsed_s": second(), "phase": text(), "iterations": count(),
                    "steps_lower_bound": nullable(&count()),
                })),
                event("incumbent", &["revision", "metrics", "skipped"], json!({
                    "revision": count(), "metrics": reference("Metrics"), "skipped": count(),
                    "plan": reference("Plan"), "href": text(),
                })),
                event("retrying", &["cause"], json!({ "cause": { "enum": ["worker_lost", "shutdown"] } })),
                event("snapshot", &["state", "metrics"], json!({
                    "state": reference("JobState"), "metrics": figures(),
                })),
                event("terminal", &["state", "termination_reason", "metrics"], json!({
                    "state": reference("JobState"), "termination_reason": reference("TerminationReason"),
                    "metrics": figures(), "diagnosis": text(),
                })),
            ] }),
        ),
        (
            "EventStream",
            json!({ "type": "string", "description": "Server-sent events; `data` is an Event." }),
        ),
        (
            "Job",
            full(json!({
                "id": { "type": "string", "format": "uuid" }, "state": reference("JobState"),
                "termination_reason": nullable(&reference("TerminationReason")),
                "labels": { "type": "object", "additionalProperties": text() },
                "priority": { "type": "integer" }, "queue_ttl_s": nullable(&second()),
                "attempt": { "type": "integer", "minimum": 1 }, "created_at": instant(),
                "queued_at": nullable(&instant()), "started_at": nullable(&instant()),
                "finished_at": nullable(&instant()), "queue_position": nullable(&count()), "best": figures(),
                "diagnosis": nullable(&text()), "last_seq": count(),
                "links": full(json!({
                    "self": text(), "events": text(), "incumbents": text(), "best": text(), "cancel": text(),
                })),
            })),
        ),
        ("JobPage", full(json!({ "jobs": list(reference("Job")), "next": nullable(&text()) }))),
        (
            "Incumbents",
            full(json!({ "incumbents": list(full(json!({
                "revision": count(), "seq": count(), "attempt": count(), "at": instant(),
                "metrics": reference("Metrics"), "href": text(),
            }))) })),
        ),
    ]
}

fn rest() -> Vec<(&'static str, Value)> {
    let links = || json!({ "type": "object", "additionalProperties": text() });
    let registered =
        || json!({ "id": text(), "digest": digest(), "registered_at": instant(), "links": links() });
    let with = |further: Value| {
        let mut all = registered();
        if let (Some(all), Value::Object(own)) = (all.as_object_mut(), further) {
            all.extend(own);
        }
        full(all)
    };
    vec![
        (
            "Fault",
            full(json!({
                "pointer": text(), "code": { "enum": FaultCode::ALL.map(FaultCode::as_str) }, "message": text(),
            })),
        ),
        (
            "ProblemDocument",
            full(json!({
                "type": text(), "title": text(), "status": { "type": "integer" }, "detail": text(),
                "code": { "enum": ApiError::CODES }, "retryable": { "type": "boolean" },
                "errors": list(reference("Fault")),
            })),
        ),
        (
            "Validated",
            full(json!({
                "valid": { "const": true }, "name": text(), "problem_digest": digest(), "arms": count(),
                "objects": count(), "warnings": list(reference("Fault")),
            })),
        ),
        ("Verdict", open(&["valid"], json!({ "valid": { "type": "boolean" } }))),
        ("WorkcellList", full(json!({ "workcells": list(full(registered())) }))),
        (
            "WorkcellEntry",
            with(json!({
                "arms": count(), "obstacles": count(), "surfaces": count(), "warnings": list(reference("Fault")),
            })),
        ),
        (
            "RegisteredWorkcell",
            with(json!({
                "files": list(full(json!({ "path": text(), "bytes": count(), "digest": digest() }))),
                "workcell": reference("Workcell"),
            })),
        ),
        (
            "ModeGraph",
            full(json!({
                "schema": { "const": "quadrille.mode_graph/1" }, "kind": { "enum": ["guidance", "optimistic"] },
                "complete": { "type": "boolean" }, "nodes": list(json!({ "type": "object" })),
                "edges": list(json!({ "type": "object" })), "conflicts": list(json!({ "type": "object" })),
                "objects": list(json!({ "type": "object" })),
                "barred_carries": list(full(json!({ "object": text(), "arms": list(text()) }))),
                "blockages": list(full(json!({
                    "object": text(), "at": count(), "action": { "enum": ["pick", "place"] },
                    "arms": list(text()), "carried": { "type": "boolean" },
                }))),
                "crowdings": list(list(full(json!({
                    "object": text(), "action": { "enum": ["pick", "place"] }, "arms": list(text()),
                })))),
            })),
        ),
        (
            "ScenarioList",
            full(json!({ "scenarios": list(full(json!({
                "name": text(), "family": text(), "arms": count(), "objects": count(), "href": text(),
            }))) })),
        ),
        ("Limits", json!({ "type": "object", "additionalProperties": { "type": "number" } })),
        (
            "Version",
            full(json!({
                "name": text(), "version": text(), "api": text(), "problem_schema": text(), "plan_schema": text(),
            })),
        ),
        ("Status", open(&["status"], json!({ "status": { "const": "ok" } }))),
        ("Text", text()),
        ("Any", json!({ "type": "object" })),
    ]
}
