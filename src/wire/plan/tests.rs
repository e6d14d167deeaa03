//! Plans go out and come back; broken ones are told what is wrong.

use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::geometry::{Pose, Vec3};
use crate::plan::{Action, ActionKind, ArmTrajectory, Metrics, StepsProof, TrajectoryPoint, Verification};
use crate::scenario::{Family, generate};
use crate::wire::{FaultCode, LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

fn problem() -> Problem {
    let document = generate(Family::Switch, 2, 2, 0).unwrap();
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-4.0..4.0_f64, Just(0.0), Just(-0.0), -1e-9..1e-9_f64, Just(0.1 + 0.2)]
}

fn pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(number()), prop::array::uniform3(-3.0..3.0_f64))
        .prop_map(|(p, a)| Pose::new(Vec3::from(p), Vec3::from(a)))
}

fn kind() -> impl Strategy<Value = ActionKind> {
    let arm = || (0..2_usize).prop_map(ArmId);
    let surface = || (0..2_usize).prop_map(SurfaceId);
    prop_oneof![
        (arm(), pose(), surface()).prop_map(|(arm, object_in_tcp, surface)| ActionKind::Pick {
            arm,
            object_in_tcp,
            surface
        }),
        (arm(), pose(), pose(), surface()).prop_map(|(arm, object_in_tcp, object_pose, surface)| {
            ActionKind::Place { arm, object_in_tcp, object_pose, surface }
        }),
        (arm(), arm(), pose(), pose()).prop_map(|(arm, to_arm, object_in_tcp, to_object_in_tcp)| {
            ActionKind::Handoff { arm, to_arm, object_in_tcp, to_object_in_tcp }
        }),
    ]
}

