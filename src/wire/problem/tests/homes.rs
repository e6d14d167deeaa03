//! Homes where arms have to be, and where none has to be.

use super::*;
use crate::scenario::{RobotKind, generate_with};
use crate::wire::read_workcell_value;

/// Whether a warning of this code stands at `pointer`.
fn warns(read: &ReadProblem, pointer: &str, code: FaultCode) -> bool {
    has(&read.warnings, pointer, code)
}

/// The switch with a ball where the first arm's hand is at home.
fn blocked() -> Value {
    let mut document = switch();
    let arm = &accepted(&document).problem.workcell.arms[0];
    let at = arm.tcp_pose(&arm.home).translation.vector;
    let ball = json!({
        "id": "ball", "shape": { "type": "sphere", "radius": 0.05 },
        "pose": { "position": { "x": at.x, "y": at.y, "z": at.z } },
    });
    set(&mut document, "/workcell/obstacles/4", ball);
    document
}

#[test]
fn a_home_where_no_arm_has_to_be_need_not_be_free() {
    let home = "/workcell/arms/0/home";
    let mut document = blocked();
    assert!(has(&read(&document).unwrap_err(), home, FaultCode::InitialCollision));
    set(&mut document, "/initial_joints", json!({ "arm_1": { "joint_1": 1.5 } }));
    let away = accepted(&document);
    assert!(warns(&away, home, FaultCode::InitialCollision), "{}", lines(&away.warnings));
    let problem = away.problem;
    // The planner's home is where the arm can be; the other arm keeps its own.
    let arms = &problem.workcell.arms;
    assert_eq!(arms[0].home, problem.initial_joints[0]);
    assert!((arms[0].home[0] - 1.5).abs() < 1e-12 && arms[1].home == problem.initial_joints[1]);
    // What is compiled around that home is not that of another start, nor that of the workcell.
    set(&mut document, "/initial_joints", json!({ "arm_1": { "joint_1": 1.5, "joint_7": 0.1 } }));
    let other = accepted(&document).problem;
    assert_ne!(other.workcell_digest, problem.workcell_digest);
    set(&mut document, "/options/seed", json!(5));
    assert_eq!(accepted(&document).problem.workcell_digest, other.workcell_digest);
    // Who is asked to come home has to be able to.
    set(&mut document, "/options/return_home", json!(true));
    let faults = read(&document).unwrap_err();
    assert!(has(&faults, home, FaultCode::InitialCollision), "{}", lines(&faults));
}

#[test]
fn a_home_that_is_free_stays_whoever_starts_where() {
    let mut document = switch();
    let plain = accepted(&document).problem;
    set(&mut document, "/initial_joints", json!({ "arm_1": { "joint_1": 1.5 } }));
    let read = accepted(&document);
    assert!(!warns(&read, "/workcell/arms/0/home", FaultCode::InitialCollision));
    assert_eq!(read.problem.workcell.arms[0].home, plain.workcell.arms[0].home);
    assert_eq!(read.problem.workcell_digest, plain.workcell_digest);
}

/// The small cell, of which the first joint cannot be at 0.
fn off_zero() -> Value {
    let mut document = small();
    let urdf = SMALL_URDF.replace("lower=\"-2\"", "lower=\"0.5\"");
    assert_ne!(urdf, SMALL_URDF);
    set(&mut document, "/workcell/robots/small/urdf_xml", json!(urdf));
    document
}

#[test]
fn a_joint_that_home_leaves_out_need_not_be_able_to_be_at_zero() {
    let arm = "/workcell/arms/0";
    let mut document = off_zero();
    let starts = |joints: Value| {
        let mut document = off_zero();
        set(&mut document, "/initial_joints", json!({ "a": joints }));
        document
    };
    // Where home is the start, in whole or in part, or the end, it has to be within the limits.
    assert!(has(&read(&document).unwrap_err(), arm, FaultCode::OutOfRange));
    assert!(has(&read(&starts(json!({ "reach": 0.1 }))).unwrap_err(), arm, FaultCode::OutOfRange));
    let mut returns = starts(json!({ "swing": 1.0 }));
    set(&mut returns, "/options", json!({ "return_home": true }));
    let faults = read(&returns).unwrap_err();
    assert_eq!(faults.len(), 1, "{}", lines(&faults));
    assert!(has(&faults, arm, FaultCode::OutOfRange));
    // Elsewhere the middles of their ranges stand in for what home leaves out, whatever the start.
    let one = accepted(&starts(json!({ "swing": 1.0 })));
    assert!(warns(&one, arm, FaultCode::OutOfRange), "{}", lines(&one.warnings));
    let problem = one.problem;
    assert_eq!(problem.initial_joints[0].as_slice(), [1.0, 0.0]);
    assert_eq!(problem.workcell.arms[0].home.as_slice(), [1.25, 0.25]);
    let other = accepted(&starts(json!({ "swing": 0.5, "reach": 0.2 }))).problem;
    assert_eq!(other.workcell.arms[0].home, problem.workcell.arms[0].home);
    assert_eq!(other.workcell_digest, problem.workcell_digest);
    // For a value that is given, the nearest one.
    set(&mut document, "/workcell/arms/0/home", json!({ "swing": 0.4, "reach": 0.1 }));
    let place = "/workcell/arms/0/home/swing";
    assert!(has(&read(&document).unwrap_err(), place, FaultCode::OutOfRange));
    set(&mut document, "/initial_joints", json!({ "a": { "swing": 1.0 } }));
    let given = accepted(&document);
    assert!(warns(&given, place, FaultCode::OutOfRange), "{}", lines(&given.warnings));
    assert_eq!(given.problem.workcell.arms[0].home.as_slice(), [0.5, 0.1]);
    assert_eq!(given.problem.initial_joints[0].as_slice(), [1.0, 0.1]);
    // A start is judged by itself.
    set(&mut document, "/initial_joints/a/swing", json!(0.4));
    assert!(has(&read(&document).unwrap_err(), "/initial_joints/a/swing", FaultCode::OutOfRange));
}

