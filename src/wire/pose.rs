//! Poses as they are written.

use serde::Serialize;

use crate::geometry::Pose;

/// `{x, y, z}`, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct VectorDocument {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

/// `{x, y, z, w}`, a unit quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct QuaternionDocument {
    /// The imaginary part along x.
    pub x: f64,
    /// The imaginary part along y.
    pub y: f64,
    /// The imaginary part along z.
    pub z: f64,
    /// The real part.
    pub w: f64,
}

/// A pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseDocument {
    /// Position (m).
    pub position: VectorDocument,
    /// Orientation.
    pub orientation: QuaternionDocument,
}

impl From<&Pose> for PoseDocument {
    fn from(pose: &Pose) -> Self {
        let (at, turn) = (&pose.translation.vector, &pose.rotation.coords);
        Self {
            position: VectorDocument { x: at.x, y: at.y, z: at.z },
            orientation: QuaternionDocument { x: turn.x, y: turn.y, z: turn.z, w: turn.w },
        }
    }
}
