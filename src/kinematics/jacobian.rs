//! The geometric Jacobian.

use nalgebra::Matrix6xX;
use smallvec::SmallVec;

use super::ArmModel;

impl ArmModel {
    /// The Jacobian of the mount frame at `q`: one column per joint; rows 0 to 2 are the velocity
    /// of the mount origin (m per unit of the joint), rows 3 to 5 the angular velocity (rad per
    /// unit), both in the root frame.
    pub fn jacobian(&self, q: &[f64]) -> Matrix6xX<f64> {
        let mut columns = SmallVec::new();
        self.chain.mount_pose_and_jacobian(q, &mut columns);
        Matrix6xX::from_columns(&columns)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::geometry::Pose;
    use crate::kinematics::{NoMeshes, library};

    /// A prismatic joint, a revolute one with a skew axis, and a mimic joint on the chain.
    const MIXED: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 1 0"/>
            <origin xyz="0 0 0.3" rpy="0.2 0 0"/><limit lower="-1" upper="1" velocity="1"/></joint>
        <joint name="turn" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0.2 -1 0.4"/>
            <origin xyz="0.1 0.2 0.3" rpy="0 0.5 1"/><limit lower="-3" upper="3" velocity="1"/></joint>
        <joint name="follow" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
            <origin xyz="0.4 0 0"/><mimic joint="turn" multiplier="-0.5" offset="0.1"/></joint></robot>"#;

    fn check(model: &ArmModel, q: &[f64]) -> Result<(), TestCaseError> {
        let jacobian = model.jacobian(q);
        let step = 1e-6;
        for joint in 0..model.dof() {
            let at = |delta: f64| -> Pose {
                let mut moved = q.to_vec();
                moved[joint] += delta;
                model.mount_pose(&moved)
            };
            let (before, after) = (at(-step), at(step));
            let linear = (after.translation.vector - before.translation.vector) / (2.0 * step);
            let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * step);
            let column = jacobian.column(joint);
            prop_assert!((column.fixed_rows::<3>(0) - linear).norm() < 1e-8);
            prop_assert!((column.fixed_rows::<3>(3) - angular).norm() < 1e-8);
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn matches_differences(q in prop::collection::vec(-2.0..2.0_f64, 7)) {
            let urdf = library("iiwa14").unwrap().urdf;
            let load = |urdf, mount| {
                ArmModel::from_urdf("r", urdf, mount, &BTreeMap::new(), &NoMeshes).unwrap().0
            };
            check(&load(urdf, "flange"), &q)?;
            let mixed = load(MIXED, "d");
            prop_assert_eq!(mixed.dof(), 2);
            check(&mixed, &q[..2])?;
        }

        #[test]
        fn mount_pose_is_that_of_the_mount_link(q in prop::collection::vec(-2.0..2.0_f64, 2)) {
            let model = ArmModel::from_urdf("r", MIXED, "d", &BTreeMap::new(), &NoMeshes).unwrap().0;
            let mut poses = Vec::new();
            model.link_poses(&q, &mut poses);
            let difference = poses[model.mount].inv_mul(&model.mount_pose(&q));
            prop_assert!(difference.translation.vector.norm() + difference.rotation.angle() < 1e-7);
            let point = crate::geometry::Vec3::new(0.1, -0.2, 0.3);
            let placed = (model.mount_pose(&q) * nalgebra::Point3::from(point)).coords;
            prop_assert!((model.mount_point(&q, &point) - placed).norm() < 1e-12);
        }
    }
}
