//! Static bodies and the surfaces on them.

use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::workcell::ObstacleId;

/// A static body.
#[derive(Debug, Clone)]
pub struct Obstacle {
    /// Its id in the problem.
    pub id: String,
    /// Its shapes in its own frame.
    pub shapes: Vec<PlacedShape>,
    /// Its frame in the world.
    pub pose: Pose,
}

/// A rectangle on which objects may stand.
#[derive(Debug, Clone)]
pub struct Surface {
    /// Its id in the problem.
    pub id: String,
    /// The obstacle that carries it, if any.
    pub carrier: Option<ObstacleId>,
    /// Frame at the rectangle's centre in the world, z the outward normal.
    pub pose: Pose,
    /// Half extents along the frame's x and y (m).
    pub half_extents: [f64; 2],
    /// How many objects may stand here at once, where the problem says so.
    pub capacity: Option<usize>,
}

impl Surface {
    /// The outward normal in the world.
    pub fn normal(&self) -> Vec3 {
        self.pose.rotation * Vec3::z()
    }
}
