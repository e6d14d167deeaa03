use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::geometry::Vec3;
use crate::kinematics::{NoMeshes, library};

fn load(urdf: &str, mount: &str) -> ArmModel {
    ArmModel::from_urdf("r", urdf, mount, &BTreeMap::new(), &NoMeshes).unwrap().0
}

fn robot(name: &str) -> ArmModel {
    load(library(name).unwrap().urdf, "flange")
}

fn limits(model: &ArmModel) -> Vec<JointLimits> {
    model.joints.iter().map(|joint| joint.limits).collect()
}

/// Configurations within the limits from numbers in 0..1.
fn configuration(model: &ArmModel, parts: &[f64]) -> Vec<f64> {
    model
        .joints
        .iter()
        .zip(parts)
        .map(|(joint, part)| {
            let (lower, upper) = (joint.limits.lower.max(-3.1), joint.limits.upper.min(3.1));
            lower + part * (upper - lower)
        })
        .collect()
}

/// How far (m + rad) the mount is from `target` at `q`.
fn miss(model: &ArmModel, q: &[f64], target: &Pose) -> f64 {
    let difference = target.inv_mul(&model.mount_pose(q));
    let turn = difference.rotation.imag().norm() * 2.0;
    difference.translation.vector.norm() + turn
}

fn inside(q: &[f64], limits: &[JointLimits]) -> bool {
    q.iter().zip(limits).all(|(value, limit)| *value >= limit.lower && *value <= limit.upper)
}

