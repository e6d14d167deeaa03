//! What good documents mean.

use std::sync::Arc;

use super::super::KnownRobots;
use super::*;
use crate::problem::{
    ContactPartner, GoalPlacement, GuidanceKind, InitialPlacement, Objective, Options, Stop,
};
use crate::wire::Remembering;
use crate::workcell::{ArmBody, ArmId, ObjectId, ObstacleId, SurfaceId, Symmetry};

#[test]
fn the_switch_has_what_it_says() {
    let problem = accepted(&switch()).problem;
    let cell = &problem.workcell;
    let arm = &cell.arms[1];
    assert_eq!((arm.id.as_str(), arm.model.dof()), ("arm_2", 7));
    assert!((arm.base.translation.vector.x - 1.10).abs() < 1e-12);
    assert!((arm.home[3] + 110_f64.to_radians()).abs() < 1e-8);
    assert_eq!(arm.tool.shapes.len(), 3);
    assert!((arm.tool.tcp.translation.vector.z - 0.15).abs() < 1e-12);
    assert_eq!(arm.hand_groups, vec![arm.mount_group()]);
    // The neighbours along the chain, with all that hangs on them, and the library's SRDF, with nothing but what it names.
    let link = |index| ArmBody::Link(index);
    for pair in [(0, 1), (3, 4), (6, 7), (5, 7)] {
        assert!(!arm.checks_bodies(link(pair.0), link(pair.1)), "{pair:?}");
    }
    assert!(!arm.checks_bodies(ArmBody::Tool, link(6)) && !arm.checks_bodies(ArmBody::Tool, link(7)));
    assert!(arm.checks_bodies(link(0), link(2)) && arm.checks_bodies(link(1), link(7)));
    assert!(arm.checks_bodies(ArmBody::Tool, link(5)));
    assert_eq!(cell.surfaces[0].carrier, Some(ObstacleId(0)));
    let pedestals = [(ArmId(0), link(0), ObstacleId(2)), (ArmId(1), link(0), ObstacleId(3))];
    assert_eq!(cell.allowed_arm_obstacle, pedestals);
    assert!(matches!(problem.initial[0], InitialPlacement::Resting { surface: SurfaceId(0), .. }));
    assert!(matches!(problem.goal[0], GoalPlacement::Pose { surface: SurfaceId(1), .. }));
    assert_eq!(problem.options, Options { time_budget_s: 30.0, seed: 0, ..Options::default() });
    assert_eq!(problem.initial_joints[0], cell.arms[0].home);
    assert!(std::sync::Arc::ptr_eq(&cell.arms[0].model, &arm.model));
}

#[test]
fn absent_parts_have_the_formats_defaults() {
    let read = accepted(&small());
    let problem = read.problem;
    let arm = &problem.workcell.arms[0];
    assert_eq!(arm.tool.max_opening, 0.10);
    assert_eq!(arm.tool.grasp_time, 0.0);
    assert_eq!(arm.home.as_slice(), [0.0, 0.0]);
    let ball = &problem.objects[0];
    assert_eq!((ball.approach, ball.retreat, ball.symmetry), (0.08, 0.08, Symmetry::None));
    assert_eq!(ball.grasps.len(), 8);
    assert!(matches!(problem.goal[0], GoalPlacement::Anywhere));
    assert_eq!(problem.options, Options::default());
    // Five times the velocity, and a warning.
    assert_eq!(arm.limits.iter().map(|limit| limit.acceleration).collect::<Vec<_>>(), [7.5, 2.0]);
    assert_eq!(read.warnings.len(), 1);
    assert_eq!(
        (read.warnings[0].pointer.as_str(), read.warnings[0].code),
        ("/workcell/arms/0", FaultCode::MissingField)
    );
    // The finger hangs on the wrist: both are the hand.
    assert_eq!(arm.hand_groups, [2, 3]);
}

#[test]
fn limits_of_the_arm_win_over_those_of_the_robot_over_the_urdf() {
    let mut document = small();
    set(
        &mut document,
        "/workcell/robots/small/limits",
        json!({ "swing": { "velocity": 2.0, "acceleration": 3.0, "lower": -2.5 }, "reach": { "acceleration": 1.0 } }),
    );
    set(&mut document, "/workcell/arms/0/limits", json!({ "swing": { "velocity": 0.5, "upper": 3.0 } }));
    let read = accepted(&document);
    let limits = &read.problem.workcell.arms[0].limits;
    let swing = limits[0];
    assert_eq!((swing.lower, swing.upper, swing.velocity, swing.acceleration), (-2.5, 3.0, 0.5, 3.0));
    assert_eq!((limits[1].upper, limits[1].velocity, limits[1].acceleration), (0.5, 0.4, 1.0));
    assert!(read.warnings.is_empty());
}

