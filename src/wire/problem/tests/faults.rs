//! Documents with one fault each.

use std::collections::BTreeSet;

use super::super::KnownRobots;
use super::*;
use crate::wire::{Folder, Remembering, ResourceError, Resources, read_problem};

/// What is done to a document, and the fault that must come of it.
struct Case {
    place: &'static str,
    value: Option<Value>,
    pointer: &'static str,
    code: FaultCode,
}

fn put(place: &'static str, value: Value, pointer: &'static str, code: FaultCode) -> Case {
    Case { place, value: Some(value), pointer, code }
}

fn at(place: &'static str, value: Value, code: FaultCode) -> Case {
    put(place, value, place, code)
}

fn without(place: &'static str, pointer: &'static str) -> Case {
    Case { place, value: None, pointer, code: FaultCode::MissingField }
}

fn check(make: fn() -> Value, cases: Vec<Case>) -> BTreeSet<FaultCode> {
    let mut codes = BTreeSet::new();
    for case in cases {
        let mut document = make();
        match case.value {
            Some(value) => set(&mut document, case.place, value),
            None => remove(&mut document, case.place),
        }
        let faults = read(&document).err().unwrap_or_default();
        assert!(
            has(&faults, case.pointer, case.code),
            "{} should give {} at {}, gives\n{}",
            case.place,
            case.code,
            case.pointer,
            lines(&faults)
        );
        for fault in &faults {
            assert!(document.pointer(&fault.pointer).is_some(), "nothing stands at {}", fault.pointer);
        }
        codes.insert(case.code);
    }
    codes
}

fn structure() -> Vec<Case> {
    use FaultCode::*;
    let quaternion = |w: f64| json!({ "x": 0.0, "y": 0.0, "z": 0.0, "w": w });
    vec![
        without("/schema", ""),
        without("/workcell", ""),
        without("/objects", ""),
        without("/initial", ""),
        without("/workcell/robots", "/workcell"),
        without("/workcell/arms", "/workcell"),
        without("/workcell/arms/1/id", "/workcell/arms/1"),
        without("/workcell/arms/1/robot", "/workcell/arms/1"),
        without("/workcell/arms/1/base", "/workcell/arms/1"),
        without("/workcell/arms/1/tool", "/workcell/arms/1"),
        without("/workcell/arms/1/tool/mount_link", "/workcell/arms/1/tool"),
        without("/workcell/robots/iiwa14/urdf", "/workcell/robots/iiwa14"),
        without("/workcell/obstacles/0/shape", "/workcell/obstacles/0"),
        without("/workcell/surfaces/0/size", "/workcell/surfaces/0"),
        without("/objects/0/id", "/objects/0"),
        without("/objects/0/shape/size/x", "/objects/0/shape/size"),
        without("/initial/cube_1", "/initial"),
        without("/initial/cube_1/pose", "/initial/cube_1"),
        without("/goal/cube_1/pose", "/goal/cube_1"),
        at("/extra", json!(1), UnknownField),
        at("/workcell/extra", json!(1), UnknownField),
        at("/workcell/arms/0/extra", json!(1), UnknownField),
        at("/workcell/arms/0/tool/extra", json!(1), UnknownField),
        at("/workcell/arms/0/base/extra", json!(1), UnknownField),
        at("/workcell/robots/iiwa14/a~1b", json!(1), UnknownField),
        at("/objects/0/shape/radius", json!(1), UnknownField),
        at("/objects/0/grasps/0/yaw_steps", json!(4), UnknownField),
        at("/initial/cube_1/surface", json!("table_a_top"), UnknownField),
        at("/options/budget", json!(1), UnknownField),
        put("/options/stop", json!({ "never": true }), "/options/stop/never", UnknownField),
        at("/schema", json!("quadrille.problem/2"), OutOfRange),
        at("/schema", json!(1), WrongType),
        at("/name", json!(1), WrongType),
        at("/workcell", json!([]), WrongType),
        at("/workcell/arms", json!({}), WrongType),
        at("/workcell/arms/0", json!("arm"), WrongType),
        at("/workcell/arms/0/home", json!([0.0]), WrongType),
        at("/workcell/arms/0/home/joint_1", json!("0"), WrongType),
        at("/workcell/surfaces/0/capacity", json!("many"), WrongType),
        at("/workcell/allowed_contacts/0", json!(["table_a"]), WrongType),
        at("/objects/0/mass", json!(null), WrongType),
        at("/initial", json!([]), WrongType),
        at("/goal/cube_1", json!(null), WrongType),
        at("/options/return_home", json!(1), WrongType),
        at("/workcell/arms", json!([]), OutOfRange),
        at("/objects/0/shape/size/x", json!(-0.06), OutOfRange),
        at("/objects/0/shape/size/x", json!(0), OutOfRange),
        at("/objects/0/shape/type", json!("cone"), OutOfRange),
        at("/objects/0/symmetry", json!("mirror"), OutOfRange),
        at("/objects/0/approach", json!(-0.1), OutOfRange),
        at("/objects/0/grasps/0/generator", json!("teeth"), OutOfRange),
        at("/objects/0/grasps/0/generator", json!("cylinder_side"), WrongType),
        at("/workcell/arms/0/tool/max_opening", json!(0), OutOfRange),
        at("/workcell/arms/0/tool/grasp_time_s", json!(-1), OutOfRange),
        at("/workcell/arms/0/home/joint_2", json!(3.0), OutOfRange),
        at("/workcell/surfaces/0/size/x", json!(-1), OutOfRange),
        at("/workcell/surfaces/0/capacity", json!(1.5), OutOfRange),
        put(
            "/workcell/arms/0/base/orientation",
            quaternion(2.0),
            "/workcell/arms/0/base/orientation",
            BadQuaternion,
        ),
        at("/initial/cube_1/pose/orientation", quaternion(1.00001), BadQuaternion),
        at("/initial/cube_1/pose/orientation", quaternion(0.0), BadQuaternion),
        at("/workcell/arms/0/id", json!("left arm"), BadId),
        at("/workcell/surfaces/0/id", json!(""), BadId),
        at("/objects/0/id", json!("a/b"), BadId),
        at("/objects/1/id", json!("cube_1"), DuplicateId),
        at("/workcell/arms/0/id", json!("table_a"), DuplicateId),
        at("/workcell/surfaces/1/id", json!("table_b"), DuplicateId),
    ]
}

