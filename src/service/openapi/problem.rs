//! Schemas of what is read: problems, workcells, requests. What is unknown is refused here too.

use serde_json::{Value, json};

use super::reference;
use crate::wire::{MAX_LABEL_VALUE, MAX_LABELS, MAX_PRIORITY};

const ID: &str = "^[A-Za-z0-9_.-]{1,64}$";

/// An object with these properties and no others.
fn strict(required: &[&str], properties: Value) -> Value {
    json!({ "type": "object", "required": required, "additionalProperties": false, "properties": properties })
}

fn list(item: Value) -> Value {
    json!({ "type": "array", "items": item })
}

/// An object whose keys are names.
fn map(item: Value) -> Value {
    json!({ "type": "object", "additionalProperties": item })
}

fn positive() -> Value {
    json!({ "type": "number", "exclusiveMinimum": 0 })
}

fn at_least_zero() -> Value {
    json!({ "type": "number", "minimum": 0 })
}

fn nullable(schema: &Value) -> Value {
    json!({ "anyOf": [schema, { "type": "null" }] })
}

/// Schemas by name.
pub(super) fn schemas() -> Vec<(&'static str, Value)> {
    let number = || json!({ "type": "number" });
    let text = || json!({ "type": "string" });
    let id = || json!({ "type": "string", "pattern": ID });
    let shape = |kind: &str, required: &[&str], mut properties: Value| {
        properties["type"] = json!({ "const": kind });
        strict(&[&["type"], required].concat(), properties)
    };
    let grasp = strict(&["id", "object_in_tcp"], json!({ "id": id(), "object_in_tcp": reference("Pose") }));
    let generator = |names: &[&str], mut properties: Value| {
        properties["generator"] = json!({ "enum": names });
        properties["depth"] = positive();
        strict(&["generator"], properties)
    };
    let by_parts = generator(&["box_faces", "box_edges"], json!({}));
    let by_turns = generator(
        &["top", "cylinder_side"],
        json!({ "yaw_steps": { "type": "integer", "minimum": 1, "maximum": 360 } }),
    );
    let grasps = json!({
        "anyOf": [reference("Grasp"), list(reference("Grasp"))],
    });
    let resting = strict(&["pose"], json!({ "pose": reference("Pose") }));
    let held =
        strict(&["held_by", "object_in_tcp"], json!({ "held_by": id(), "object_in_tcp": reference("Pose") }));
    let on = strict(&["surface"], json!({ "surface": id() }));
    vec![
        ("Vector", strict(&["x", "y", "z"], json!({ "x": number(), "y": number(), "z": number() }))),
        (
            "Quaternion",
            strict(
                &["x", "y", "z", "w"],
                json!({ "x": number(), "y": number(), "z": number(), "w": number() }),
            ),
        ),
        (
            "Pose",
            strict(&[], json!({ "position": reference("Vector"), "orientation": reference("Quaternion") })),
        ),
        (
            "Shape",
            json!({ "oneOf": [
                shape("box", &["size"], json!({ "size": reference("Vector") })),
                shape("sphere", &["radius"], json!({ "radius": positive() })),
                shape("cylinder", &["radius", "length"], json!({ "radius": positive(), "length": positive() })),
                shape("capsule", &["radius", "length"], json!({ "radius": positive(), "length": at_least_zero() })),
                shape("convex", &["points"], json!({ "points": list(reference("Vector")) })),
                shape("mesh", &["uri"], json!({ "uri": text(), "scale": reference("Vector") })),
            ] }),
        ),
        ("Grasp", json!({ "anyOf": [by_parts, by_turns, grasp] })),
        (
            "JointLimits",
            map(strict(
                &[],
                json!({ "lower": number(), "upper": number(), "velocity": positive(), "acceleration": positive() }),
            )),
        ),
        (
            "Robot",
            strict(
                &[],
                json!({
                    "urdf": text(), "urdf_xml": text(), "srdf": text(), "srdf_xml": text(),
                    "package_map": map(text()), "limits": reference("JointLimits"),
                }),
            ),
        ),
        (
            "Tool",
            strict(
                &["mount_link"],
                json!({
                    "mount_link": text(), "tcp": reference("Pose"),
                    "collision": list(strict(&["shape"], json!({ "shape": reference("Shape"), "pose": reference("Pose") }))),
                    "max_opening": positive(), "grasp_time_s": at_least_zero(),
                }),
            ),
        ),
        (
            "Arm",
            strict(
                &["id", "robot", "base", "tool"],
                json!({
                    "id": id(), "robot": text(), "base": reference("Pose"), "tool": reference("Tool"),
                    "home": map(number()), "limits": reference("JointLimits"),
                }),
            ),
        ),
        (
            "Workcell",
            strict(
                &["robots", "arms"],
                json!({
                    "robots": map(reference("Robot")),
                    "arms": list(reference("Arm")),
                    "obstacles": list(strict(
                        &["id", "shape"],
                        json!({ "id": id(), "shape": reference("Shape"), "pose": reference("Pose") }),
                    )),
                    "surfaces": list(strict(
                        &["id", "size"],
                        json!({
                            "id": id(), "on": id(), "pose": reference("Pose"),
                            "size": strict(&["x", "y"], json!({ "x": positive(), "y": positive() })),
                            "capacity": nullable(&json!({ "type": "integer", "minimum": 0 })),
                        }),
                    )),
                    "allowed_contacts": list(json!({ "type": "array", "items": text(), "minItems": 2, "maxItems": 2 })),
                }),
            ),
        ),
        (
            "Object",
            strict(
                &["id", "shape"],
                json!({
                    "id": id(), "shape": reference("Shape"), "mass": at_least_zero(),
                    "symmetry": { "enum": ["none", "box", "cylinder_z", "sphere"] },
                    "grasps": grasps, "approach": at_least_zero(), "retreat": at_least_zero(),
                }),
            ),
        ),
        (
            "Options",
            strict(
                &[],
                json!({
                    "time_budget_s": positive(),
                    "max_iterations": nullable(&json!({ "type": "integer", "minimum": 1 })),
                    "seed": { "type": "integer", "minimum": 0 },
                    "threads": { "type": "integer", "minimum": 1, "maximum": 64 },
                    "guidance": { "enum": ["smart", "sequential", "greedy"] },
                    "schedule": { "enum": ["synchronous", "asynchronous"] },
                    "objective": { "enum": ["duration", "arc_length", "steps"] },
                    "return_home": { "type": "boolean" },
                    "ik_solutions": { "type": "integer", "minimum": 1, "maximum": 100 },
                    "clearance_m": { "type": "number", "minimum": 0, "maximum": 0.1 },
                    "stop": strict(&[], json!({
                        "first_solution": { "type": "boolean" },
                        "target_duration_s": nullable(&positive()),
                        "no_improvement_s": nullable(&positive()),
                    })),
                }),
            ),
        ),
        (
            "Problem",
            strict(
                &["schema", "workcell", "objects", "initial"],
                json!({
                    "schema": { "const": "quadrille.problem/1" }, "name": { "type": "string", "maxLength": 1000 },
                    "workcell": {
                        "description": "The workcell itself, or the id or digest of a registered one.",
                        "anyOf": [reference("Workcell"), text()],
                    },
                    "objects": list(reference("Object")),
                    "initial": map(json!({ "anyOf": [resting, held] })),
                    "goal": map(json!({ "anyOf": [resting, on] })),
                    "initial_joints": map(map(number())),
                    "options": reference("Options"),
                }),
            ),
        ),
        (
            "JobRequest",
            json!({
                "description": "A problem, or a problem with what belongs to the job around it.",
                "anyOf": [
                    reference("Problem"),
                    strict(&["problem"], json!({
                        "problem": reference("Problem"),
                        "labels": {
                            "type": "object", "maxProperties": MAX_LABELS, "propertyNames": { "pattern": ID },
                            "additionalProperties": { "type": "string", "maxLength": MAX_LABEL_VALUE },
                        },
                        "priority": { "type": "integer", "minimum": -MAX_PRIORITY, "maximum": MAX_PRIORITY },
                        "queue_ttl_s": nullable(&positive()),
                        "warm_start": nullable(&reference("Plan")),
                    })),
                ],
            }),
        ),
        (
            "VerifyRequest",
            strict(
                &["problem", "plan"],
                json!({ "problem": reference("Problem"), "plan": reference("Plan") }),
            ),
        ),
        (
            "Archive",
            json!({ "type": "string", "format": "binary", "contentMediaType": "application/octet-stream" }),
        ),
    ]
}