#[test]
fn limits_of_joints_beyond_the_hand_say_nothing() {
    let mut document = small();
    let limits = json!({ "grip": { "velocity": 0.1, "upper": 0.02 }, "swing": { "velocity": 0.5 } });
    set(&mut document, "/workcell/robots/small/limits", limits);
    let read = accepted(&document);
    assert_eq!(read.problem.workcell.arms[0].limits[0].velocity, 0.5);
    let warned: Vec<_> =
        read.warnings.iter().filter(|warning| warning.code == FaultCode::UnknownJoint).collect();
    assert_eq!(warned.len(), 1, "{}", lines(&read.warnings));
    assert_eq!(warned[0].pointer, "/workcell/robots/small/limits/grip");
    // What the robot does not have at all is a slip of the pen.
    set(&mut document, "/workcell/robots/small/limits/gripp", json!({ "velocity": 0.1 }));
    let faults = super::read(&document).unwrap_err();
    assert_eq!(faults.len(), 1, "{}", lines(&faults));
    assert!(has(&faults, "/workcell/robots/small/limits/gripp", FaultCode::UnknownJoint));
}

#[test]
fn limits_that_the_urdf_lacks_may_come_from_elsewhere() {
    let limit = "<limit lower=\"-2\" upper=\"2\" velocity=\"1.5\" effort=\"1\"/>";
    assert!(SMALL_URDF.contains(limit));
    let swing = |instead: &str, robot: Value, arm: Value| {
        let mut document = small();
        set(&mut document, "/workcell/robots/small/urdf_xml", json!(SMALL_URDF.replace(limit, instead)));
        set(&mut document, "/workcell/robots/small/limits", json!({ "swing": robot }));
        set(&mut document, "/workcell/arms/0/limits", json!({ "swing": arm }));
        let limits = accepted(&document).problem.workcell.arms[0].limits[0];
        (limits.lower, limits.upper, limits.velocity, limits.acceleration)
    };
    let (ends, speed) = (json!({ "lower": -1.0, "upper": 2.5 }), json!({ "velocity": 0.5 }));
    assert_eq!(swing("", ends.clone(), speed.clone()), (-1.0, 2.5, 0.5, 2.5));
    assert_eq!(swing("", speed.clone(), ends), (-1.0, 2.5, 0.5, 2.5));
    // What the URDF does say stays.
    let crossed = "<limit lower=\"2\" upper=\"1\" velocity=\"1.5\"/>";
    assert_eq!(swing(crossed, json!({ "lower": -1.0 }), json!({})), (-1.0, 1.0, 1.5, 7.5));
    assert_eq!(
        swing(crossed, json!({ "lower": 3.0 }), json!({ "upper": 4.0, "lower": -4.0 })),
        (-4.0, 4.0, 1.5, 7.5)
    );
    let negative = "<limit lower=\"-2\" upper=\"2\" velocity=\"-1.5\" acceleration=\"-1\"/>";
    assert_eq!(swing(negative, speed, json!({ "acceleration": 3.0 })), (-2.0, 2.0, 0.5, 3.0));
}

#[test]
fn joints_beyond_the_hand_stand_where_home_puts_them() {
    let mut document = small();
    set(&mut document, "/workcell/arms/0/home", json!({ "grip": 0.07, "reach": 0.1 }));
    set(&mut document, "/initial_joints", json!({ "a": { "swing": -0.5 } }));
    let problem = accepted(&document).problem;
    let arm = &problem.workcell.arms[0];
    assert_eq!(arm.home.as_slice(), [0.0, 0.1]);
    assert_eq!(problem.initial_joints[0].as_slice(), [-0.5, 0.1]);
    let mut poses = Vec::new();
    arm.model.link_poses(&arm.home, &mut poses);
    let finger = poses[arm.model.link_index("finger").unwrap()].translation.vector;
    assert!((finger - crate::geometry::Vec3::new(0.6, 0.07, 0.2)).norm() < 1e-12);
}