fn options() -> Vec<Case> {
    use FaultCode::*;
    vec![
        at("/options/time_budget_s", json!(0), OutOfRange),
        at("/options/time_budget_s", json!(1e9), OutOfRange),
        at("/options/max_iterations", json!(0), OutOfRange),
        at("/options/seed", json!(-1), OutOfRange),
        at("/options/threads", json!(0), OutOfRange),
        at("/options/threads", json!(65), OutOfRange),
        at("/options/ik_solutions", json!(0), OutOfRange),
        at("/options/clearance_m", json!(-0.001), OutOfRange),
        at("/options/guidance", json!("wise"), OutOfRange),
        at("/options/objective", json!("beauty"), OutOfRange),
        at("/options/schedule", json!("lazy"), OutOfRange),
        at("/options/schedule", json!("asynchronous"), NotImplemented),
        put(
            "/options/stop",
            json!({ "target_duration_s": 0 }),
            "/options/stop/target_duration_s",
            OutOfRange,
        ),
    ]
}

fn names() -> Vec<Case> {
    use FaultCode::*;
    vec![
        at("/workcell/arms/0/robot", json!("r2d2"), UnknownRobot),
        at("/workcell/arms/0/tool/mount_link", json!("flansch"), UnknownLink),
        at("/workcell/arms/1/tool/mount_link", json!("flansch"), UnknownLink),
        at("/workcell/arms/0/home/joint_8", json!(0.0), UnknownJoint),
        put(
            "/workcell/arms/0/limits",
            json!({ "elbow": { "velocity": 1.0 } }),
            "/workcell/arms/0/limits/elbow",
            UnknownJoint,
        ),
        put(
            "/workcell/robots/iiwa14/limits",
            json!({ "elbow": { "velocity": 1.0 } }),
            "/workcell/robots/iiwa14/limits/elbow",
            UnknownJoint,
        ),
        put(
            "/initial_joints",
            json!({ "arm_1": { "elbow": 0 } }),
            "/initial_joints/arm_1/elbow",
            UnknownJoint,
        ),
        put("/initial_joints", json!({ "arm_9": {} }), "/initial_joints/arm_9", UnknownBody),
        at("/workcell/surfaces/0/on", json!("arm_1"), UnknownBody),
        at("/workcell/allowed_contacts/0/0", json!("moon"), UnknownBody),
        at("/workcell/allowed_contacts/0/1", json!("arm_1/link_99"), UnknownBody),
        put(
            "/initial/cube_1",
            json!({ "held_by": "arm_3", "object_in_tcp": {} }),
            "/initial/cube_1/held_by",
            UnknownBody,
        ),
        at("/goal/cube_9", json!({ "surface": "table_a_top" }), UnknownObject),
        at("/initial/cube_9", json!({ "pose": {} }), UnknownObject),
        put("/goal/cube_1", json!({ "surface": "table_a" }), "/goal/cube_1/surface", UnknownSurface),
    ]
}