/// The same arm with other link offsets, flipped axes and a shifted zero.
fn odd_seven() -> ArmModel {
    let joint = |n: usize, xyz: &str, rpy: &str, axis: &str| {
        format!(
            r#"<link name="l{n}"/><joint name="j{n}" type="revolute"><parent link="l{}"/><child link="l{n}"/>
            <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
            <limit lower="-2.8" upper="2.5" velocity="1"/></joint>"#,
            n - 1
        )
    };
    let text = [
        joint(1, "0.1 0.2 0.3", "0.1 -0.4 0.9", "0 0 -1"),
        joint(2, "0 0 0.2", "0 0 0.7", "0 1 0"),
        joint(3, "0 0 0", "0 0.5 0", "0 0 1"),
        joint(4, "0.07 0 0.35", "0 0 0", "0 -1 0"),
        joint(5, "-0.05 0 0.1", "0 0 0", "0 0 1"),
        joint(6, "0 0 0.3", "0 0 0", "1 0 0"),
        joint(7, "0 0 0", "0 0 0.3", "0 0 -1"),
    ]
    .concat();
    let flange = r#"<link name="flange"/><joint name="f" type="fixed"><parent link="l7"/><child link="flange"/>
        <origin xyz="0.01 0.02 0.12" rpy="0.4 0.5 0.6"/></joint>"#;
    load(&format!(r#"<robot name="r"><link name="l0"/>{text}{flange}</robot>"#), "flange")
}

/// An arm like Franka Emika's with other offsets, flipped axes, a wrist that is not at right angles and
/// a last joint that turns all the way.
fn odd_offset_seven() -> ArmModel {
    let joint = |n: usize, xyz: &str, rpy: &str, axis: &str, limit: f64| {
        format!(
            r#"<link name="l{n}"/><joint name="j{n}" type="revolute"><parent link="l{}"/><child link="l{n}"/>
            <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
            <limit lower="-{limit}" upper="{limit}" velocity="1"/></joint>"#,
            n - 1
        )
    };
    let text = [
        joint(1, "0.1 0.2 0.3", "0.1 -0.4 0.9", "0 0 -1", 2.8),
        joint(2, "0 0 0", "0 0 0.7", "0 1 0", 2.0),
        joint(3, "0 0 0", "0 0.5 0", "0 0 1", 2.8),
        joint(4, "0.07 0.02 0.35", "0.1 0 0", "0 -1 0", 2.6),
        joint(5, "-0.05 0 0.1", "0 0 0", "0 0 1", 2.8),
        joint(6, "0 0 0.3", "0.2 0 0.3", "1 0 0.2", 2.9),
        joint(7, "0.09 0.03 0.02", "0.3 0.4 0.3", "0 0 -1", 3.3),
    ]
    .concat();
    let flange = r#"<link name="flange"/><joint name="f" type="fixed"><parent link="l7"/><child link="flange"/>
        <origin xyz="0.01 0.02 0.12" rpy="0.4 0.5 0.6"/></joint>"#;
    load(&format!(r#"<robot name="r"><link name="l0"/>{text}{flange}</robot>"#), "flange")
}

#[test]
fn a_free_last_joint_misses_next_to_nothing() {
    for model in [robot("panda_type"), odd_offset_seven()] {
        use rand::Rng as _;
        let limits = limits(&model);
        let mut rng = Seed(5).stream("missed");
        let mut found = Vec::new();
        let mut missed = 0;
        for _ in 0..2000 {
            let parts: Vec<f64> = (0..7).map(|_| rng.random()).collect();
            let target = model.mount_pose(&configuration(&model, &parts));
            model.inverse(&limits, &target, 4, &mut rng, &mut found);
            missed += usize::from(found.is_empty());
        }
        assert!(missed <= 20, "{missed} of 2000");
    }
}

/// A six-joint arm by the origin, orientation and axis of its joints.
fn six(joints: [(&str, &str, &str); 6]) -> ArmModel {
    let text: String = joints
        .iter()
        .enumerate()
        .map(|(n, (xyz, rpy, axis))| {
            format!(
                r#"<link name="l{}"/><joint name="j{n}" type="revolute"><parent link="l{n}"/><child link="l{}"/>
                <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
                <limit lower="-2.9" upper="2.7" velocity="1"/></joint>"#,
                n + 1,
                n + 1
            )
        })
        .collect();
    let flange = r#"<link name="flange"/><joint name="f" type="fixed"><parent link="l6"/><child link="flange"/>
        <origin xyz="0.01 0.02 0.12" rpy="0.4 0.5 0.6"/></joint>"#;
    load(&format!(r#"<robot name="r"><link name="l0"/>{text}{flange}</robot>"#), "flange")
}

/// An industrial arm: shoulder offset, elbow offset, spherical wrist, odd zeros and signs.
fn elbow_six() -> ArmModel {
    six([
        ("0 0 0.3", "0.1 0.2 0", "0 0 -1"),
        ("0.15 0.05 0.2", "0 0 0.4", "0 1 0"),
        ("0.05 0 0.6", "0 0.3 0", "0 -1 0"),
        ("0.1 0.02 0.13", "0 0 0", "1 0 0"),
        ("0.5 0 0", "0.5 0 0", "0 1 0"),
        ("0 0 0", "0 0 0", "1 0 0"),
    ])
}

/// The UR type with other offsets, signs, and wrist axes that are not at right angles.
fn odd_ur() -> ArmModel {
    six([
        ("0.1 0 0.1", "0 0 0.3", "0 0 1"),
        ("0.03 0.1 0.2", "0 0 0.2", "0 -1 0"),
        ("0.1 0 0.5", "0 0 0", "0 1 0"),
        ("0 -0.05 0.4", "0 0.7 0", "0 -1 0"),
        ("0.02 0.1 0", "0.2 0 0", "0 0 1"),
        ("0 0 0.1", "0 0 0", "0.1 1 0"),
    ])
}

/// A linear axis under a five-joint arm.
fn on_a_rail() -> ArmModel {
    let joint = |n: usize, kind: &str, xyz: &str, axis: &str| {
        format!(
            r#"<link name="l{n}"/><joint name="j{n}" type="{kind}"><parent link="l{}"/><child link="l{n}"/>
            <origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="1"/></joint>"#,
            n - 1
        )
    };
    let text = [
        joint(1, "prismatic", "0 0 0", "1 0 0"),
        joint(2, "revolute", "0 0 0.3", "0 0 1"),
        joint(3, "revolute", "0 0 0.1", "0 1 0"),
        joint(4, "revolute", "0 0 0.4", "0 1 0"),
        joint(5, "revolute", "0 0 0.3", "0 0 1"),
        joint(6, "revolute", "0 0 0.1", "0 1 0"),
        joint(7, "revolute", "0.02 0 0.1", "0 0 1"),
    ]
    .concat();
    load(&format!(r#"<robot name="r"><link name="l0"/>{text}</robot>"#), "l7")
}

#[test]
fn structure_is_told_from_geometry() {
    assert_eq!(robot("iiwa14").inverse_method(), InverseMethod::SphericalSeven);
    assert_eq!(odd_seven().inverse_method(), InverseMethod::SphericalSeven);
    assert_eq!(robot("ur_type").inverse_method(), InverseMethod::ParallelSix);
    assert_eq!(odd_ur().inverse_method(), InverseMethod::ParallelSix);
    assert_eq!(elbow_six().inverse_method(), InverseMethod::SphericalSix);
    assert_eq!(robot("panda_type").inverse_method(), InverseMethod::OffsetSeven);
    assert_eq!(odd_offset_seven().inverse_method(), InverseMethod::OffsetSeven);
    assert_eq!(on_a_rail().inverse_method(), InverseMethod::Numeric);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn closed_form_round_trip(parts in prop::collection::vec(0.0..1.0_f64, 7), seed in any::<u64>()) {
        for model in [robot("iiwa14"), odd_seven()] {
            let limits = limits(&model);
            let q = configuration(&model, &parts);
            let target = model.mount_pose(&q);
            let mut rng = Seed(seed).stream("test");
            let mut found = Vec::new();
            model.inverse(&limits, &target, 8, &mut rng, &mut found);
            prop_assert!(!found.is_empty());
            prop_assert!(found.len() <= 8);
            for (index, solution) in found.iter().enumerate() {
                prop_assert!(miss(&model, solution, &target) < 1e-9, "{}", miss(&model, solution, &target));
                prop_assert!(inside(solution, &limits));
                for other in &found[..index] {
                    prop_assert!(solution.iter().zip(other).any(|(a, b)| (a - b).abs() > 1e-8));
                }
            }
            // From the configuration itself nothing moves.
            let near = model.inverse_near(&limits, &target, &q, 1e-6).unwrap();
            prop_assert!(near.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6));
            let closest = model.inverse_closest(&limits, &target, &q, &[1.0; 7]).unwrap();
            prop_assert!(closest.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    /// Solutions at the very edge of the limits are found, though random psi would miss them.
    #[test]
    fn narrow_limits_are_hit(parts in prop::collection::vec(0.05..0.95_f64, 7), seed in any::<u64>()) {
        let model = robot("iiwa14");
        let q = configuration(&model, &parts);
        let width = 2e-3;
        let limits: Vec<JointLimits> = limits(&model)
            .iter()
            .zip(&q)
            .map(|(l, q)| JointLimits { lower: q - width, upper: q + 0.1 * width, ..*l })
            .collect();
        let target = model.mount_pose(&q);
        let mut found = Vec::new();
        model.inverse(&limits, &target, 3, &mut Seed(seed).stream("test"), &mut found);
        prop_assert!(!found.is_empty());
        for solution in &found {
            prop_assert!(inside(solution, &limits) && miss(&model, solution, &target) < 1e-9);
        }
    }

    /// A straight line of the mount is followed without leaps.
    #[test]
    fn straight_lines_are_followed(parts in prop::collection::vec(0.1..0.9_f64, 7), way in prop::array::uniform3(-1.0..1.0_f64)) {
        let model = robot("iiwa14");
        let limits = limits(&model);
        let mut q: Config = configuration(&model, &parts).into_iter().collect();
        let start = model.mount_pose(&q);
        // Clear of singularities, where no arm follows a line at bounded speed.
        prop_assume!(q[1].sin().abs() > 0.3 && q[3].sin().abs() > 0.3 && q[5].sin().abs() > 0.3);
        let way = Vec3::from(way).normalize() * 0.05;
        let inner: Vec<JointLimits> = limits.iter().map(|l| JointLimits { lower: l.lower + 0.15, upper: l.upper - 0.15, ..*l }).collect();
        prop_assume!(inside(&q, &inner));
        for step in 1..=25 {
            let mut target = start;
            target.translation.vector += way * f64::from(step) / 25.0;
            let Some(next) = model.inverse_near(&limits, &target, &q, 0.06) else {
                // Only out of reach of the elbow or at a limit is an excuse.
                prop_assert!(q[3].abs() < 0.4 || !inside(&q, &inner), "{q:?}");
                break;
            };
            prop_assert!(miss(&model, &next, &target) < 1e-9);
            q = next;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn numeric_round_trip(parts in prop::collection::vec(0.1..0.9_f64, 7), seed in any::<u64>()) {
        let model = on_a_rail();
        let limits = limits(&model);
        let q = configuration(&model, &parts);
        let target = model.mount_pose(&q);
        let mut found = Vec::new();
        model.inverse(&limits, &target, 4, &mut Seed(seed).stream("test"), &mut found);
        prop_assert!(!found.is_empty());
        for solution in &found {
            prop_assert!(miss(&model, solution, &target) < 1e-7 && inside(solution, &limits));
        }
        let near = model.inverse_near(&limits, &target, &q, 1e-6);
        prop_assert!(near.is_some());
        let closest = model.inverse_closest(&limits, &target, &q, &[1.0; 7]).unwrap();
        prop_assert!(closest.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn a_free_last_joint_round_trips(parts in prop::collection::vec(0.02..0.98_f64, 7), seed in any::<u64>()) {
        for model in [robot("panda_type"), odd_offset_seven()] {
            let limits = limits(&model);
            let q = configuration(&model, &parts);
            let target = model.mount_pose(&q);
            let mut found = Vec::new();
            model.inverse(&limits, &target, 8, &mut Seed(seed).stream("test"), &mut found);
            for (index, solution) in found.iter().enumerate() {
                prop_assert!(miss(&model, solution, &target) < 1e-9, "{}", miss(&model, solution, &target));
                prop_assert!(inside(solution, &limits));
                for other in &found[..index] {
                    prop_assert!(solution.iter().zip(other).any(|(a, b)| (a - b).abs() > 1e-8));
                }
            }
            let near = model.inverse_near(&limits, &target, &q, 1e-6).unwrap();
            prop_assert!(near.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6));
            let closest = model.inverse_closest(&limits, &target, &q, &[1.0; 7]).unwrap();
            prop_assert!(closest.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-5));
            // What the numeric solver finds, the closed form finds for the same last joint.
            let mut numeric = Vec::new();
            model.descent(&limits, &target).spread(2, &mut Seed(seed).stream("numeric"), &mut numeric);
            // One that stands at a limit may be beyond it by the last digits.
            let at_limit = |(q, limit): (&f64, &JointLimits)| (q - limit.lower).min(limit.upper - q) < 1e-5;
            numeric.retain(|solution| !solution.iter().zip(&limits).any(at_limit));
            for solution in &numeric {
                let near = model.inverse_closest(&limits, &target, solution, &[1.0; 7]).unwrap();
                let far = near.iter().zip(solution).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                // Where a solution is all but double, its angles are known to half as many digits.
                prop_assert!(far < 1e-3, "{far}");
            }
        }
    }

    #[test]
    fn closed_form_and_numeric_agree(parts in prop::collection::vec(0.02..0.98_f64, 7), seed in any::<u64>()) {
        let model = robot("iiwa14");
        let limits = limits(&model);
        let target = model.mount_pose(&configuration(&model, &parts));
        let mut numeric = Vec::new();
        model.descent(&limits, &target).spread(2, &mut Seed(seed).stream("test"), &mut numeric);
        prop_assert!(!numeric.is_empty());
        for solution in &numeric {
            prop_assert!(miss(&model, solution, &target) < 1e-7 && inside(solution, &limits));
            // The closed form, asked for the branch and psi of the numeric solution, gives it back.
            let near = model.inverse_near(&limits, &target, solution, 1e-4);
            prop_assert!(near.is_some());
        }
    }

    #[test]
    fn closed_forms_of_six_joints_round_trip(parts in prop::collection::vec(0.0..1.0_f64, 6), seed in any::<u64>()) {
        for model in [robot("ur_type"), odd_ur(), elbow_six()] {
            let limits = limits(&model);
            let q = configuration(&model, &parts);
            let target = model.mount_pose(&q);
            let mut found = Vec::new();
            model.inverse(&limits, &target, 8, &mut Seed(seed).stream("test"), &mut found);
            prop_assert!(!found.is_empty());
            for solution in &found {
                prop_assert!(miss(&model, solution, &target) < 1e-9, "{}", miss(&model, solution, &target));
                prop_assert!(inside(solution, &limits));
            }
            // The configuration itself is among the solutions, unless it is all but singular.
            let jacobian = model.jacobian(&q);
            prop_assume!(jacobian.fixed_columns::<6>(0).into_owned().determinant().abs() > 1e-4);
            prop_assert!(found.iter().any(|s| s.iter().zip(&q).all(|(a, b)| angles::turn_between(*a, *b) < 1e-6)));
            let near = model.inverse_near(&limits, &target, &q, 1e-6).unwrap();
            prop_assert!(near.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6));
            // No solution of the numeric solver is missing.
            let mut numeric = Vec::new();
            model.descent(&limits, &target).spread(3, &mut Seed(seed).stream("numeric"), &mut numeric);
            for other in &numeric {
                prop_assert!(
                    found.iter().any(|s| s.iter().zip(other).all(|(a, b)| angles::turn_between(*a, *b) < 1e-3)),
                    "{other:?}"
                );
            }
        }
    }
}

#[test]
fn limits_force_the_arm_angle_to_move() {
    let model = robot("iiwa14");
    let q = [0.3, 0.8, -0.4, -1.2, 0.5, 0.9, 0.1];
    let target = model.mount_pose(&q);
    let mut limits = limits(&model);
    // The joint stands 0.02 beyond its new limit; psi has to give.
    limits[2].lower = q[2] + 0.02;
    let found = model.inverse_near(&limits, &target, &q, 0.3).unwrap();
    assert!(miss(&model, &found, &target) < 1e-9 && inside(&found, &limits));
    assert!(model.inverse_near(&limits, &target, &q, 0.01).is_none());
}

#[test]
fn closest_is_no_farther_than_any_sample() {
    let model = robot("iiwa14");
    let limits = limits(&model);
    let target = model.mount_pose(&[0.3, 0.8, -0.4, -1.2, 0.5, 0.9, 0.1]);
    let reference = [0.0, -0.35, 0.0, -1.9, 0.0, 1.05, 0.0];
    let weights = [3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 0.5];
    let best = model.inverse_closest(&limits, &target, &reference, &weights).unwrap();
    let mut samples = Vec::new();
    model.inverse(&limits, &target, 500, &mut Seed(5).stream("test"), &mut samples);
    assert!(samples.len() > 100);
    let cost = |q: &[f64]| angles::weighted_square(q, &reference, &weights);
    let least = samples.iter().map(|q| cost(q)).fold(f64::INFINITY, f64::min);
    assert!(cost(&best) <= least + 1e-6, "{} {least}", cost(&best));
}

#[test]
fn out_of_reach_and_unusable_targets_have_no_solution() {
    for model in [robot("iiwa14"), on_a_rail()] {
        let limits = limits(&model);
        let mut rng = Seed(1).stream("test");
        let mut found = vec![Config::new()];
        for x in [9.0, f64::NAN, f64::INFINITY] {
            let target = Pose::translation(x, 0.0, 0.5);
            model.inverse(&limits, &target, 4, &mut rng, &mut found);
            assert!(found.is_empty());
            assert!(model.inverse_near(&limits, &target, &[0.1; 7], 9.0).is_none());
            assert!(model.inverse_closest(&limits, &target, &[0.1; 7], &[1.0; 7]).is_none());
        }
        let target = model.mount_pose(&[0.1; 7]);
        model.inverse(&limits[..3], &target, 4, &mut rng, &mut found);
        assert!(found.is_empty());
    }
}

#[test]
fn singular_targets_are_met() {
    let model = robot("iiwa14");
    let limits = limits(&model);
    let ur = robot("ur_type");
    for q in [[0.0; 6], [0.3, -1.0, 1.2, -0.5, 0.0, 0.4], [0.3, -1.0, 0.0, -0.5, 0.7, 0.4]] {
        for tilt in [0.0, 1e-12, 1e-10, 1e-8, 3e-8, 1e-6, -1e-8, -1e-4] {
            let mut q = q;
            q[2] += tilt;
            q[4] += tilt;
            let target = ur.mount_pose(&q);
            let near = ur.inverse_near(&self::limits(&ur), &target, &q, 1e-3);
            let near = near.unwrap_or_else(|| panic!("no solution near {q:?}"));
            assert!(miss(&ur, &near, &target) < 1e-9, "{q:?} {}", miss(&ur, &near, &target));
        }
    }
    for q in [[0.0; 7], [0.4, 0.0, 0.3, -1.0, 0.2, 0.0, 0.7], [0.4, 0.5, 0.3, 0.0, 0.2, 0.6, 0.7]] {
        let target = model.mount_pose(&q);
        let mut found = Vec::new();
        model.inverse(&limits, &target, 4, &mut Seed(2).stream("test"), &mut found);
        assert!(!found.is_empty());
        assert!(found.iter().all(|solution| miss(&model, solution, &target) < 1e-9));
        let near = model.inverse_near(&limits, &target, &q, 1e-5).unwrap();
        assert!(miss(&model, &near, &target) < 1e-9);
    }
}

#[test]
fn the_same_seed_gives_the_same_solutions() {
    let model = robot("iiwa14");
    let limits = limits(&model);
    let target = model.mount_pose(&[0.3, 0.8, -0.4, -1.2, 0.5, 0.9, 0.1]);
    let solve = |seed| {
        let mut found = Vec::new();
        model.inverse(&limits, &target, 5, &mut Seed(seed).stream("test"), &mut found);
        found
    };
    assert_eq!(solve(3), solve(3));
    assert_ne!(solve(3), solve(4));
}

#[test]
fn what_is_plainly_beyond_an_arm_has_no_configuration() {
    let mut rng = crate::run::Seed(8).stream("beyond");
    let (mut beyond, mut within) = (0, 0);
    for model in [robot("iiwa14"), odd_seven(), robot("ur_type"), robot("panda_type")] {
        let limits = limits(&model);
        for _ in 0..2000 {
            use rand::Rng as _;
            let mut r = || rng.random_range(-1.0..1.0);
            let target = crate::geometry::pose_from_parts([r(), r(), r()], [r(), r(), r(), r() + 1.5]);
            let mut found = Vec::new();
            model.inverse(&limits, &target, 4, &mut rng, &mut found);
            if model.is_beyond(&limits, &target) {
                assert!(found.is_empty());
                beyond += 1;
            }
            within += usize::from(!found.is_empty());
        }
    }
    assert!(beyond > 500 && within > 500, "{beyond} {within}");
}
