//! The arm model and its forward kinematics.

use std::sync::OnceLock;

use nalgebra::{Translation3, Unit, UnitQuaternion};
use smallvec::SmallVec;

use super::UrdfError;
use super::chain::Chain;
use super::inverse::Solver;
use super::lever::Reach;
use crate::geometry::{PlacedShape, Pose, Vec3};

/// Joint values of one arm, root to mount: radians (revolute) or metres (prismatic).
pub type Config = SmallVec<[f64; 8]>;

/// What one joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Least value (rad or m); negative infinity for a continuous joint.
    pub lower: f64,
    /// Greatest value (rad or m); infinity for a continuous joint.
    pub upper: f64,
    /// Greatest speed (rad/s or m/s), positive.
    pub velocity: f64,
    /// Greatest acceleration (rad/s^2 or m/s^2), positive.
    pub acceleration: f64,
}

/// One movable joint of the chain from the root to the mount link.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Its name in the URDF.
    pub name: String,
    /// The link that it moves.
    pub link: usize,
    /// Limits from the URDF; velocity or acceleration is 0 where the URDF gives none.
    pub limits: JointLimits,
    /// What is wrong with these limits, which are then to be replaced before the arm is used; `None` for
    /// all joints of a model that [`ArmModel::from_urdf`] gives.
    pub limit_fault: Option<UrdfError>,
}

/// How a link moves against its parent.
#[derive(Debug, Clone)]
pub enum LinkMotion {
    /// Rigidly joined, or a joint outside the chain that is held where `home` put it (its value
    /// is already in [`Link::origin`]).
    Held,
    /// Turns about `axis` by `multiplier * q[joint] + offset`.
    Revolute {
        /// Axis in the joint frame.
        axis: Unit<Vec3>,
        /// Which joint of the chain drives it.
        joint: usize,
        /// 1 except for mimic joints.
        multiplier: f64,
        /// 0 except for mimic joints (rad).
        offset: f64,
    },
    /// Slides along `axis` by `multiplier * q[joint] + offset`.
    Prismatic {
        /// Axis in the joint frame.
        axis: Unit<Vec3>,
        /// Which joint of the chain drives it.
        joint: usize,
        /// 1 except for mimic joints.
        multiplier: f64,
        /// 0 except for mimic joints (m).
        offset: f64,
    },
}

/// One URDF link.
#[derive(Debug, Clone)]
pub struct Link {
    /// Its name in the URDF.
    pub name: String,
    /// The link before it; `None` for the root. Parents stand before their children.
    pub parent: Option<usize>,
    /// The joint frame in the parent's frame.
    pub origin: Pose,
    /// How it moves against that frame.
    pub motion: LinkMotion,
    /// Its rigid group: links joined by `fixed` URDF joints share one; the root's is 0. A movable
    /// joint starts a new group even where it is held.
    pub group: usize,
    /// Collision shapes in the link's frame, capsule triples already merged.
    pub shapes: Vec<PlacedShape>,
}

/// An immutable arm: every link of the URDF, and the chain of movable joints up to the mount link.
#[derive(Debug, Clone)]
pub struct ArmModel {
    /// The robot's name.
    pub name: String,
    /// All links, root first, parents before children.
    pub links: Vec<Link>,
    /// The chain's joints, root to mount.
    pub joints: Vec<Joint>,
    /// The link that carries the tool.
    pub mount: usize,
    pub(super) chain: Chain,
    pub(super) solver: Solver,
    /// What [`ArmModel::reach_within`] was first asked about, and what it said.
    pub(super) reach: OnceLock<(Vec<JointLimits>, Reach)>,
}

impl ArmModel {
    /// An arm of `links` (root first, parents before children), its chain's `joints` (root to
    /// mount) and the index of its mount link.
    pub fn new(name: String, links: Vec<Link>, joints: Vec<Joint>, mount: usize) -> Self {
        let chain = Chain::new(&links, mount, joints.len());
        let solver = Solver::new(&chain);
        Self { name, links, joints, mount, chain, solver, reach: OnceLock::new() }
    }

    /// Number of joints in the chain.
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// The index of the link named `name`.
    pub fn link_index(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link.name == name)
    }

    /// Poses of all links in the root link's frame at `q`, written to `out` (cleared first).
    pub fn link_poses(&self, q: &[f64], out: &mut Vec<Pose>) {
        out.clear();
        for link in &self.links {
            let local = match &link.motion {
                LinkMotion::Held => link.origin,
                LinkMotion::Revolute { axis, joint, multiplier, offset } => {
                    link.origin * UnitQuaternion::from_axis_angle(axis, multiplier * q[*joint] + offset)
                }
                LinkMotion::Prismatic { axis, joint, multiplier, offset } => {
                    let slide = axis.into_inner() * (multiplier * q[*joint] + offset);
                    link.origin * Translation3::from(slide)
                }
            };
            let pose = match link.parent {
                Some(parent) => out[parent] * local,
                None => local,
            };
            out.push(pose);
        }
    }

    /// The mount link's pose in the root link's frame at `q`.
    pub fn mount_pose(&self, q: &[f64]) -> Pose {
        self.chain.mount_pose(q)
    }

    /// A point given in the mount link's frame, in the root link's frame at `q` (m).
    pub fn mount_point(&self, q: &[f64], point: &Vec3) -> Vec3 {
        self.chain.mount_point(q, point)
    }
}