fn references() -> Vec<Case> {
    use FaultCode::*;
    let urdf = "/workcell/robots/iiwa14/urdf";
    let mesh = |uri: &str| json!({ "type": "mesh", "uri": uri });
    vec![
        at(urdf, json!("library:r2d2"), UnresolvedUri),
        at(urdf, json!("robots/arm.urdf"), UnresolvedUri),
        at(urdf, json!("../arm.urdf"), UnresolvedUri),
        at(urdf, json!("/etc/passwd"), UnresolvedUri),
        at(urdf, json!("http://example.org/arm.urdf"), UnresolvedUri),
        at("/workcell/robots/iiwa14/srdf", json!("arm.srdf"), UnresolvedUri),
        put(
            "/workcell/robots/iiwa14/package_map",
            json!({ "p": "../p" }),
            "/workcell/robots/iiwa14/package_map/p",
            UnresolvedUri,
        ),
        put("/objects/0/shape", mesh("cup.stl"), "/objects/0/shape/uri", UnresolvedUri),
        put(
            "/workcell/robots/iiwa14/urdf_xml",
            json!("<robot/>"),
            "/workcell/robots/iiwa14/urdf_xml",
            OutOfRange,
        ),
        put("/workcell/robots/iiwa14/srdf_xml", json!("<robot"), "/workcell/robots/iiwa14/srdf_xml", BadSrdf),
        put(
            "/workcell/robots/iiwa14/srdf_xml",
            json!("<robot><disable_collisions link1='a' link2='b'/></robot>"),
            "/workcell/robots/iiwa14/srdf_xml",
            UnknownLink,
        ),
    ]
}

fn urdfs() -> Vec<Case> {
    use FaultCode::*;
    let place = "/workcell/robots/small/urdf_xml";
    let replaced = |from: &str, to: &str| {
        assert!(SMALL_URDF.contains(from));
        json!(SMALL_URDF.replace(from, to))
    };
    let mesh = "<mesh filename=\"package://p/a.stl\"/>";
    vec![
        at(place, json!("<robot name='x'><link"), BadUrdf),
        at(place, json!(format!("<!DOCTYPE r [<!ENTITY a 'b'>]>{SMALL_URDF}")), BadUrdf),
        at(place, json!(""), BadUrdf),
        at(place, replaced("<parent link=\"boom\"/>", "<parent link=\"gone\"/>"), BadUrdf),
        at(place, replaced("<box size=\"0.1 0.1 0.1\"/>", mesh), UnresolvedUri),
        at(place, json!(" ".repeat(5 << 20)), TooLarge),
        put(place, replaced("velocity=\"1.5\"", "velocity=\"0\""), "/workcell/arms/0", OutOfRange),
        put(
            "/workcell/arms/0/limits",
            json!({ "swing": { "lower": 3.0 } }),
            "/workcell/arms/0/limits/swing",
            OutOfRange,
        ),
        put(
            "/workcell/arms/0/limits",
            json!({ "swing": { "velocity": 0 } }),
            "/workcell/arms/0/limits/swing/velocity",
            OutOfRange,
        ),
        put("/workcell/arms/0/home", json!({ "grip": 1e9 }), "/workcell/arms/0/home/grip", OutOfRange),
        put("/workcell/arms/0/home", json!({ "gripp": 0 }), "/workcell/arms/0/home/gripp", UnknownJoint),
        put("/workcell/arms/0/tool/mount_link", json!("root"), "/workcell/arms/0/tool/mount_link", BadUrdf),
    ]
}

fn geometry() -> Vec<Case> {
    use FaultCode::*;
    let obstacle = |x: f64, y: f64, z: f64| {
        json!({ "id": "block", "shape": { "type": "sphere", "radius": 0.05 },
                "pose": { "position": { "x": x, "y": y, "z": z } } })
    };
    let start = switch()["initial"]["cube_1"].clone();
    let goal = switch()["goal"]["cube_1"].clone();
    let coordinate = |placement: &Value, axis: &str| placement["pose"]["position"][axis].as_f64().unwrap();
    let near = |placement: &Value| obstacle(coordinate(placement, "x"), coordinate(placement, "y"), 0.72);
    let flat: Vec<Value> = (0..5).map(|i| json!({ "x": f64::from(i), "y": 0.0, "z": 0.0 })).collect();
    vec![
        put("/goal/cube_1", pose(-0.56, 0.0, 0.9), "/goal/cube_1/pose", NotResting),
        put("/initial/cube_1", pose(-0.56, 0.0, 0.675), "/initial/cube_1/pose", NotResting),
        put("/initial/cube_1", pose(-0.81, 0.0, 0.68), "/initial/cube_1/pose", NotResting),
        put(
            "/workcell/surfaces/2",
            json!({ "id": "again", "pose": { "position": { "x": -0.56, "y": 0.0, "z": 0.65 } },
                    "size": { "x": 0.5, "y": 0.5 } }),
            "/initial/cube_1/pose",
            NotResting,
        ),
        put("/initial/cube_2", start.clone(), "/initial/cube_2", Overlap),
        put("/goal/cube_2", goal.clone(), "/goal/cube_2", Overlap),
        put("/workcell/obstacles/4", near(&start), "/initial/cube_1", InitialCollision),
        put("/workcell/obstacles/4", near(&goal), "/goal/cube_1", GoalCollision),
        // In the shoulder of the first arm, at its home.
        put("/workcell/obstacles/4", obstacle(0.0, 0.0, 0.76), "/workcell/arms/0/home", InitialCollision),
        put("/workcell/allowed_contacts", json!([]), "/workcell/arms/1/home", InitialCollision),
        // Folded back into itself, and two arms in one place.
        put(
            "/initial_joints",
            json!({ "arm_2": { "joint_2": 0.0, "joint_4": 2.09, "joint_6": 2.09 } }),
            "/initial_joints/arm_2",
            InitialCollision,
        ),
        put(
            "/workcell/arms/1/base",
            json!({ "position": { "x": 0.1, "y": 0, "z": 0.4 } }),
            "/workcell/arms/1/home",
            InitialCollision,
        ),
        put(
            "/initial/cube_1",
            json!({ "held_by": "arm_1", "object_in_tcp": { "position": { "x": 0, "y": 0, "z": -0.4 } } }),
            "/initial/cube_1",
            InitialCollision,
        ),
        put("/workcell/surfaces/0/capacity", json!(0), "/initial", CapacityExceeded),
        put("/workcell/surfaces/1/capacity", json!(0), "/goal", CapacityExceeded),
        put(
            "/objects/0/shape",
            json!({ "type": "convex", "points": flat }),
            "/objects/0/shape/points",
            OutOfRange,
        ),
    ]
}

