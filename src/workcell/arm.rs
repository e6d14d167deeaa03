//! An arm in its place, with its tool.

use std::sync::Arc;

use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::kinematics::{ArmModel, Config, JointLimits};
use crate::run::Rng;

/// A tool on an arm's mount link.
#[derive(Debug, Clone, PartialEq)]
pub struct Tool {
    /// The TCP frame in the mount link's frame: z out of the gripper, y the closing direction.
    pub tcp: Pose,
    /// Collision shapes in the mount link's frame.
    pub shapes: Vec<PlacedShape>,
    /// Greatest opening of the fingers (m).
    pub max_opening: f64,
    /// Dwell at rest after each action (s).
    pub grasp_time: f64,
}

/// An arm in the workcell.
#[derive(Debug, Clone)]
pub struct Arm {
    /// Its id in the problem.
    pub id: String,
    /// Its kinematic model, shared by arms of one kind.
    pub model: Arc<ArmModel>,
    /// The root link's frame in the world.
    pub base: Pose,
    /// Its tool.
    pub tool: Tool,
    /// Limits of the chain's joints after all overrides, all finite and positive where they must
    /// be (positions of continuous joints may be infinite).
    pub limits: Vec<JointLimits>,
    /// Home configuration.
    pub home: Config,
    /// Pairs of rigid groups of this arm (lower index first) that are never checked against each
    /// other: neighbours across one movable joint, pairs disabled by SRDF or `allowed_contacts`,
    /// pairs that overlap almost always; sorted. The tool belongs to the mount link's group.
    pub exempt_groups: Vec<(usize, usize)>,
    /// The rigid groups that make the hand: the mount link's group and all groups below it.
    pub hand_groups: Vec<usize>,
}

impl Arm {
    /// The TCP frame in the world at `q`.
    pub fn tcp_pose(&self, q: &[f64]) -> Pose {
        self.base * self.model.mount_pose(q) * self.tool.tcp
    }

    /// The origin of [`Self::tcp_pose`] (m).
    pub fn tcp_position(&self, q: &[f64]) -> Vec3 {
        let in_root = self.model.mount_point(q, &self.tool.tcp.translation.vector);
        self.base.rotation * in_root + self.base.translation.vector
    }

    /// Writes to `out` (cleared first) up to `most` configurations that bring the mount link to `target`, its pose in
    /// the root link's frame ([`ArmModel::inverse`]), every joint as near to home as whole turns allow.
    pub fn inverse(&self, target: &Pose, most: usize, rng: &mut Rng, out: &mut Vec<Config>) {
        self.model.inverse(&self.limits, target, most, rng, out);
        out.iter_mut().for_each(|q| self.model.unwind(&self.limits, &self.home, q));
    }

    /// The rigid group of the mount link, to which the tool belongs.
    pub fn mount_group(&self) -> usize {
        self.model.links[self.model.mount].group
    }

    /// Whether two rigid groups of this arm are to be checked against each other.
    pub fn checks_groups(&self, a: usize, b: usize) -> bool {
        let pair = (a.min(b), a.max(b));
        a != b && self.exempt_groups.binary_search(&pair).is_err()
    }
}
