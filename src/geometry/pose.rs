//! Rigid transforms.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A rigid transform: position in metres, orientation as a unit quaternion.
pub type Pose = Isometry3<f64>;

/// A vector or point in metres.
pub type Vec3 = Vector3<f64>;

/// Builds a pose from a position (m) and a quaternion in the order x, y, z, w.
///
/// The quaternion is normalised; callers that read outside data check its norm first.
pub fn pose_from_parts(position: [f64; 3], xyzw: [f64; 4]) -> Pose {
    Pose::from_parts(
        Translation3::new(position[0], position[1], position[2]),
        UnitQuaternion::from_quaternion(Quaternion::new(xyzw[3], xyzw[0], xyzw[1], xyzw[2])),
    )
}