#[test]
fn each_code_has_its_document() {
    let mut codes = BTreeSet::new();
    codes.extend(check(switch, structure()));
    codes.extend(check(switch, options()));
    codes.extend(check(switch, names()));
    codes.extend(check(switch, references()));
    codes.extend(check(small, urdfs()));
    codes.extend(check(switch, geometry()));
    // Tests of their own below.
    use FaultCode::*;
    codes.extend([InvalidJson, NotFinite, BadMesh, GoalUnreachable, TooLarge]);
    let missing: Vec<_> = FaultCode::ALL.into_iter().filter(|code| !codes.contains(code)).collect();
    assert_eq!(missing, []);
}

fn first(bytes: &[u8], limits: &ReadLimits) -> Fault {
    read_problem(bytes, &LibraryOnly, limits).unwrap_err().remove(0)
}

#[test]
fn text_that_is_no_problem() {
    let limits = ReadLimits::default();
    for bytes in
        [&b""[..], b"{\"schema\": \"quadrille", b"\xff", b"NaN", b"{\"a\": NaN}", b"{\"a\": 1, \"a\": 2}"]
    {
        assert_eq!(first(bytes, &limits).code, FaultCode::InvalidJson, "{bytes:?}");
    }
    assert_eq!(first("[".repeat(200_000).as_bytes(), &limits).code, FaultCode::InvalidJson);
    assert_eq!(first(b"[]", &limits).code, FaultCode::WrongType);
    let huge = r#"{"options": {"time_budget_s": 1e999}}"#;
    let fault = first(huge.as_bytes(), &limits);
    assert_eq!((fault.code, fault.pointer.as_str()), (FaultCode::NotFinite, "/options/time_budget_s"));
}

#[test]
fn what_is_too_large_is_told_once() {
    let limits = ReadLimits { max_bytes: 100, ..ReadLimits::default() };
    assert_eq!(first(&[b' '; 101], &limits).code, FaultCode::TooLarge);
    let mut many = switch();
    let cube = many["objects"][0].clone();
    let names: Vec<String> = (0..10_000).map(|index| format!("c{index}")).collect();
    many["objects"] = names
        .iter()
        .map(|name| {
            let mut cube = cube.clone();
            cube["id"] = json!(name);
            cube
        })
        .collect();
    let place = many["initial"]["cube_1"].clone();
    many["initial"] = Value::Object(names.iter().map(|name| (name.clone(), place.clone())).collect());
    many["goal"] = many["initial"].clone();
    let faults = read(&many).unwrap_err();
    assert_eq!(faults.len(), 1, "{}", lines(&faults));
    assert!(has(&faults, "/objects", FaultCode::TooLarge) && faults[0].message.contains("10000"));
    let mut arms = switch();
    let arm = arms["workcell"]["arms"][0].clone();
    arms["workcell"]["arms"] = json!(vec![arm; 33]);
    assert!(has(&read(&arms).unwrap_err(), "/workcell/arms", FaultCode::TooLarge));
    let mut grasps = switch();
    grasps["objects"][0]["grasps"] = json!(vec![json!({ "generator": "top", "yaw_steps": 360 }); 2]);
    assert!(has(&read(&grasps).unwrap_err(), "/objects/0/grasps", FaultCode::TooLarge));
}

#[test]
fn a_box_symmetry_needs_a_box_about_the_origin() {
    let mut document = small();
    let corners = [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.06]];
    let points = corners.map(|[x, y, z]| json!({ "x": x, "y": y, "z": z }));
    set(&mut document, "/objects/0/shape", json!({ "type": "convex", "points": points }));
    set(&mut document, "/initial/ball", pose(0.0, 0.8, 0.1));
    assert!(read(&document).is_ok());
    set(&mut document, "/objects/0/symmetry", json!("box"));
    let read = read(&document).unwrap();
    assert!(has(&read.warnings, "/objects/0/symmetry", FaultCode::OutOfRange));
    let told = read.warnings.iter().any(|warning| warning.message.contains("(0.030000, 0.030000, 0.030000)"));
    assert!(told, "{}", lines(&read.warnings));
    assert_eq!(read.problem.objects[0].symmetry_rotations.len(), 1);
}