fn plan() -> impl Strategy<Value = Plan> {
    let row = || prop::collection::vec(number(), 7);
    let point = (number(), row(), row(), row()).prop_map(|(t, q, qd, qdd)| TrajectoryPoint { t, q, qd, qdd });
    let arm = prop::collection::vec(point, 2..5).prop_map(|points| ArmTrajectory { points });
    let action = (1..9_usize, 0.0..20.0_f64, (0..2_usize).prop_map(ObjectId), kind())
        .prop_map(|(step, t, object, kind)| Action { step, t, object, kind });
    let proof = prop_oneof![Just(StepsProof::None), Just(StepsProof::Bounds), Just(StepsProof::Ilp)];
    let metrics =
        (0.0..50.0_f64, 0.0..50.0_f64, 0.0..9.0_f64, 0..20_usize, prop::option::of(0..9_usize), proof);
    let metrics =
        metrics.prop_map(|(duration_s, found_after_s, arc_length, count, optimum, steps_proof)| Metrics {
            duration_s,
            duration_synchronous_s: duration_s * 1.1,
            arc_length,
            actions: count,
            steps: count / 2,
            mode_graph_optimum: optimum,
            steps_lower_bound: count / 3,
            steps_proof,
            found_after_s,
        });
    let verification = (any::<bool>(), prop::option::of(number()), 0.0..9.0_f64, any::<bool>());
    let verification = verification.prop_map(|(valid, min_clearance_m, at_t, named)| Verification {
        valid,
        min_clearance_m,
        at_t: if named { at_t } else { 0.0 },
        bodies: named.then(|| ["arm_1/link_4".to_owned(), "arm_2/@tool".to_owned()]),
    });
    let parts = (
        prop::collection::vec(arm, 2),
        prop::collection::vec(action, 0..6),
        metrics,
        prop::option::of(verification),
        1..99_u64,
    );
    parts.prop_map(|(arms, actions, metrics, verification, revision)| Plan {
        problem_digest: "sha256:00".to_owned(),
        revision,
        metrics,
        arms,
        actions,
        verification,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_plan_comes_back_bit_for_bit(plan in plan()) {
        let problem = problem();
        let text = to_json(&problem, &plan);
        prop_assert!(!text.contains('\n') && !text.contains("precedence"));
        let again = read_plan(text.as_bytes(), &problem).unwrap();
        prop_assert_eq!(&again, &plan);
        // Also zeros keep their signs.
        prop_assert_eq!(to_json(&problem, &again), text);
    }
}

fn valid() -> Value {
    let pose = json!({"position": {"x": 0.1, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}});
    let names: Vec<String> = (1..=7).map(|i| format!("joint_{i}")).collect();
    let zero = [0.0; 7];
    let points = json!([
        {"t": 0.0, "q": zero, "qd": zero, "qdd": zero},
        {"t": 1.5, "q": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "qd": zero, "qdd": zero},
    ]);
    json!({
        "schema": "quadrille.plan/1", "problem_digest": "sha256:00", "revision": 1, "schedule": "synchronous",
        "metrics": {"duration_s": 1.5, "arc_length": 1.0, "actions": 2, "steps": 1},
        "arms": [
            {"id": "arm_2", "joint_names": names, "points": points},
            {"id": "arm_1", "joint_names": names, "points": points},
        ],
        "actions": [
            {"id": 0, "step": 1, "t": 1.0, "kind": "pick", "object": "cube_1", "arm": "arm_1",
             "object_in_tcp": pose, "surface": "table_a_top"},
            {"id": 1, "step": 2, "t": 1.5, "kind": "handoff", "object": "cube_1", "arm": "arm_1", "to_arm": "arm_2",
             "object_in_tcp": pose, "to_object_in_tcp": pose},
        ],
    })
}

#[test]
fn unknown_fields_and_foreign_orders_are_accepted() {
    let problem = problem();
    let mut document = valid();
    document["extra"] = json!({"a": 1});
    document["actions"][0]["object_in_tcp"]["frame"] = json!("tcp");
    let mut names: Vec<Value> = document["arms"][0]["joint_names"].as_array().unwrap().clone();
    names.reverse();
    document["arms"][0]["joint_names"] = json!(names);
    let plan = read_plan_value(&document, &problem).unwrap();
    assert_eq!(plan.arms[1].points[1].q, [7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0]);
    assert_eq!(plan.arms[0].points[1].q, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(plan.verification, None);
}

#[test]
fn every_fault_is_told_with_its_place() {
    let problem = problem();
    let cases: [(&str, Value, &str, FaultCode); 16] = [
        ("/schema", json!("quadrille.plan/2"), "/schema", FaultCode::OutOfRange),
        ("/schedule", json!("asynchronous"), "/schedule", FaultCode::NotImplemented),
        ("/revision", json!(-1), "/revision", FaultCode::OutOfRange),
        ("/metrics/steps", json!("six"), "/metrics/steps", FaultCode::WrongType),
        ("/metrics", json!({}), "/metrics", FaultCode::MissingField),
        ("/arms", json!([]), "/arms", FaultCode::MissingField),
        ("/arms/0/id", json!("arm_9"), "/arms/0/id", FaultCode::UnknownBody),
        ("/arms/0/id", json!("arm_1"), "/arms/1/id", FaultCode::DuplicateId),
        ("/arms/0/joint_names/3", json!("joint_9"), "/arms/0/joint_names/3", FaultCode::UnknownJoint),
        ("/arms/0/joint_names/3", json!("joint_1"), "/arms/0/joint_names/3", FaultCode::DuplicateId),
        ("/arms/0/points/1/q", json!([1.0]), "/arms/0/points/1/q", FaultCode::WrongType),
        ("/arms/0/points/1/q/2", json!(null), "/arms/0/points/1/q/2", FaultCode::WrongType),
        ("/actions/0/object", json!("blue"), "/actions/0/object", FaultCode::UnknownObject),
        ("/actions/0/surface", json!("floor"), "/actions/0/surface", FaultCode::UnknownSurface),
        ("/actions/1/kind", json!("throw"), "/actions/1/kind", FaultCode::OutOfRange),
        (
            "/actions/1/object_in_tcp/orientation/w",
            json!(2.0),
            "/actions/1/object_in_tcp/orientation",
            FaultCode::BadQuaternion,
        ),
    ];
    assert!(read_plan_value(&valid(), &problem).is_ok());
    for (place, value, pointer, code) in cases {
        let mut document = valid();
        *document.pointer_mut(place).unwrap() = value;
        let faults = read_plan_value(&document, &problem).unwrap_err();
        assert!(
            faults.iter().any(|fault| fault.pointer == pointer && fault.code == code),
            "{place}: {faults:?}"
        );
    }
    assert_eq!(read_plan(b"", &problem).unwrap_err()[0].code, FaultCode::InvalidJson);
    assert!(read_plan(b"[]", &problem).is_err());
}
