//! Joint values that are whole turns apart.

use std::f64::consts::TAU;

use super::inverse::fit;
use super::{ArmModel, JointLimits, LinkMotion};

impl ArmModel {
    /// Whether a whole turn of `joint` brings every link back to where it was.
    pub fn is_periodic(&self, joint: usize) -> bool {
        self.links.iter().all(|link| match link.motion {
            LinkMotion::Revolute { joint: driver, multiplier, .. } => {
                driver != joint || multiplier.fract() == 0.0
            }
            LinkMotion::Prismatic { joint: driver, .. } => driver != joint,
            LinkMotion::Held => true,
        })
    }

    /// Moves the joints of `q` (rad) by whole turns, as near to `reference` as `limits` (one per joint) allow:
    /// the arm stays where it is, and has less far to go. Joints of a turn or less, and those for which
    /// [`Self::is_periodic`] does not hold, stay as they are.
    pub fn unwind(&self, limits: &[JointLimits], reference: &[f64], q: &mut [f64]) {
        for (joint, ((value, limit), near)) in q.iter_mut().zip(limits).zip(reference).enumerate() {
            if limit.upper - limit.lower > TAU
                && self.is_periodic(joint)
                && let Some(turned) = fit(*value, limit, *near)
            {
                *value = turned;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::kinematics::{NoMeshes, library};

    /// A rail, an arm's turn, and a link that turns half as far.
    const MIXED: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <link name="e"/><link name="flange"/>
        <joint name="rail" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
            <limit lower="-9" upper="9" velocity="1"/></joint>
        <joint name="turn" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
            <limit lower="-9" upper="9" velocity="1"/></joint>
        <joint name="swing" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 1 0"/>
            <limit lower="-9" upper="9" velocity="1"/></joint>
        <joint name="spin" type="continuous"><parent link="d"/><child link="e"/><axis xyz="0 1 0"/>
            <limit velocity="1"/></joint>
        <joint name="follow" type="revolute"><parent link="e"/><child link="flange"/><axis xyz="0 0 1"/>
            <mimic joint="turn" multiplier="0.5" offset="0"/></joint></robot>"#;

    fn load(urdf: &str) -> ArmModel {
        ArmModel::from_urdf("r", urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
    }

    #[test]
    fn what_a_turn_would_move_stays_as_it_is() {
        let model = load(MIXED);
        let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
        assert_eq!([0, 1, 2, 3].map(|joint| model.is_periodic(joint)), [false, false, true, true]);
        let mut q = [8.0, 8.0, 8.0, 50.0];
        model.unwind(&limits, &[0.0; 4], &mut q);
        assert_eq!(q[..2], [8.0, 8.0]);
        assert!((q[2] - (8.0 - TAU)).abs() < 1e-12 && (q[3] - (50.0 - 8.0 * TAU)).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_arm_stays_where_it_is_and_comes_as_near_as_it_can(
            q in prop::collection::vec(-1.0..1.0_f64, 7), reference in prop::collection::vec(-1.0..1.0_f64, 7),
        ) {
            for name in ["iiwa14", "ur_type", "panda_type"] {
                let model = load(library(name).unwrap().urdf);
                let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
                let within = |parts: &[f64]| -> Vec<f64> {
                    let middle = |l: &JointLimits| (l.lower + l.upper) / 2.0;
                    let value = |(l, part): (&JointLimits, &f64)| middle(l) + part * (l.upper - l.lower) / 2.0;
                    limits.iter().zip(parts).map(value).collect()
                };
                let (q, reference) = (within(&q), within(&reference));
                let mut near = q.clone();
                model.unwind(&limits, &reference, &mut near);
                for (joint, limit) in limits.iter().enumerate() {
                    prop_assert!((limit.lower..=limit.upper).contains(&near[joint]));
                    for turn in [-TAU, TAU] {
                        let other = near[joint] + turn;
                        let away = |value: f64| (value - reference[joint]).abs();
                        let is_nearer = away(other) < away(near[joint]) - 1e-9;
                        prop_assert!(!(limit.lower..=limit.upper).contains(&other) || !is_nearer);
                    }
                }
                let (mut before, mut after) = (Vec::new(), Vec::new());
                model.link_poses(&q, &mut before);
                model.link_poses(&near, &mut after);
                for (a, b) in before.iter().zip(&after) {
                    prop_assert!((a.translation.vector - b.translation.vector).norm() < 1e-9);
                    prop_assert!(a.rotation.angle_to(&b.rotation) < 1e-7);
                }
            }
        }
    }
}