#[test]
fn limits_that_nobody_mends_are_faults_of_the_urdf() {
    let limit = "<limit lower=\"-2\" upper=\"2\" velocity=\"1.5\" effort=\"1\"/>";
    let crossed = "<limit lower=\"2\" upper=\"1\" velocity=\"-1\"/>";
    let negative = "<limit lower=\"-2\" upper=\"2\" velocity=\"1.5\" acceleration=\"-1\"/>";
    let crossed_message = "joint \"swing\": the lower limit 2 is above the upper limit 1";
    let negative_message = "joint \"swing\": the limit -1 of velocity or acceleration is negative";
    for (instead, given, message) in [
        ("", json!({}), "joint \"swing\" has no <limit>"),
        ("", json!({ "lower": -1.0, "velocity": 1.0 }), "joint \"swing\" has no <limit>"),
        ("", json!({ "lower": -1.0, "upper": 1.0, "acceleration": 1.0 }), "joint \"swing\" has no <limit>"),
        (crossed, json!({}), crossed_message),
        (crossed, json!({ "velocity": 1.0 }), crossed_message),
        (crossed, json!({ "upper": 1.5, "velocity": 1.0 }), crossed_message),
        // The next fault stands behind the first.
        (crossed, json!({ "upper": 3.0 }), negative_message),
        (negative, json!({ "velocity": 1.0 }), negative_message),
    ] {
        let mut document = small();
        let robot = "/workcell/robots/small";
        set(&mut document, &format!("{robot}/urdf_xml"), json!(SMALL_URDF.replace(limit, instead)));
        set(&mut document, &format!("{robot}/limits"), json!({ "swing": given }));
        let mut second = document["workcell"]["arms"][0].clone();
        second["id"] = json!("b");
        set(&mut document, "/workcell/arms/1", second);
        let faults = read(&document).unwrap_err();
        assert_eq!(faults.len(), 1, "{}", lines(&faults));
        assert!(has(&faults, &format!("{robot}/urdf_xml"), FaultCode::BadUrdf), "{}", lines(&faults));
        assert_eq!(faults[0].message, message);
    }
    // Limits of a finger are not replaced.
    let mut document = small();
    let urdf = SMALL_URDF.replace("upper=\"0.1\"", "upper=\"-0.1\"");
    set(&mut document, "/workcell/robots/small/urdf_xml", json!(urdf));
    let faults = read(&document).unwrap_err();
    assert!(has(&faults, "/workcell/robots/small/urdf_xml", FaultCode::BadUrdf), "{}", lines(&faults));
}

#[test]
fn robots_are_bounded_in_links_and_shapes() {
    let limits = ReadLimits { max_links: 4, max_link_shapes: 2, ..ReadLimits::default() };
    read_problem_value(&small(), &LibraryOnly, &limits).unwrap();
    for (limits, told) in [
        (ReadLimits { max_links: 3, ..limits.clone() }, "4 links, at most 3"),
        (ReadLimits { max_link_shapes: 1, ..limits.clone() }, "2 collision shapes, at most 1"),
    ] {
        let faults = read_problem_value(&small(), &LibraryOnly, &limits).unwrap_err();
        assert_eq!(faults.len(), 1, "{}", lines(&faults));
        assert!(has(&faults, "/workcell/robots/small/urdf_xml", FaultCode::TooLarge), "{}", lines(&faults));
        assert!(faults[0].message.contains(told), "{}", faults[0].message);
    }
}

#[test]
fn links_that_clump_together_are_refused_when_they_take_too_long() {
    // A wrist around all of the arm: the one pair that no joint joins overlaps always.
    let ball =
        "<link name=\"wrist\"><collision><geometry><sphere radius=\"2\"/></geometry></collision></link>";
    let mut document = small();
    document["workcell"]["robots"]["small"]["urdf_xml"] =
        json!(SMALL_URDF.replace("<link name=\"wrist\"/>", ball));
    let arm = document["workcell"]["arms"][0].clone();
    for (id, x) in [("b", 20.0), ("c", 40.0)] {
        let mut arm = arm.clone();
        arm["id"] = json!(id);
        arm["base"] = json!({ "position": { "x": x, "y": 0.0, "z": 0.0 } });
        document["workcell"]["arms"].as_array_mut().unwrap().push(arm);
    }
    let robots = KnownRobots::new();
    let resources = Remembering { resources: &LibraryOnly, robots: &robots };
    let pointer = "/workcell/robots/small/urdf_xml";
    // About 100 units in each of 951 configurations, whoever has looked before and however many arms ask.
    for (work, refused) in [(10_000, true), (10_000, true), (200_000, false)] {
        let limits = ReadLimits { max_overlap_work: work, ..ReadLimits::default() };
        let fresh = read_problem_value(&document, &LibraryOnly, &limits).err().unwrap_or_default();
        assert_eq!(has(&fresh, pointer, FaultCode::TooLarge), refused, "{}", lines(&fresh));
        let told = fresh.iter().filter(|fault| fault.code == FaultCode::TooLarge).count();
        assert_eq!(told, usize::from(refused));
        if refused {
            let again = read_problem_value(&document, &resources, &limits).unwrap_err();
            assert_eq!(lines(&again), lines(&fresh));
        }
    }
    // What has been found out costs a document as much as what has not.
    let robots = KnownRobots::new();
    let resources = Remembering { resources: &LibraryOnly, robots: &robots };
    document["workcell"]["arms"][1]["limits"] = json!({ "swing": { "upper": 1.0 } });
    let limits = ReadLimits { max_overlap_work: 150_000, ..ReadLimits::default() };
    for _ in 0..2 {
        let faults = read_problem_value(&document, &resources, &limits).unwrap_err();
        assert!(has(&faults, pointer, FaultCode::TooLarge), "{}", lines(&faults));
    }
}