#[test]
fn what_is_held_may_touch_fingers_beside_the_mount_link() {
    // The tool's frame is a link of its own, and the finger around the ball hangs on the one before.
    let finger = "<link name=\"finger\"><collision><geometry><box size=\"0.1 0.02 0.1\"/></geometry></collision></link>\
                  <link name=\"tcp\"/>";
    let fixed =
        "<joint name=\"frame\" type=\"fixed\"><parent link=\"wrist\"/><child link=\"tcp\"/></joint></robot>";
    let urdf = SMALL_URDF.replace("<link name=\"finger\"/>", finger).replace("</robot>", fixed);
    let mut document = small();
    set(&mut document, "/workcell/robots/small/urdf_xml", json!(urdf));
    set(&mut document, "/workcell/arms/0/home", json!({ "reach": 0.3 }));
    set(&mut document, "/initial/ball", json!({ "held_by": "a", "object_in_tcp": {} }));
    let mut hands = Vec::new();
    for mount in ["wrist", "tcp"] {
        set(&mut document, "/workcell/arms/0/tool/mount_link", json!(mount));
        hands.push(accepted(&document).problem.workcell.arms[0].hand_groups.clone());
    }
    assert_eq!(hands[0].len(), 2);
    assert_eq!(hands[0], hands[1]);
}

#[test]
fn held_starts_and_surface_goals() {
    let mut document = switch();
    set(&mut document, "/initial/cube_1", json!({ "held_by": "arm_1", "object_in_tcp": {} }));
    set(&mut document, "/goal/cube_1", json!({ "surface": "table_b_top" }));
    remove(&mut document, "/goal/cube_2");
    let problem = accepted(&document).problem;
    assert!(matches!(problem.initial[0], InitialPlacement::Held { arm: ArmId(0), .. }));
    assert!(matches!(problem.goal[0], GoalPlacement::Surface(SurfaceId(1))));
    assert!(matches!(problem.goal[1], GoalPlacement::Anywhere));
    set(&mut document, "/initial/cube_2", json!({ "held_by": "arm_1", "object_in_tcp": {} }));
    let faults = read(&document).unwrap_err();
    assert!(has(&faults, "/initial/cube_2", FaultCode::CapacityExceeded), "{}", lines(&faults));
}

#[test]
fn options_are_read() {
    let mut document = switch();
    document["options"] = json!({
        "time_budget_s": 2.5, "max_iterations": 100, "seed": 18446744073709551615_u64, "threads": 2,
        "guidance": "greedy", "schedule": "synchronous", "objective": "steps", "return_home": true,
        "ik_solutions": 3, "clearance_m": 0.0,
        "stop": { "first_solution": true, "target_duration_s": 9.5, "no_improvement_s": null }
    });
    let options = accepted(&document).problem.options;
    let stop = Stop { first_solution: true, target_duration_s: Some(9.5), no_improvement_s: None };
    let expected = Options {
        time_budget_s: 2.5,
        max_iterations: Some(100),
        seed: u64::MAX,
        threads: 2,
        guidance: GuidanceKind::Greedy,
        objective: Objective::Steps,
        return_home: true,
        ik_solutions: 3,
        clearance_m: 0.0,
        stop,
        ..Options::default()
    };
    assert_eq!(options, expected);
}

#[test]
fn classes_follow_shape_and_grasps() {
    let mut document = switch();
    assert!(accepted(&document).problem.objects.iter().all(|object| object.class == 0));
    set(&mut document, "/objects/1/mass", json!(1.0));
    assert!(accepted(&document).problem.objects.iter().all(|object| object.class == 0));
    set(&mut document, "/objects/1/grasps", json!({ "generator": "box_faces", "depth": 0.02 }));
    let problem = accepted(&document).problem;
    assert_eq!((problem.objects[0].class, problem.objects[1].class), (0, 1));
    assert_eq!(problem.objects[1].grasps.len(), 24);
    let explicit = json!([{ "id": "side", "object_in_tcp": {} }, { "generator": "top", "yaw_steps": 2 }]);
    set(&mut document, "/objects/1/grasps", explicit);
    let grasps = &accepted(&document).problem.objects[1].grasps;
    assert_eq!(grasps.iter().map(|grasp| grasp.id.as_str()).collect::<Vec<_>>(), ["side", "top/0", "top/1"]);
}

