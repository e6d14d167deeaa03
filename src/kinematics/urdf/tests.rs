use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::geometry::{Shape, Vec3};
use crate::kinematics::{library, library_names};

fn load(urdf: &str, mount: &str) -> Result<(ArmModel, Vec<UrdfWarning>), UrdfError> {
    ArmModel::from_urdf("robot", urdf, mount, &BTreeMap::new(), &NoMeshes)
}

fn fault(urdf: &str, mount: &str) -> UrdfError {
    load(urdf, mount).expect_err("a faulty URDF")
}

/// Two links and one joint, with `joint` inside the joint element and `links` beside it.
fn robot(kind: &str, joint: &str, links: &str) -> String {
    format!(
        r#"<robot name="r"><link name="base"/><link name="hand"/>{links}
        <joint name="j" type="{kind}"><parent link="base"/><child link="hand"/>{joint}</joint></robot>"#
    )
}

const LIMIT: &str = r#"<limit lower="-1" upper="1" velocity="2" effort="0"/>"#;

#[test]
fn iiwa_flange_is_where_the_data_says() {
    let iiwa = library("iiwa14").unwrap();
    let (model, warnings) = load(iiwa.urdf, "flange").unwrap();
    assert!(warnings.is_empty());
    assert_eq!(model.dof(), 7);
    let q: Vec<f64> = [10.0, 20.0, 30.0, -40.0, 50.0, 60.0, 70.0].map(f64::to_radians).to_vec();
    let pose = model.mount_pose(&q);
    let expected = Vec3::new(0.445568, 0.330454, 0.955821);
    assert!((pose.translation.vector - expected).norm() < 1e-6, "{}", pose.translation);
    let found = pose.rotation.coords;
    let expected = nalgebra::Vector4::new(0.229787, 0.699560, 0.665652, -0.121331);
    assert!((found - expected).norm().min((found + expected).norm()) < 2e-6, "{found}");
    let straight = model.mount_pose(&[0.0; 7]);
    assert!((straight.translation.vector - Vec3::new(0.0, 0.0, 1.306)).norm() < 1e-12);
}

#[test]
fn iiwa_limits_groups_and_capsules() {
    let (model, _) = load(library("iiwa14").unwrap().urdf, "flange").unwrap();
    let degrees: Vec<f64> = model.joints.iter().map(|j| j.limits.upper.to_degrees().round()).collect();
    assert_eq!(degrees, [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0]);
    let accelerations: Vec<f64> = model.joints.iter().map(|j| j.limits.acceleration).collect();
    assert_eq!(accelerations, [8.57, 8.57, 8.74, 11.36, 12.23, 15.72, 15.72]);
    let groups: Vec<usize> = model.links.iter().map(|link| link.group).collect();
    assert_eq!(groups, [0, 1, 2, 3, 4, 5, 6, 7, 7]);
    for link in &model.links[..8] {
        assert_eq!(link.shapes.len(), 1, "{}", link.name);
        assert!(matches!(link.shapes[0].shape, Shape::Capsule { .. }));
    }
    // Link 2's capsule runs along its y from -0.005 to 0.198.
    let placed = &model.links[2].shapes[0];
    let Shape::Capsule { half_length, .. } = placed.shape else { panic!("a capsule") };
    let top = placed.pose * nalgebra::Point3::new(0.0, 0.0, half_length);
    assert!((top.coords - Vec3::new(0.0, 0.198, 0.0)).norm() < 1e-12, "{top}");
}

#[test]
fn every_library_robot_loads() {
    for name in library_names() {
        let robot = library(name).unwrap();
        let (model, warnings) = load(robot.urdf, "flange").unwrap();
        assert!(warnings.is_empty(), "{name}");
        assert!(crate::kinematics::disabled_link_pairs(robot.srdf, &model).is_ok(), "{name}");
        for joint in &model.joints {
            assert!(joint.limits.velocity > 0.0 && joint.limits.acceleration > 0.0, "{name} {}", joint.name);
        }
    }
    assert!(library("iiwa15").is_none());
}