#[test]
fn allowed_contacts_are_bounded_in_what_they_stand_for() {
    let mut document = switch();
    let both = [json!(["arm_1", "arm_2"]), json!(["arm_2", "arm_1"])];
    let mut pairs: Vec<Value> = both.iter().cycle().take(8000).cloned().collect();
    pairs.push(json!(["arm_1", "nobody"]));
    document["workcell"]["allowed_contacts"] = json!(pairs);
    assert!(has(&read(&document).unwrap_err(), "/workcell/allowed_contacts/8000/1", FaultCode::UnknownBody));
    // Seven arms of 256 links each, side by side.
    let link = |index: usize| {
        format!(
            "<link name=\"l{index}\"><collision><geometry><sphere radius=\"0.01\"/></geometry></collision></link>"
        )
    };
    let joint = |index: usize| {
        format!(
            "<joint name=\"j{index}\" type=\"revolute\"><parent link=\"l{}\"/><child link=\"l{index}\"/>\
             <origin xyz=\"0.1 0 0\"/><axis xyz=\"0 0 1\"/>\
             <limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint>",
            index - 1
        )
    };
    let (links, joints): (String, String) = ((0..256).map(link).collect(), (1..256).map(joint).collect());
    let mut document = small();
    document["workcell"]["robots"]["small"]["urdf_xml"] =
        json!(format!("<robot name=\"r\">{links}{joints}</robot>"));
    let arms: Vec<Value> = (0..7)
        .map(|index| {
            let base = json!({ "position": { "x": 0.0, "y": 2.0 + index as f64, "z": 1.0 } });
            json!({ "id": format!("a{index}"), "robot": "small", "base": base, "tool": { "mount_link": "l255" } })
        })
        .collect();
    document["workcell"]["arms"] = json!(arms);
    let pairs: Vec<Value> = (0..7)
        .flat_map(|one| (0..one).map(move |other| json!([format!("a{one}"), format!("a{other}")])))
        .collect();
    document["workcell"]["allowed_contacts"] = json!(pairs);
    let faults = read(&document).unwrap_err();
    assert_eq!(faults.len(), 1, "{}", lines(&faults));
    assert!(has(&faults, "/workcell/allowed_contacts", FaultCode::TooLarge), "{}", lines(&faults));
}

#[test]
fn a_goal_beyond_every_arm_names_its_object() {
    let mut document = switch();
    set(
        &mut document,
        "/workcell/surfaces/2",
        json!({ "id": "far", "pose": { "position": { "x": 9.0, "y": 0.0, "z": 0.0 } }, "size": { "x": 1.0, "y": 1.0 } }),
    );
    for goal in [pose(9.0, 0.0, 0.03), json!({ "surface": "far" })] {
        set(&mut document, "/goal/cube_2", goal);
        let faults = read(&document).unwrap_err();
        assert_eq!(faults.len(), 1, "{}", lines(&faults));
        assert!(has(&faults, "/goal/cube_2", FaultCode::GoalUnreachable));
        assert!(faults[0].message.contains("`cube_2`"));
    }
}

