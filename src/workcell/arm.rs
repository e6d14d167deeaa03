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

/// A body of an arm: what FORMAT "What may touch" names by `ARM/LINK` and `ARM/@tool`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ArmBody {
    /// A link, by its index in the model.
    Link(usize),
    /// The tool's collision shapes.
    Tool,
}

impl ArmBody {
    /// What FORMAT calls it after the arm's id and a slash.
    pub fn name<'m>(&self, model: &'m ArmModel) -> &'m str {
        match self {
            Self::Link(link) => &model.links[*link].name,
            Self::Tool => "@tool",
        }
    }
}

/// Two bodies of one arm, the lower one first.
pub type BodyPair = (ArmBody, ArmBody);

/// The pair of two bodies in either order.
pub fn body_pair(a: ArmBody, b: ArmBody) -> BodyPair {
    (a.min(b), a.max(b))
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
    /// Pairs of rigid groups of this arm (lower index first) that one movable joint joins, sorted: none of their bodies
    /// are checked against each other. The tool belongs to the mount link's group.
    pub exempt_groups: Vec<(usize, usize)>,
    /// Pairs of bodies of this arm that are not checked against each other either, sorted: those that SRDF or
    /// `allowed_contacts` disable, and those that overlap almost always.
    pub exempt_bodies: Vec<BodyPair>,
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

    /// The rigid group of a body.
    pub fn group_of(&self, body: ArmBody) -> usize {
        match body {
            ArmBody::Link(link) => self.model.links[link].group,
            ArmBody::Tool => self.mount_group(),
        }
    }

    /// The bodies that have shapes, each with the link that carries it; the tool comes after its mount link.
    pub fn bodies(&self) -> impl Iterator<Item = (ArmBody, usize, &[PlacedShape])> {
        bodies(&self.model, &self.tool.shapes)
    }

    /// Whether two bodies of this arm are to be checked against each other.
    pub fn checks_bodies(&self, a: ArmBody, b: ArmBody) -> bool {
        let (one, other) = (self.group_of(a), self.group_of(b));
        one != other
            && self.exempt_groups.binary_search(&(one.min(other), one.max(other))).is_err()
            && self.exempt_bodies.binary_search(&body_pair(a, b)).is_err()
    }
}

/// The bodies of an arm that have shapes, as [`Arm::bodies`]; `tool` hangs on the mount link.
pub fn bodies<'a>(
    model: &'a ArmModel,
    tool: &'a [PlacedShape],
) -> impl Iterator<Item = (ArmBody, usize, &'a [PlacedShape])> {
    let all = model.links.iter().enumerate().flat_map(move |(index, link)| {
        let tool: &[PlacedShape] = if index == model.mount { tool } else { &[] };
        [(ArmBody::Link(index), index, link.shapes.as_slice()), (ArmBody::Tool, index, tool)]
    });
    all.filter(|(.., shapes)| !shapes.is_empty())
}