#[test]
fn faults_have_their_own_errors() {
    use UrdfError as E;
    assert!(matches!(fault("<robot", "hand"), E::Xml(_)));
    assert!(matches!(fault("<!DOCTYPE r [<!ENTITY a 'b'>]><robot/>", "hand"), E::Xml(_)));
    assert!(matches!(fault("<sdf/>", "hand"), E::NotARobot { .. }));
    assert!(matches!(fault("<robot name='r'/>", "hand"), E::NoLinks));
    let good = robot("revolute", LIMIT, "");
    assert!(load(&good, "hand").is_ok());
    match fault(&good, "hant") {
        E::NoSuchMountLink { closest, .. } => assert_eq!(closest[0], "hand"),
        other => panic!("{other}"),
    }
    assert!(matches!(fault(&good, "base"), E::NoMovableJoint { .. }));
    assert!(matches!(fault(&robot("fixed", "", ""), "hand"), E::NoMovableJoint { .. }));
    assert!(matches!(fault(&robot("planar", "", ""), "hand"), E::UnsupportedJoint { .. }));
    assert!(matches!(fault(&robot("floating", "", ""), "hand"), E::UnsupportedJoint { .. }));
    assert!(matches!(fault(&robot("hinge", "", ""), "hand"), E::BadValue { .. }));
    assert!(matches!(fault(&robot("revolute", "", ""), "hand"), E::NoLimit { .. }));
    let crossed = r#"<limit lower="1" upper="-1" velocity="1"/>"#;
    assert!(matches!(fault(&robot("revolute", crossed, ""), "hand"), E::BadLimit { .. }));
    let negative = r#"<limit lower="0" upper="1" velocity="-1"/>"#;
    assert!(matches!(fault(&robot("revolute", negative, ""), "hand"), E::BadLimit { .. }));
    let zero_axis = format!(r#"{LIMIT}<axis xyz="0 0 0"/>"#);
    assert!(matches!(fault(&robot("revolute", &zero_axis, ""), "hand"), E::ZeroAxis { .. }));
    let nan = format!(r#"{LIMIT}<origin xyz="0 nan 0"/>"#);
    assert!(matches!(fault(&robot("revolute", &nan, ""), "hand"), E::NotFinite { .. }));
    let four = format!(r#"{LIMIT}<origin xyz="0 0 0 0"/>"#);
    assert!(matches!(fault(&robot("revolute", &four, ""), "hand"), E::BadValue { .. }));
    let far = format!(r#"{LIMIT}<origin xyz="0 1e300 0"/>"#);
    assert!(matches!(fault(&robot("revolute", &far, ""), "hand"), E::OutOfRange { .. }));
    let lone = robot("revolute", LIMIT, "<link name='island'/>");
    assert!(matches!(fault(&lone, "hand"), E::SeveralRoots { .. }));
    let twice = robot("revolute", LIMIT, "<link name='hand'/>");
    assert!(matches!(fault(&twice, "hand"), E::DuplicateName { kind: "links", .. }));
    let circle = robot(
        "revolute",
        LIMIT,
        r#"<link name="a"/><link name="b"/>
        <joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>
        <joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint>"#,
    );
    assert!(matches!(fault(&circle, "hand"), E::Cycle { .. }));
    let closed = robot(
        "revolute",
        LIMIT,
        r#"<joint name="k" type="fixed"><parent link="base"/><child link="hand"/></joint>"#,
    );
    assert!(matches!(fault(&closed, "hand"), E::TwoParents { .. }));
    let loose = robot(
        "revolute",
        LIMIT,
        r#"<joint name="k" type="fixed"><parent link="base"/><child link="foot"/></joint>"#,
    );
    assert!(matches!(fault(&loose, "hand"), E::UnknownLink { .. }));
    for size in
        [r#"<box size="1 -1 1"/>"#, r#"<sphere radius="0"/>"#, r#"<cylinder radius="1" length="-2"/>"#]
    {
        let text = robot(
            "revolute",
            LIMIT,
            &format!("<link name='l'><collision><geometry>{size}</geometry></collision></link>"),
        );
        assert!(matches!(fault(&text, "hand"), E::SizeNotPositive { .. }), "{size}");
    }
    let mesh = robot(
        "revolute",
        LIMIT,
        "<link name='l'><collision><geometry><mesh filename='package://p/l.stl'/></geometry></collision></link>",
    );
    // Such a link hangs on nothing, but shapes would be read first only if it did.
    let mesh = mesh.replace(
        "</robot>",
        "<joint name='k' type='fixed'><parent link='hand'/><child link='l'/></joint></robot>",
    );
    assert!(matches!(fault(&mesh, "hand"), E::Mesh { error: MeshError::Unresolved, .. }));
}

#[test]
fn limits_of_the_chain_may_be_left_to_others() {
    let open = |limit: &str| {
        let text = GRIPPER.replace("<limit lower=\"-1\" upper=\"1\" velocity=\"1\"/>", limit);
        assert_ne!(text, GRIPPER);
        let strict = load(&text, "hand").map(|_| ());
        let size = UrdfSize::ANY;
        let loaded = ArmModel::from_urdf_within("r", &text, "hand", &BTreeMap::new(), &NoMeshes, size);
        (strict, loaded.unwrap().0.joints.swap_remove(0))
    };
    let (strict, joint) = open("");
    assert_eq!(strict, Err(UrdfError::NoLimit { joint: "turn".to_owned() }));
    assert_eq!(joint.limit_fault, strict.err());
    assert_eq!((joint.limits.lower, joint.limits.upper), (f64::NEG_INFINITY, f64::INFINITY));
    let (strict, joint) = open("<limit lower=\"2\" upper=\"1\" velocity=\"-3\"/>");
    let fault = LimitFault::Crossed { lower: 2.0, upper: 1.0 };
    assert_eq!(strict, Err(UrdfError::BadLimit { joint: "turn".to_owned(), fault }));
    assert_eq!(joint.limit_fault, strict.err());
    assert_eq!((joint.limits.lower, joint.limits.upper, joint.limits.velocity), (2.0, 1.0, -3.0));
    // A finger's limits are nobody else's business.
    let finger = GRIPPER.replace("upper=\"0.04\"", "upper=\"-0.04\"");
    let size = UrdfSize::ANY;
    let found = ArmModel::from_urdf_within("r", &finger, "hand", &BTreeMap::new(), &NoMeshes, size);
    assert!(matches!(found, Err(UrdfError::BadLimit { joint, .. }) if joint == "f2"));
}

#[test]
fn what_is_too_large_is_not_built() {
    let iiwa = library("iiwa14").unwrap();
    let within = |links: usize, shapes: usize| {
        let size = UrdfSize { links, shapes };
        ArmModel::from_urdf_within("r", iiwa.urdf, "flange", &BTreeMap::new(), &NoMeshes, size)
    };
    let (links, shapes) = (9, iiwa.urdf.matches("<collision").count());
    assert!(within(links, shapes).is_ok());
    let fewer = UrdfError::TooMany { what: "links", count: links, most: links - 1 };
    assert_eq!(within(links - 1, shapes).unwrap_err(), fewer);
    let fewer = UrdfError::TooMany { what: "collision shapes", count: shapes, most: shapes - 1 };
    assert_eq!(within(links, shapes - 1).unwrap_err(), fewer);
    // Before all that takes the robot for whole: this one hangs together nowhere.
    let islands: String = (0..300).map(|index| format!("<link name='l{index}'/>")).collect();
    let islands = robot("revolute", LIMIT, &islands);
    let size = UrdfSize { links: 256, shapes: 0 };
    let found = ArmModel::from_urdf_within("r", &islands, "hand", &BTreeMap::new(), &NoMeshes, size);
    assert!(matches!(found, Err(UrdfError::TooMany { what: "links", count: 302, most: 256 })));
}

#[test]
fn two_readers_must_agree() {
    let arm = |version: &str, origin: &str, limit: &str| {
        format!(
            r#"<robot name="r"{version}><link name="base"/><link name="tip"><visual><geometry>
            <sphere radius="a ball"/></geometry></visual></link>
            <joint name="turn" type="revolute"><origin {origin}/><parent link="base"/><child link="tip"/>
            <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" {limit}/></joint></robot>"#
        )
    };
    let (rpy, speed) = (r#"xyz="0 0 1" rpy="0 0 1.5""#, r#"velocity="1""#);
    // What no arm is made of is not read at all.
    let (_, warnings) = load(&arm("", rpy, speed), "tip").unwrap();
    assert_eq!(warnings, vec![]);
    // Only newer readers know quaternions: an old one would stand the arm up otherwise.
    let quaternion = r#"xyz="0 0 1" quat_xyzw="0 0 0.6 0.8""#;
    let found = fault(&arm(r#" version="1.1""#, quaternion, speed), "tip");
    assert!(matches!(&found, UrdfError::Disputed { what: "origin", .. }), "{found:?}");
    // The second reader asks for a speed limit, which may come from elsewhere.
    let (_, warnings) = load(&arm("", rpy, ""), "tip").unwrap();
    assert!(matches!(warnings.as_slice(), [UrdfWarning::ReadOnce { .. }]), "{warnings:?}");
}

#[test]
fn a_mesh_counts_as_its_hull_with_a_warning() {
    struct Tetrahedron;
    impl MeshResolver for Tetrahedron {
        fn pieces(&self, uri: &str, scale: &Vec3) -> Result<MeshPieces, MeshError> {
            let text = match uri {
                "package://p/l.obj" => "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n",
                "package://p/two.obj" => {
                    "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n\
                     o b\nv 5 0 0\nv 6 0 0\nv 5 1 0\nv 5 0 1\nf 5 7 6\nf 5 6 8\nf 5 8 7\nf 6 7 8\n"
                }
                "package://p/flat.obj" => "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
                _ => return Err(MeshError::Unresolved),
            };
            read_mesh(uri, text.as_bytes(), scale)?.pieces()
        }
    }
    let text = |file: &str| {
        robot("revolute", LIMIT, "").replace(
            "<link name=\"hand\"/>",
            &format!(
                "<link name='hand'><collision><geometry><mesh filename='package://p/{file}' scale='2 2 2'/>\
                 </geometry></collision></link>"
            ),
        )
    };
    let load = |file: &str| ArmModel::from_urdf("r", &text(file), "hand", &BTreeMap::new(), &Tetrahedron);
    let (model, warnings) = load("l.obj").unwrap();
    assert!(matches!(warnings.as_slice(), [UrdfWarning::MeshFilled { filled: MeshFilled::Hull, .. }]));
    assert!((model.links[1].shapes[0].shape.support(&Vec3::z()) - 2.0).abs() < 1e-6);
    let (model, warnings) = load("two.obj").unwrap();
    assert_eq!((model.links[1].shapes.len(), warnings.len()), (2, 0), "{warnings:?}");
    // Its pieces count, not its files.
    let size = UrdfSize { links: 10, shapes: 1 };
    let within =
        ArmModel::from_urdf_within("r", &text("two.obj"), "hand", &BTreeMap::new(), &Tetrahedron, size);
    assert!(matches!(within, Err(UrdfError::TooMany { count: 2, most: 1, .. })));
    assert!(matches!(load("flat.obj"), Err(UrdfError::Mesh { error: MeshError::NoHull(_), .. })));
}

/// A chain of one revolute and one prismatic joint, a finger that follows the first, one that is
/// held, and one that follows the held one.
const GRIPPER: &str = r#"<robot name="r">
  <link name="base"/><link name="arm"/><link name="hand"/><link name="f1"/><link name="f2"/><link name="f3"/>
  <joint name="f3" type="prismatic"><parent link="hand"/><child link="f3"/><axis xyz="0 1 0"/>
    <mimic joint="f2" multiplier="-1" offset="0.001"/></joint>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="1 0 0"/>
    <limit lower="0" upper="1" velocity="1"/></joint>
  <joint name="f1" type="revolute"><parent link="hand"/><child link="f1"/><axis xyz="0 0 1"/>
    <mimic joint="turn" multiplier="-2" offset="0.5"/></joint>
  <joint name="f2" type="prismatic"><parent link="hand"/><child link="f2"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" velocity="1"/></joint>
</robot>"#;

#[test]
fn held_and_mimic_joints() {
    let held = BTreeMap::from([("f2".to_owned(), 0.03), ("turn".to_owned(), 9.0)]);
    let (model, warnings) = ArmModel::from_urdf("r", GRIPPER, "hand", &held, &NoMeshes).unwrap();
    assert!(warnings.is_empty());
    let names: Vec<&str> = model.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["turn", "slide"]);
    let mut poses = Vec::new();
    model.link_poses(&[0.3, 0.2], &mut poses);
    let local = |name: &str| {
        let hand = poses[model.link_index("hand").unwrap()];
        hand.inv_mul(&poses[model.link_index(name).unwrap()])
    };
    assert!((local("f1").rotation.scaled_axis() - Vec3::new(0.0, 0.0, 0.5 - 0.6)).norm() < 1e-12);
    assert!((local("f2").translation.vector - Vec3::new(0.0, 0.03, 0.0)).norm() < 1e-12);
    assert!((local("f3").translation.vector - Vec3::new(0.0, -0.029, 0.0)).norm() < 1e-12);
    let hand = poses[model.mount].translation.vector;
    assert!((hand - Vec3::new(1.2 * 0.3_f64.cos(), 1.2 * 0.3_f64.sin(), 0.0)).norm() < 1e-12);
    let groups: std::collections::BTreeSet<usize> = model.links.iter().map(|l| l.group).collect();
    assert_eq!(groups.len(), 6);
}

#[test]
fn held_faults() {
    let with = |name: &str, value: f64| {
        let held = BTreeMap::from([(name.to_owned(), value)]);
        ArmModel::from_urdf("r", GRIPPER, "hand", &held, &NoMeshes)
    };
    assert!(matches!(with("f4", 0.0), Err(UrdfError::UnknownHeldJoint { .. })));
    assert!(matches!(with("f3", 0.0), Err(UrdfError::NotHoldable { .. })));
    assert!(matches!(with("f2", f64::NAN), Err(UrdfError::BadHeldValue { .. })));
    assert!(matches!(with("f2", 1.0).unwrap().1.as_slice(), [UrdfWarning::HeldOutsideLimits { .. }]));
    let circle = GRIPPER.replace("<mimic joint=\"turn\"", "<mimic joint=\"f1\"");
    assert!(matches!(fault(&circle, "hand"), UrdfError::MimicCycle { .. }));
    let nobody = GRIPPER.replace("<mimic joint=\"turn\"", "<mimic joint=\"nobody\"");
    assert!(matches!(fault(&nobody, "hand"), UrdfError::BadMimic { .. }));
}

/// Pieces that break things when they land in a URDF.
const PIECES: [&str; 14] = [
    "",
    "<",
    ">",
    "\"",
    "-1",
    "nan",
    "1e999",
    "0 0 0",
    "<link name=\"x\"/>",
    "link_3",
    "&amp;",
    "\u{0}",
    "<mimic joint=\"joint_2\"/>",
    "planar",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn mutated_texts_never_panic(
        cuts in prop::collection::vec((0.0..1.0_f64, 0..40_usize, 0..PIECES.len()), 1..6),
        gripper in any::<bool>(),
    ) {
        let mut text: String = if gripper { GRIPPER.into() } else { library("iiwa14").unwrap().urdf.into() };
        for (at, length, piece) in cuts {
            let mut start = ((text.len() as f64 * at) as usize).min(text.len());
            while !text.is_char_boundary(start) { start -= 1; }
            let mut end = (start + length).min(text.len());
            while !text.is_char_boundary(end) { end += 1; }
            text.replace_range(start..end, PIECES[piece]);
        }
        for mount in ["flange", "hand"] {
            if let Ok((model, _)) = load(&text, mount) {
                let pose = model.mount_pose(&vec![0.1; model.dof()]);
                prop_assert!(pose.translation.vector.iter().all(|c| c.is_finite()));
            }
        }
    }
}
