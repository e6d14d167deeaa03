//! Every fault by its code, what is accepted and what it means, and documents broken at random.

mod accepted;
mod faults;
mod goals;
mod homes;
mod mutations;
mod paths;
mod robots;

use serde_json::{Value, json};

use super::{ReadLimits, ReadProblem, read_problem_value};
use crate::scenario::{Family, generate};
use crate::wire::{Fault, FaultCode, LibraryOnly};

/// The 2x2 switch: two arms, two tables, two cubes.
fn switch() -> Value {
    generate(Family::Switch, 2, 2, 0).unwrap()
}

fn read(document: &Value) -> Result<ReadProblem, Vec<Fault>> {
    read_problem_value(document, &LibraryOnly, &ReadLimits::default())
}

fn accepted(document: &Value) -> ReadProblem {
    match read(document) {
        Ok(read) => read,
        Err(faults) => panic!("{}", lines(&faults)),
    }
}

fn lines(faults: &[Fault]) -> String {
    faults.iter().map(|fault| format!("{fault}\n")).collect()
}

/// Puts `value` at `pointer`, whose parent must be there.
fn set(document: &mut Value, pointer: &str, value: Value) {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match document.pointer_mut(parent).unwrap() {
        Value::Object(map) => {
            map.insert(key.replace("~1", "/"), value);
        }
        Value::Array(list) => match key.parse::<usize>() {
            Ok(index) if index < list.len() => list[index] = value,
            _ => list.push(value),
        },
        _ => panic!("{parent} holds nothing"),
    }
}

/// Takes away what is at `pointer`.
fn remove(document: &mut Value, pointer: &str) {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let gone = match document.pointer_mut(parent).unwrap() {
        Value::Object(map) => map.remove(key),
        Value::Array(list) => Some(list.remove(key.parse().unwrap())),
        _ => None,
    };
    assert!(gone.is_some(), "there is no {pointer}");
}

fn pose(x: f64, y: f64, z: f64) -> Value {
    json!({ "pose": { "position": { "x": x, "y": y, "z": z } } })
}

/// A two-joint arm whose second joint has no limits worth the name.
const SMALL_URDF: &str = r#"<robot name="small">
    <link name="root"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
    <link name="boom"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.4 0.05 0.05"/></geometry></collision></link>
    <link name="wrist"/><link name="finger"/>
    <joint name="swing" type="revolute"><parent link="root"/><child link="boom"/><origin xyz="0 0 0.2"/>
        <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1.5" effort="1"/></joint>
    <joint name="reach" type="prismatic"><parent link="boom"/><child link="wrist"/><origin xyz="0.5 0 0"/>
        <axis xyz="1 0 0"/><limit lower="0" upper="0.5" velocity="0.4" effort="1"/></joint>
    <joint name="grip" type="prismatic"><parent link="wrist"/><child link="finger"/><axis xyz="0 1 0"/>
        <limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
    </robot>"#;

/// A cell of one small arm and a table in its reach, with one ball.
fn small() -> Value {
    json!({
        "schema": "quadrille.problem/1",
        "workcell": {
            "robots": { "small": { "urdf_xml": SMALL_URDF } },
            "arms": [ { "id": "a", "robot": "small", "base": {}, "tool": { "mount_link": "wrist" } } ],
            "obstacles": [
                { "id": "table", "shape": { "type": "box", "size": { "x": 0.4, "y": 0.4, "z": 0.1 } },
                  "pose": { "position": { "x": 0.0, "y": 0.8, "z": 0.05 } } }
            ],
            "surfaces": [
                { "id": "top", "on": "table", "pose": { "position": { "x": 0.0, "y": 0.8, "z": 0.1 } },
                  "size": { "x": 0.4, "y": 0.4 } }
            ]
        },
        "objects": [ { "id": "ball", "shape": { "type": "sphere", "radius": 0.04 } } ],
        "initial": { "ball": { "pose": { "position": { "x": 0.0, "y": 0.8, "z": 0.14 } } } }
    })
}

fn has(faults: &[Fault], pointer: &str, code: FaultCode) -> bool {
    faults.iter().any(|fault| fault.pointer == pointer && fault.code == code)
}