#[test]
fn any_shape_about_its_origin_may_count_as_its_box() {
    let mut document = switch();
    // A wedge in a box of 6 by 6 by 8 cm.
    let corners = [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [-1, 1, 1]];
    let point = |[x, y, z]: [i32; 3]| json!({ "x": 0.03 * f64::from(x), "y": 0.03 * f64::from(y), "z": 0.04 * f64::from(z) });
    let wedge = json!({ "type": "convex", "points": corners.map(point) });
    for (shape, count) in [
        (wedge, 8),
        (json!({ "type": "cylinder", "radius": 0.03, "length": 0.08 }), 8),
        (json!({ "type": "sphere", "radius": 0.03 }), 24),
        (json!({ "type": "box", "size": { "x": 0.04, "y": 0.06, "z": 0.08 } }), 4),
    ] {
        let mut document = document.clone();
        set(&mut document, "/objects/0/shape", shape);
        remove(&mut document, "/objects/0/grasps");
        set(&mut document, "/objects/0/symmetry", json!("box"));
        set(&mut document, "/initial/cube_1", json!({ "held_by": "arm_1", "object_in_tcp": {} }));
        remove(&mut document, "/goal/cube_1");
        let object = &accepted(&document).problem.objects[0];
        assert_eq!((object.symmetry, object.symmetry_rotations.len()), (Symmetry::Box, count));
        assert_eq!(object.only_counts_as_box(), count != 4);
    }
    set(&mut document, "/objects/0/symmetry", json!("box"));
    let object = &accepted(&document).problem.objects[0];
    assert_eq!(object.symmetry_rotations.len(), 24);
    assert!(!object.only_counts_as_box());
}

#[test]
fn grasps_are_made_for_the_widest_gripper_and_say_what_they_need() {
    let mut document = switch();
    set(&mut document, "/workcell/arms/0/tool/max_opening", json!(0.05));
    let cell = accepted(&document).problem;
    assert_eq!(cell.objects[0].grasps.len(), 48);
    let openings: Vec<f64> = cell.workcell.arms.iter().map(|arm| arm.tool.max_opening).collect();
    let usable = |opening: f64| cell.objects[0].grasps.iter().filter(|grasp| grasp.fits(opening)).count();
    assert_eq!(openings.iter().map(|opening| usable(*opening)).collect::<Vec<_>>(), [0, 48]);
    set(&mut document, "/workcell/arms/1/tool/max_opening", json!(0.05));
    let read = accepted(&document);
    assert!(read.problem.objects[0].grasps.is_empty());
    assert_eq!(read.warnings.len(), 2);
}

#[test]
fn allowed_contacts_of_objects_and_arms() {
    let mut document = switch();
    let pairs = json!([
        ["pedestal_1", "arm_1/link_0"],
        ["arm_2/link_0", "pedestal_2"],
        ["cube_2", "cube_1"],
        ["table_b", "cube_1"],
        ["arm_1/@tool", "cube_2"],
        ["arm_1/link_1", "arm_2/link_1"],
        ["arm_1/link_0", "arm_1/link_4"],
        ["arm_1/link_4", "arm_1/link_0"],
        ["table_a", "table_b"]
    ]);
    set(&mut document, "/workcell/allowed_contacts", pairs);
    let start = document["initial"]["cube_1"].clone();
    // Now the cubes may overlap, and may not rest on each other's account.
    set(&mut document, "/initial/cube_2", start);
    let problem = accepted(&document).problem;
    let (one, two) = (ObjectId(0), ObjectId(1));
    assert!(
        problem.may_touch(one, ContactPartner::Object(two))
            && problem.may_touch(two, ContactPartner::Object(one))
    );
    assert!(problem.may_touch(one, ContactPartner::Obstacle(ObstacleId(1))));
    assert!(!problem.may_touch(two, ContactPartner::Obstacle(ObstacleId(1))));
    let (cell, link) = (&problem.workcell, ArmBody::Link);
    let mount = link(cell.arms[0].model.mount);
    assert!(problem.may_touch(two, ContactPartner::Arm(ArmId(0), ArmBody::Tool)));
    assert!(!problem.may_touch(two, ContactPartner::Arm(ArmId(0), mount)));
    assert_eq!(cell.allowed_arm_arm, [((ArmId(0), link(1)), (ArmId(1), link(1)))]);
    assert!(cell.arms_may_touch((ArmId(1), link(1)), (ArmId(0), link(1))));
    assert!(!cell.arms[0].checks_bodies(link(4), link(0)) && cell.arms[1].checks_bodies(link(4), link(0)));
}

#[test]
fn carriers_are_exempt_and_other_obstacles_are_not() {
    // A cube half sunk into a second table that does not carry it.
    let mut document = switch();
    let placed = document["initial"]["cube_1"]["pose"]["position"].clone();
    let mut slab = document["workcell"]["obstacles"][0].clone();
    slab["id"] = json!("slab");
    slab["pose"]["position"] = json!({ "x": placed["x"], "y": placed["y"], "z": 0.63 });
    set(&mut document, "/workcell/obstacles/4", slab);
    let faults = read(&document).unwrap_err();
    assert!(has(&faults, "/initial/cube_1", FaultCode::InitialCollision), "{}", lines(&faults));
    set(&mut document, "/workcell/surfaces/0/on", json!("slab"));
    accepted(&document);
}

