//! Goals that are met from the start.

use super::*;

#[test]
fn an_object_that_is_at_its_goal_needs_no_reach() {
    let mut document = switch();
    set(
        &mut document,
        "/workcell/surfaces/2",
        json!({ "id": "far", "pose": { "position": { "x": 9.0, "y": 0.0, "z": 0.0 } }, "size": { "x": 1.0, "y": 1.0 } }),
    );
    set(&mut document, "/initial/cube_2", pose(9.0, 0.0, 0.03));
    let refused = |document: &Value| match read(document) {
        Ok(_) => false,
        Err(faults) => {
            assert!(has(&faults, "/goal/cube_2", FaultCode::GoalUnreachable), "{}", lines(&faults));
            true
        }
    };
    // Anywhere on the surface that it is on, and within what the judge forgives.
    for (goal, is_refused) in [
        (pose(9.0, 0.0, 0.03), false),
        (json!({ "surface": "far" }), false),
        (pose(9.0009, 0.0, 0.03), false),
        (pose(9.0011, 0.0, 0.03), true),
    ] {
        set(&mut document, "/goal/cube_2", goal);
        assert_eq!(refused(&document), is_refused, "{}", document["goal"]["cube_2"]);
    }
    // Turned by what makes no difference to it.
    let turned = |axis: &str, degrees: f64| {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        let mut goal = pose(9.0, 0.0, 0.03);
        goal["pose"]["orientation"] = json!({ "x": 0.0, "y": 0.0, "z": 0.0, "w": cos });
        goal["pose"]["orientation"][axis] = json!(sin);
        goal
    };
    let cylinder = json!({ "type": "cylinder", "radius": 0.03, "length": 0.06 });
    let sphere = json!({ "type": "sphere", "radius": 0.03 });
    let cube = json!({ "type": "box", "size": { "x": 0.06, "y": 0.06, "z": 0.06 } });
    for (shape, symmetry, axis, degrees, is_refused) in [
        (&cube, "none", "z", 0.4, false),
        (&cube, "none", "z", 0.6, true),
        (&cube, "none", "z", 90.0, true),
        (&cube, "box", "z", 90.0, false),
        (&cube, "box", "x", -90.4, false),
        (&cube, "box", "z", 45.0, true),
        (&cylinder, "none", "z", 77.0, true),
        (&cylinder, "cylinder_z", "z", 77.0, false),
        (&cylinder, "cylinder_z", "x", 180.0, false),
        (&sphere, "none", "y", 77.0, true),
        (&sphere, "sphere", "y", 77.0, false),
    ] {
        set(&mut document, "/objects/1/shape", shape.clone());
        set(&mut document, "/objects/1/symmetry", json!(symmetry));
        set(&mut document, "/objects/1/grasps", json!([{ "generator": "top" }]));
        set(&mut document, "/goal/cube_2", turned(axis, degrees));
        assert_eq!(refused(&document), is_refused, "{symmetry} about {axis} by {degrees}");
    }
    // In a hand it is not there yet.
    set(&mut document, "/initial/cube_2", json!({ "held_by": "arm_1", "object_in_tcp": {} }));
    set(&mut document, "/goal/cube_2", json!({ "surface": "far" }));
    assert!(refused(&document));
}