#[test]
fn meshes_and_files_resolve_inside_the_folder_only() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("p/meshes")).unwrap();
    let tetrahedron = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";
    std::fs::write(folder.path().join("p/meshes/a.obj"), tetrahedron).unwrap();
    std::fs::write(folder.path().join("broken.stl"), "solid nothing").unwrap();
    let with_mesh = SMALL_URDF
        .replace("<box size=\"0.1 0.1 0.1\"/>", "<mesh filename=\"package://parts/meshes/a.obj\"/>")
        .replace("<box size=\"0.4 0.05 0.05\"/>", "<mesh filename=\"meshes/a.obj\"/>");
    std::fs::write(folder.path().join("p/arm.urdf"), &with_mesh).unwrap();
    let resources = Folder::new(folder.path());
    let read = |document: &Value| read_problem_value(document, &resources, &ReadLimits::default());
    let mut document = small();
    document["workcell"]["robots"]["small"] =
        json!({ "urdf": "p/arm.urdf", "package_map": { "parts": "p" } });
    let good = read(&document).unwrap();
    assert!(good.warnings.iter().any(|warning| warning.code == FaultCode::BadMesh));
    assert_eq!(good.problem.workcell.arms[0].model.links[0].shapes.len(), 1);
    // The digest follows what the meshes hold.
    std::fs::write(folder.path().join("p/meshes/a.obj"), tetrahedron.replace("0.1", "0.2")).unwrap();
    assert_ne!(read(&document).unwrap().problem.digest, good.problem.digest);
    document["workcell"]["robots"]["small"]["package_map"] = json!({});
    assert!(has(&read(&document).unwrap_err(), "/workcell/robots/small/urdf", FaultCode::UnresolvedUri));
    let mut document = small();
    document["objects"][0]["shape"] = json!({ "type": "mesh", "uri": "broken.stl" });
    assert!(has(&read(&document).unwrap_err(), "/objects/0/shape/uri", FaultCode::BadMesh));
    document["objects"][0]["shape"]["uri"] = json!("p/meshes/a.obj");
    document["initial"]["ball"]["pose"]["position"]["z"] = json!(0.1);
    let whole = read(&document).unwrap();
    assert_eq!(whole.problem.objects[0].shapes.len(), 1);
    let warned = |read: &ReadProblem, place: &str| {
        read.warnings.iter().any(|w| w.code == FaultCode::BadMesh && w.pointer == place)
    };
    assert!(warned(&whole, "/objects/0/shape/uri"));
    // The same twice, as two objects of one file: it counts as both, wherever it is used.
    let second = "o two\nv 0 0 0\nv -0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 5 6 7\nf 5 6 8\nf 5 7 8\nf 6 7 8\n";
    std::fs::write(folder.path().join("two.obj"), format!("o one\n{tetrahedron}{second}")).unwrap();
    document["objects"][0]["shape"]["uri"] = json!("two.obj");
    let shape = document["objects"][0]["shape"].clone();
    document["workcell"]["arms"][0]["tool"]["collision"] = json!([{ "shape": shape }]);
    let pose = json!({ "position": { "x": 3.0, "y": 3.0, "z": 3.0 } });
    let angle = json!({ "id": "angle", "shape": shape, "pose": pose });
    document["workcell"]["obstacles"].as_array_mut().unwrap().push(angle);
    let read = read(&document).unwrap();
    let cell = &read.problem.workcell;
    for shapes in [&read.problem.objects[0].shapes, &cell.arms[0].tool.shapes, &cell.obstacles[1].shapes] {
        assert_eq!(shapes.len(), 2);
    }
    assert!(!warned(&read, "/objects/0/shape/uri"), "{}", lines(&read.warnings));
}

/// Files by name, with a count of how often one is read.
struct Files {
    files: Vec<(String, String)>,
    reads: std::cell::Cell<usize>,
}

impl Resources for Files {
    fn read(&self, path: &str, _max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        self.reads.set(self.reads.get() + 1);
        let found = self.files.iter().find(|(name, _)| name == path);
        found.map(|(_, text)| text.clone().into_bytes()).ok_or(ResourceError::NotFound)
    }
}

