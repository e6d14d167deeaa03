//! The chain from the root to the mount link alone, held joints folded in, for whatever runs
//! often: mount pose, Jacobian, inverse kinematics.

use nalgebra::{Quaternion, Translation3, Unit, UnitQuaternion, Vector6};
use smallvec::SmallVec;

use super::model::{Link, LinkMotion};
use super::sine::sin_cos;
use crate::geometry::{Pose, Vec3};

/// How a step of the chain moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StepKind {
    /// Turns about the axis.
    Turn,
    /// Slides along the axis.
    Slide,
}

/// One movable link of the chain.
#[derive(Debug, Clone)]
pub(super) struct ChainStep {
    /// The joint frame in the frame that the step before leaves behind.
    pub fixed: Pose,
    /// Axis in the joint frame.
    pub axis: Unit<Vec3>,
    /// The rotation of `fixed` times half a turn about the axis: `fixed` turned by any angle is a sum of these two.
    half_turned: Quaternion<f64>,
    pub kind: StepKind,
    /// The driving joint.
    pub joint: usize,
    pub multiplier: f64,
    pub offset: f64,
}

/// The chain.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    pub steps: Vec<ChainStep>,
    /// The mount frame in the frame that the last step leaves behind.
    pub tail: Pose,
    pub dof: usize,
}

/// One column per joint: linear, then angular motion of the mount origin in the root frame.
pub(super) type Columns = SmallVec<[Vector6<f64>; 8]>;

impl Chain {
    /// The chain that ends at `mount`.
    pub fn new(links: &[Link], mount: usize, dof: usize) -> Self {
        let mut path = Vec::new();
        let mut next = Some(mount);
        while let Some(index) = next {
            path.push(index);
            next = links[index].parent;
        }
        let mut steps = Vec::with_capacity(dof);
        let mut fixed = Pose::identity();
        for index in path.into_iter().rev() {
            let link = &links[index];
            fixed *= link.origin;
            let (kind, (axis, joint, multiplier, offset)) = match &link.motion {
                LinkMotion::Held => continue,
                LinkMotion::Revolute { axis, joint, multiplier, offset } => {
                    (StepKind::Turn, (*axis, *joint, *multiplier, *offset))
                }
                LinkMotion::Prismatic { axis, joint, multiplier, offset } => {
                    (StepKind::Slide, (*axis, *joint, *multiplier, *offset))
                }
            };
            let half_turned = fixed.rotation.quaternion() * Quaternion::from_imag(axis.into_inner());
            steps.push(ChainStep { fixed, axis, half_turned, kind, joint, multiplier, offset });
            fixed = Pose::identity();
        }
        Self { steps, tail: fixed, dof }
    }

    /// The mount frame in the root frame at `q`.
    pub fn mount_pose(&self, q: &[f64]) -> Pose {
        let mut pose = Pose::identity();
        for step in &self.steps {
            pose *= step.local(q);
        }
        pose * self.tail
    }

    /// A point of the mount frame in the root frame at `q`: cheaper than the frame.
    pub fn mount_point(&self, q: &[f64], point: &Vec3) -> Vec3 {
        let point = self.tail * nalgebra::Point3::from(*point);
        self.steps.iter().rev().fold(point, |point, step| step.local(q) * point).coords
    }

    /// The mount frame at `q`, with the Jacobian's columns in `columns`.
    pub fn mount_pose_and_jacobian(&self, q: &[f64], columns: &mut Columns) -> Pose {
        let mut frames: SmallVec<[(Vec3, Vec3); 8]> = SmallVec::new();
        let mut pose = Pose::identity();
        for step in &self.steps {
            pose *= step.fixed;
            frames.push((pose.rotation * step.axis.into_inner(), pose.translation.vector));
            pose = step.advance(pose, q);
        }
        let mount = pose * self.tail;
        columns.clear();
        columns.resize(self.dof, Vector6::zeros());
        for (step, (axis, origin)) in self.steps.iter().zip(&frames) {
            let (linear, angular) = match step.kind {
                StepKind::Turn => (axis.cross(&(mount.translation.vector - origin)), *axis),
                StepKind::Slide => (*axis, Vec3::zeros()),
            };
            let column = &mut columns[step.joint];
            for row in 0..3 {
                column[row] += step.multiplier * linear[row];
                column[row + 3] += step.multiplier * angular[row];
            }
        }
        mount
    }

    /// Whether every step is an independent revolute joint, in the joints' order.
    pub fn is_plain_revolute(&self) -> bool {
        self.steps.len() == self.dof
            && self.steps.iter().enumerate().all(|(index, step)| {
                step.kind == StepKind::Turn
                    && step.joint == index
                    && step.multiplier == 1.0
                    && step.offset == 0.0
            })
    }

    /// Axis direction and a point of the axis, in the root frame at zero, of every step.
    pub fn axes_at_zero(&self) -> Vec<(Vec3, Vec3)> {
        let mut pose = Pose::identity();
        self.steps
            .iter()
            .map(|step| {
                pose *= step.fixed;
                (pose.rotation * step.axis.into_inner(), pose.translation.vector)
            })
            .collect()
    }
}

impl ChainStep {
    /// The frame after the step in that before it.
    #[inline]
    fn local(&self, q: &[f64]) -> Pose {
        match self.kind {
            StepKind::Turn => {
                let (sine, cosine) = sin_cos((self.multiplier * q[self.joint] + self.offset) / 2.0);
                let turn = self.fixed.rotation.quaternion() * cosine + self.half_turned * sine;
                Pose::from_parts(self.fixed.translation, UnitQuaternion::new_unchecked(turn))
            }
            StepKind::Slide => self.advance(self.fixed, q),
        }
    }

    /// The frame after the step, from the joint frame at `pose`.
    #[inline]
    fn advance(&self, pose: Pose, q: &[f64]) -> Pose {
        let value = self.multiplier * q[self.joint] + self.offset;
        match self.kind {
            StepKind::Turn => {
                let (sine, cosine) = sin_cos(value / 2.0);
                let turn = Quaternion::from_parts(cosine, self.axis.into_inner() * sine);
                pose * UnitQuaternion::new_unchecked(turn)
            }
            StepKind::Slide => pose * Translation3::from(self.axis.into_inner() * value),
        }
    }
}
