//! The workcell: arms in place, obstacles, surfaces, objects with their grasps, and which bodies
//! may touch for good.
//!
//! Ids are indices here; names live at the border.

mod arm;
mod body;
pub mod contacts;
mod grasps;
mod object;
mod resting;
mod symmetry;

pub use arm::{Arm, ArmBody, BodyPair, Tool, bodies, body_pair};
pub use body::{Obstacle, Surface};
pub use grasps::{GraspError, GraspGenerator, footprint};
pub use object::{Grasp, ObjectModel, Symmetry};
pub use resting::{RestFault, centre, rests_on, surfaces_under};
pub use symmetry::{SymmetryError, shape_rotations, symmetry_rotations};

/// Index of an arm in [`Workcell::arms`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ArmId(pub usize);

/// Index of an obstacle in [`Workcell::obstacles`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObstacleId(pub usize);

/// Index of a surface in [`Workcell::surfaces`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SurfaceId(pub usize);

/// Index of an object in the problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectId(pub usize);

/// Everything that stands still between jobs: arms, obstacles, surfaces.
#[derive(Debug, Clone)]
pub struct Workcell {
    /// The arms.
    pub arms: Vec<Arm>,
    /// Static bodies.
    pub obstacles: Vec<Obstacle>,
    /// Areas on which objects may stand.
    pub surfaces: Vec<Surface>,
    /// Bodies of arms and obstacles that `allowed_contacts` exempts from each other, sorted.
    pub allowed_arm_obstacle: Vec<(ArmId, ArmBody, ObstacleId)>,
    /// Bodies of two different arms that `allowed_contacts` exempts from each other, the lower arm first, sorted.
    pub allowed_arm_arm: Vec<((ArmId, ArmBody), (ArmId, ArmBody))>,
}

impl Workcell {
    /// Whether `allowed_contacts` lets a body of an arm touch `obstacle`.
    pub fn arm_may_touch(&self, arm: ArmId, body: ArmBody, obstacle: ObstacleId) -> bool {
        self.allowed_arm_obstacle.binary_search(&(arm, body, obstacle)).is_ok()
    }

    /// Whether `allowed_contacts` lets bodies of two different arms touch.
    pub fn arms_may_touch(&self, one: (ArmId, ArmBody), other: (ArmId, ArmBody)) -> bool {
        self.allowed_arm_arm.binary_search(&(one.min(other), one.max(other))).is_ok()
    }
}