/// The same tetrahedron as `m0.obj` to `m9.obj`, and a flat mesh.
fn mesh_files() -> Files {
    let tetrahedron = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf\t1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";
    let mut files: Vec<_> = (0..10).map(|index| (format!("m{index}.obj"), tetrahedron.to_owned())).collect();
    files.push(("flat.obj".to_owned(), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n".to_owned()));
    Files { files, reads: std::cell::Cell::new(0) }
}

/// The small cell with these meshes as further obstacles, far from all.
fn with_meshes(shapes: impl IntoIterator<Item = Value>) -> Value {
    let mut document = small();
    for (index, shape) in shapes.into_iter().enumerate() {
        let position = json!({ "x": 5.0 + index as f64, "y": 5.0, "z": 0.0 });
        let obstacle = json!({ "id": format!("m{index}"), "shape": shape, "pose": { "position": position } });
        document["workcell"]["obstacles"].as_array_mut().unwrap().push(obstacle);
    }
    document
}

fn mesh(uri: &str) -> Value {
    json!({ "type": "mesh", "uri": uri })
}

#[test]
fn a_mesh_that_is_used_often_is_loaded_once() {
    let limits = ReadLimits { max_triangles: 4, ..ReadLimits::default() };
    let files = mesh_files();
    let document = with_meshes((0..40).map(|index| mesh(if index % 2 == 0 { "m0.obj" } else { "./m0.obj" })));
    let read = read_problem_value(&document, &files, &limits).unwrap();
    assert_eq!(files.reads.get(), 1);
    let meshes: Vec<_> =
        read.problem.workcell.obstacles[1..].iter().map(|body| &body.shapes[0].shape).collect();
    assert!(meshes.iter().all(|shape| *shape == meshes[0]));
    assert_eq!(read.warnings.iter().filter(|warning| warning.code == FaultCode::BadMesh).count(), 40);
    // One that is no good is a fault wherever it stands, and is loaded once as well.
    let files = mesh_files();
    let faults =
        read_problem_value(&with_meshes((0..30).map(|_| mesh("flat.obj"))), &files, &limits).unwrap_err();
    assert_eq!((files.reads.get(), faults.len()), (1, 30), "{}", lines(&faults));
    assert!(has(&faults, "/workcell/obstacles/30/shape/uri", FaultCode::BadMesh));
    // A robot's links share it too.
    let files = mesh_files();
    let mut document = with_meshes([mesh("m0.obj")]);
    let link = "<mesh filename=\"m0.obj\"/>";
    document["workcell"]["robots"]["small"]["urdf_xml"] = json!(
        SMALL_URDF
            .replace("<box size=\"0.1 0.1 0.1\"/>", link)
            .replace("<box size=\"0.4 0.05 0.05\"/>", link)
    );
    read_problem_value(&document, &files, &limits).unwrap();
    assert_eq!(files.reads.get(), 1);
}

#[test]
fn all_meshes_together_are_bounded() {
    let limits = ReadLimits { max_triangles: 4, ..ReadLimits::default() };
    assert_eq!(limits.max_triangles_together(), 16);
    let faults_of = |document: &Value| read_problem_value(document, &mesh_files(), &limits).unwrap_err();
    let within = with_meshes((0..4).map(|index| mesh(&format!("m{index}.obj"))));
    read_problem_value(&within, &mesh_files(), &limits).unwrap();
    let files = with_meshes((0..6).map(|index| mesh(&format!("m{index}.obj"))));
    // Another scale makes another mesh.
    let scales = with_meshes((1..7).map(
        |factor| json!({ "type": "mesh", "uri": "m0.obj", "scale": { "x": factor, "y": 1.0, "z": 1.0 } }),
    ));
    for document in [files, scales] {
        let faults = faults_of(&document);
        assert_eq!(faults.len(), 2, "{}", lines(&faults));
        for pointer in ["/workcell/obstacles/5/shape/uri", "/workcell/obstacles/6/shape/uri"] {
            assert!(has(&faults, pointer, FaultCode::TooLarge), "{}", lines(&faults));
        }
    }
    // Those of a robot count with the others, and one that is too large by itself says so.
    let mut robot = with_meshes((0..4).map(|index| mesh(&format!("m{index}.obj"))));
    let urdf = SMALL_URDF.replace("<box size=\"0.1 0.1 0.1\"/>", "<mesh filename=\"m9.obj\"/>");
    robot["workcell"]["robots"]["small"]["urdf_xml"] = json!(urdf);
    let faults = faults_of(&robot);
    assert!(has(&faults, "/workcell/robots/small/urdf_xml", FaultCode::TooLarge), "{}", lines(&faults));
    let limits = ReadLimits { max_triangles: 3, ..ReadLimits::default() };
    let faults = read_problem_value(&with_meshes([mesh("m0.obj")]), &mesh_files(), &limits).unwrap_err();
    assert!(has(&faults, "/workcell/obstacles/1/shape/uri", FaultCode::TooLarge), "{}", lines(&faults));
}

#[test]
fn faults_come_all_at_once() {
    let mut document = switch();
    set(&mut document, "/extra", json!(1));
    set(&mut document, "/options/threads", json!(0));
    set(&mut document, "/workcell/arms/1/robot", json!("r2d2"));
    set(&mut document, "/workcell/arms/0/home/joint_9", json!(0));
    set(&mut document, "/workcell/arms/0/home/joint_8", json!(0));
    set(&mut document, "/initial/cube_1", pose(-0.56, 0.0, 0.9));
    set(&mut document, "/goal/cube_2/pose/orientation/w", json!(7));
    let faults = read(&document).unwrap_err();
    for (pointer, code) in [
        ("/extra", FaultCode::UnknownField),
        ("/options/threads", FaultCode::OutOfRange),
        ("/workcell/arms/1/robot", FaultCode::UnknownRobot),
        ("/workcell/arms/0/home/joint_9", FaultCode::UnknownJoint),
        ("/workcell/arms/0/home/joint_8", FaultCode::UnknownJoint),
        ("/initial/cube_1/pose", FaultCode::NotResting),
        ("/goal/cube_2/pose/orientation", FaultCode::BadQuaternion),
    ] {
        assert!(has(&faults, pointer, code), "{pointer} {code}\n{}", lines(&faults));
    }
    assert_eq!(faults.len(), 7, "{}", lines(&faults));
}

#[test]
fn collisions_name_both_bodies_and_the_depth() {
    let mut document = switch();
    set(&mut document, "/workcell/allowed_contacts", json!([]));
    let faults = read(&document).unwrap_err();
    let message = &faults[0].message;
    assert!(message.contains("`arm_1/link_0`") && message.contains("`pedestal_1`"), "{message}");
    // The base's capsule reaches its radius below the mounting plane, on which the pedestal ends.
    assert!(message.contains("133.0 mm"), "{message}");
    let home = "/workcell/arms/0/home";
    assert!(has(&faults, home, FaultCode::InitialCollision));
}
