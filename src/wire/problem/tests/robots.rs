//! Robots, whether an arm uses them or not.

use super::*;

#[test]
fn a_robot_that_no_arm_uses_has_to_be_good_too() {
    let spare = "/workcell/robots/spare";
    let with = |robot: Value| {
        let mut document = small();
        set(&mut document, spare, robot);
        document
    };
    let changed = |from: &str, to: &str| {
        assert!(SMALL_URDF.contains(from));
        SMALL_URDF.replace(from, to)
    };
    for (robot, field, code) in [
        (json!({ "urdf_xml": "<robot" }), "urdf_xml", FaultCode::BadUrdf),
        (json!({ "urdf_xml": "<arm/>" }), "urdf_xml", FaultCode::BadUrdf),
        (
            json!({ "urdf_xml": changed("<parent link=\"boom\"/>", "<parent link=\"gone\"/>") }),
            "urdf_xml",
            FaultCode::BadUrdf,
        ),
        (json!({ "urdf_xml": changed("0.4 0.05 0.05", "0.4 0 0.05") }), "urdf_xml", FaultCode::BadUrdf),
        (
            json!({ "urdf_xml": changed("<axis xyz=\"1 0 0\"/>", "<axis xyz=\"0 0 0\"/>") }),
            "urdf_xml",
            FaultCode::BadUrdf,
        ),
        (json!({ "urdf_xml": SMALL_URDF, "srdf_xml": "<robot" }), "srdf_xml", FaultCode::BadSrdf),
        (
            json!({ "urdf_xml": SMALL_URDF,
                    "srdf_xml": "<robot><disable_collisions link1='a' link2='b'/></robot>" }),
            "srdf_xml",
            FaultCode::UnknownLink,
        ),
        (
            json!({ "urdf_xml": SMALL_URDF, "limits": { "elbow": { "velocity": 1.0 } } }),
            "limits/elbow",
            FaultCode::UnknownJoint,
        ),
        (
            json!({ "urdf_xml": SMALL_URDF, "limits": { "swing": { "lower": 3.0 } } }),
            "limits/swing",
            FaultCode::OutOfRange,
        ),
        (
            json!({ "urdf_xml": SMALL_URDF, "limits": { "grip": { "lower": 1.0, "upper": -1.0 } } }),
            "limits/grip",
            FaultCode::OutOfRange,
        ),
    ] {
        let faults = read(&with(robot.clone())).unwrap_err();
        assert_eq!(faults.len(), 1, "{robot}: {}", lines(&faults));
        assert!(has(&faults, &format!("{spare}/{field}"), code), "{robot}: {}", lines(&faults));
    }
    // Its meshes nobody asks for, and what could not carry a tool is no fault of a robot that carries none.
    let mesh = changed("<box size=\"0.1 0.1 0.1\"/>", "<mesh filename=\"package://p/a.stl\"/>");
    let limits = json!({ "swing": { "lower": -3.0 }, "grip": { "upper": 0.2 } });
    for robot in [
        json!({ "urdf": "library:panda_type" }),
        json!({ "urdf_xml": mesh, "limits": limits }),
        json!({ "urdf_xml": "<robot name=\"post\"><link name=\"post\"/></robot>" }),
    ] {
        let told = robot.to_string();
        let (plain, spare) = (accepted(&small()), accepted(&with(robot)));
        assert_eq!(lines(&spare.warnings), lines(&plain.warnings), "{told}");
    }
}