#[test]
fn arms_that_cannot_be_at_zero_need_no_home() {
    let mut document = generate_with(Family::Switch, 2, 2, 0, &[RobotKind::PandaType]).unwrap();
    let with_homes = accepted(&document).problem;
    let mut starts = serde_json::Map::new();
    for arm in document["workcell"]["arms"].as_array_mut().unwrap() {
        let home = arm.as_object_mut().unwrap().remove("home").unwrap();
        starts.insert(arm["id"].as_str().unwrap().to_owned(), home);
    }
    assert!(has(&read(&document).unwrap_err(), "/workcell/arms/0", FaultCode::OutOfRange));
    document["initial_joints"] = Value::Object(starts);
    let read = accepted(&document);
    assert!(warns(&read, "/workcell/arms/1", FaultCode::OutOfRange), "{}", lines(&read.warnings));
    assert_eq!(read.problem.initial_joints, with_homes.initial_joints);
    // The middles of the ranges are free here, so that all starts share what is compiled.
    assert!(!warns(&read, "/workcell/arms/1", FaultCode::InitialCollision), "{}", lines(&read.warnings));
    for arm in &read.problem.workcell.arms {
        let mut joints = arm.home.iter().zip(&arm.limits);
        assert!(joints.all(|(value, limit)| (limit.lower..=limit.upper).contains(value)));
    }
}

#[test]
fn a_workcell_alone_answers_for_the_homes_that_it_gives() {
    let read =
        |document: &Value| read_workcell_value(&document["workcell"], &LibraryOnly, &ReadLimits::default());
    let mut document = off_zero();
    let registered = read(&document).unwrap_or_else(|faults| panic!("{}", lines(&faults)));
    assert!(has(&registered.warnings, "/arms/0", FaultCode::OutOfRange));
    assert_eq!(registered.workcell.arms[0].home.as_slice(), [1.25, 0.25]);
    // What is kept for it is that of the problems with it.
    set(&mut document, "/initial_joints", json!({ "a": { "swing": 1.0 } }));
    assert_eq!(accepted(&document).problem.workcell_digest, registered.digest);
    set(&mut document, "/workcell/arms/0/home", json!({ "reach": 0.1 }));
    let registered = read(&document).unwrap_or_else(|faults| panic!("{}", lines(&faults)));
    assert!(has(&registered.warnings, "/arms/0/home", FaultCode::OutOfRange));
    assert_eq!(registered.workcell.arms[0].home.as_slice(), [1.25, 0.1]);
    set(&mut document, "/workcell/arms/0/home/swing", json!(0.4));
    assert!(has(&read(&document).unwrap_err(), "/arms/0/home/swing", FaultCode::OutOfRange));
    // The same for what an arm would run into.
    let block = json!({
        "id": "block", "shape": { "type": "box", "size": { "x": 0.1, "y": 0.1, "z": 0.1 } },
        "pose": { "position": { "x": 0.4, "y": 0.0, "z": 0.2 } },
    });
    let mut document = small();
    set(&mut document, "/workcell/obstacles/1", block);
    let registered = read(&document).unwrap_or_else(|faults| panic!("{}", lines(&faults)));
    assert!(has(&registered.warnings, "/arms/0", FaultCode::InitialCollision));
    set(&mut document, "/workcell/arms/0/home", json!({ "swing": 0.0 }));
    let registered = read(&document).unwrap_or_else(|faults| panic!("{}", lines(&faults)));
    assert!(has(&registered.warnings, "/arms/0/home", FaultCode::InitialCollision));
    set(&mut document, "/workcell/arms/0/home/reach", json!(0.0));
    assert!(has(&read(&document).unwrap_err(), "/arms/0/home", FaultCode::InitialCollision));
}
