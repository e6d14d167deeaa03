//! Poses to the last digit that means something, so that equal ones that were come by in different ways are equal.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::geometry::Pose;

/// Poses are told apart down to this (m, and unit of quaternion): far less than any tolerance, far more than rounding.
const GRAIN: f64 = 1.0e-11;

/// A pose in grains: position, then the quaternion's vector and scalar part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Grains([i64; 7]);

impl Grains {
    #[inline]
    pub(super) fn of(pose: &Pose) -> Self {
        let (t, mut r) = (pose.translation.vector, pose.rotation.coords);
        // A quaternion and its negative are one rotation.
        if let Some(first) = r.iter().find(|c| c.abs() > 0.1)
            && *first < 0.0
        {
            r = -r;
        }
        // To the nearest; what `round` does is a call on machines without an instruction for it.
        Self([t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(|c| (c / GRAIN + 0.5_f64.copysign(c)) as i64))
    }

    /// The pose: the same for all that have equal grains, and within half a grain of each of them.
    #[inline]
    pub(super) fn pose(&self) -> Pose {
        let [x, y, z, i, j, k, w] = self.0.map(|c| c as f64 * GRAIN);
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Pose::from_parts(Translation3::new(x, y, z), rotation)
    }

    /// The same numbers for equal grains.
    pub(super) fn numbers(&self) -> [u64; 7] {
        self.0.map(|c| c as u64)
    }
}