#[test]
fn digests_leave_out_name_and_options_only() {
    let digest = |document: &Value| accepted(document).problem.digest;
    let base = digest(&switch());
    assert!(base.starts_with("sha256:") && base.len() == 7 + 64);
    let mut document = switch();
    set(&mut document, "/name", json!("other"));
    set(&mut document, "/options/seed", json!(99));
    assert_eq!(digest(&document), base);
    set(&mut document, "/objects/0/mass", json!(0.3));
    assert_ne!(digest(&document), base);
}

#[test]
fn capacities_that_nothing_fills_are_warned_of() {
    let mut document = switch();
    set(&mut document, "/workcell/surfaces/0/capacity", json!(5));
    assert!(accepted(&document).warnings.is_empty());
    // Two boxes of which the surface takes one.
    for object in 0..2 {
        set(
            &mut document,
            &format!("/objects/{object}/shape/size"),
            json!({ "x": 0.3, "y": 0.3, "z": 0.06 }),
        );
        let name = format!("cube_{}", object + 1);
        let x = if object == 0 { -0.56 } else { 1.66 };
        set(&mut document, &format!("/initial/{name}"), pose(x, 0.0, 0.68));
        remove(&mut document, &format!("/goal/{name}"));
    }
    let read = accepted(&document);
    let warned: Vec<_> = read.warnings.iter().map(|w| (w.pointer.as_str(), w.code)).collect();
    assert!(warned.contains(&("/workcell/surfaces/0/capacity", FaultCode::CapacityExceeded)), "{warned:?}");
}

/// Documents with the same robots share their models where these are kept; anything that decides a model tells them
/// apart, and what is said of a document stays the same.
#[test]
fn robots_that_were_read_before_are_the_same() {
    let robots = KnownRobots::new();
    let resources = Remembering { resources: &LibraryOnly, robots: &robots };
    let limits = ReadLimits::default();
    let model = |document: &Value| {
        let read = read_problem_value(document, &resources, &limits).unwrap();
        let fresh = accepted(document);
        assert_eq!(lines(&read.warnings), lines(&fresh.warnings));
        let (arm, other) = (&read.problem.workcell.arms[0], &fresh.problem.workcell.arms[0]);
        assert_eq!(
            (&arm.exempt_groups, &arm.exempt_bodies, &arm.limits, &arm.home),
            (&other.exempt_groups, &other.exempt_bodies, &other.limits, &other.home)
        );
        assert!(!Arc::ptr_eq(&arm.model, &other.model));
        arm.model.clone()
    };
    let first = model(&switch());
    assert!(Arc::ptr_eq(&first, &model(&switch())));
    let mut document = small();
    let small_model = model(&document);
    assert!(Arc::ptr_eq(&small_model, &model(&document)) && !Arc::ptr_eq(&small_model, &first));
    let longer = SMALL_URDF.replace("0.4 0.05 0.05", "0.5 0.05 0.05");
    assert_ne!(longer, SMALL_URDF);
    set(&mut document, "/workcell/robots/small/urdf_xml", json!(longer));
    assert!(!Arc::ptr_eq(&small_model, &model(&document)));
    assert!(Arc::ptr_eq(&small_model, &model(&small())));
    // Faults are those of a first reading, time after time.
    let broken = |pointer: &str, value: Value| {
        let mut document = small();
        set(&mut document, pointer, value);
        document
    };
    let mesh = SMALL_URDF.replace("<box size=\"0.1 0.1 0.1\"/>", "<mesh filename=\"package://p/a.stl\"/>");
    for document in [
        broken("/workcell/robots/small/urdf_xml", json!("<robot")),
        broken("/workcell/robots/small/urdf_xml", json!(mesh)),
        broken(
            "/workcell/robots/small/srdf_xml",
            json!("<robot name=\"small\"><disable_collisions link1=\"no\" link2=\"none\"/></robot>"),
        ),
        broken("/workcell/arms/0/home", json!({ "nothing": 0.1 })),
        broken("/workcell/arms/0/tool/mount_link", json!("nowhere")),
    ] {
        let faults = lines(&read(&document).unwrap_err());
        for _ in 0..2 {
            assert_eq!(lines(&read_problem_value(&document, &resources, &limits).unwrap_err()), faults);
        }
    }
}
