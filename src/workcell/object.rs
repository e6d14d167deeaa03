//! Movable objects and the ways to hold them.

use super::shape_rotations;
use crate::geometry::{PlacedShape, Pose, Vec3};

/// An object no farther (m, rad) from its goal counts as there: nineteen twentieths of what the judge allows.
const AT_GOAL: (f64, f64) = (0.95e-3, 0.475 * std::f64::consts::PI / 180.0);

/// One way to hold an object.
#[derive(Debug, Clone)]
pub struct Grasp {
    /// A name, unique within the object.
    pub id: String,
    /// The object's frame in the TCP frame.
    pub object_in_tcp: Pose,
    /// How wide (m) the fingers must open for it: the object's extent along the closing direction;
    /// 0 for an explicit grasp. An arm whose tool opens less cannot use it.
    pub opening: f64,
}

impl Grasp {
    /// Whether a gripper that opens at most `max_opening` (m) can use it.
    pub fn fits(&self, max_opening: f64) -> bool {
        self.opening <= max_opening + 1.0e-9
    }
}

/// Rotations of an object about its own frame that make no difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symmetry {
    /// None but the identity.
    None,
    /// The rotations that map the box around it onto itself.
    Box,
    /// Any turn about z, and upside down.
    CylinderZ,
    /// Any rotation.
    Sphere,
}

/// A movable object.
#[derive(Debug, Clone)]
pub struct ObjectModel {
    /// Its id in the problem.
    pub id: String,
    /// Collision shapes in its frame.
    pub shapes: Vec<PlacedShape>,
    /// Mass (kg), for the record.
    pub mass: f64,
    /// Its symmetry, up to which goal poses are met.
    pub symmetry: Symmetry,
    /// The rotations of its symmetry when these are finitely many (the identity first); for
    /// [`Symmetry::CylinderZ`] and [`Symmetry::Sphere`] the identity alone.
    pub symmetry_rotations: Vec<nalgebra::UnitQuaternion<f64>>,
    /// All grasps, generators expanded for the widest gripper of the workcell, in a fixed order;
    /// [`Grasp::fits`] says which of them an arm can use.
    pub grasps: Vec<Grasp>,
    /// Length of the straight approach before a grasp or release (m).
    pub approach: f64,
    /// Length of the straight retreat after it (m).
    pub retreat: f64,
    /// Objects of one class have equal shapes, grasps, symmetry, approach and retreat.
    pub class: usize,
}

impl ObjectModel {
    /// The pose of the object held with `grasp` by a TCP at `tcp`.
    pub fn held_pose(&self, grasp: usize, tcp: &Pose) -> Pose {
        tcp * self.grasps[grasp].object_in_tcp
    }

    /// The angle (rad) between its orientations at two poses, up to its symmetry.
    pub fn turn_between(&self, from: &Pose, to: &Pose) -> f64 {
        let turn = to.rotation.inverse() * from.rotation;
        match self.symmetry {
            Symmetry::Sphere => 0.0,
            // Its axis may point either way.
            Symmetry::CylinderZ => {
                let axis = turn * Vec3::z();
                axis.xy().norm().atan2(axis.z.abs())
            }
            Symmetry::None | Symmetry::Box => {
                let turned = self.symmetry_rotations.iter().map(|rotation| rotation.angle_to(&turn));
                turned.fold(turn.angle(), f64::min)
            }
        }
    }

    /// Whether at `a` it is where it is at `b`, up to its symmetry, a distance (m) and an angle (rad).
    pub fn is_within(&self, a: &Pose, b: &Pose, (off, turn): (f64, f64)) -> bool {
        (a.translation.vector - b.translation.vector).norm() <= off && self.turn_between(a, b) <= turn
    }

    /// Whether at `pose` it is at `goal` already, with a margin to what the judge allows.
    pub fn is_at_goal(&self, pose: &Pose, goal: &Pose) -> bool {
        self.is_within(pose, goal, AT_GOAL)
    }

    /// Whether its symmetry is that of the box around it and not its own: turned by it, it takes other
    /// room, and may not rest.
    pub fn only_counts_as_box(&self) -> bool {
        if self.symmetry != Symmetry::Box {
            return false;
        }
        let own = match self.shapes.as_slice() {
            [one] if one.pose == Pose::identity() => shape_rotations(&one.shape),
            _ => return true,
        };
        let is_own = |turn| own.iter().any(|rotation| rotation.angle_to(turn) < 1.0e-6);
        !self.symmetry_rotations.iter().all(is_own)
    }

    /// The radius (m) of the ball around the object's origin that holds it.
    pub fn bounding_radius(&self) -> f64 {
        self.shapes.iter().map(PlacedShape::bounding_radius).fold(0.0, f64::max)
    }
}
