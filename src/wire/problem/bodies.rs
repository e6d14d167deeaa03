//! Bodies in place, and how deep they overlap: the exact test of the start and the goal.

use crate::geometry::{ExactShape, PlacedShape, Pose};
use crate::workcell::{Arm, ArmBody, Obstacle};

/// Contact is an overlap deeper than this (m).
pub const CONTACT_DEPTH: f64 = 0.002;

/// Shapes that move together, at a pose.
#[derive(Debug, Clone)]
pub struct Body {
    /// FORMAT's name of the body.
    pub name: String,
    /// Which of an arm's bodies it is, if it is one.
    pub of_arm: Option<ArmBody>,
    shapes: Vec<ExactShape>,
    pose: Pose,
    /// Ball around the body's shapes in its frame, as centre and radius.
    ball: (crate::geometry::Vec3, f64),
}

impl Body {
    /// A body of `shapes` at `pose`.
    pub fn new(name: String, of_arm: Option<ArmBody>, shapes: &[PlacedShape], pose: Pose) -> Self {
        let shapes: Vec<ExactShape> = shapes.iter().map(ExactShape::new).collect();
        let count = shapes.len().max(1) as f64;
        let centre = shapes.iter().map(|shape| shape.centre).sum::<crate::geometry::Vec3>() / count;
        let radius =
            shapes.iter().map(|shape| (shape.centre - centre).norm() + shape.radius).fold(0.0, f64::max);
        Self { name, of_arm, shapes, pose, ball: (centre, radius) }
    }

    /// An obstacle.
    pub fn obstacle(obstacle: &Obstacle) -> Self {
        Self::new(obstacle.id.clone(), None, &obstacle.shapes, obstacle.pose)
    }

    /// How deep (m) it overlaps `other`; `None` when that is no contact.
    pub fn contact(&self, other: &Self) -> Option<f64> {
        let mine = self.pose.rotation * self.ball.0 + self.pose.translation.vector;
        let theirs = other.pose.rotation * other.ball.0 + other.pose.translation.vector;
        if (mine - theirs).norm() > self.ball.1 + other.ball.1 {
            return None;
        }
        let mut least = 0.0_f64;
        for a in &self.shapes {
            for b in &other.shapes {
                least = least.min(a.signed_distance(&self.pose, b, &other.pose, 0.0));
            }
        }
        (least < -CONTACT_DEPTH).then_some(-least)
    }
}

/// The links and the tool of `arm` at `q`.
pub fn arm_bodies(arm: &Arm, q: &[f64]) -> Vec<Body> {
    let mut poses = Vec::new();
    arm.model.link_poses(q, &mut poses);
    let named = |(body, link, shapes): (ArmBody, usize, &[PlacedShape])| {
        let name = format!("{}/{}", arm.id, body.name(&arm.model));
        Body::new(name, Some(body), shapes, arm.base * poses[link])
    };
    arm.bodies().map(named).collect()
}

/// The deepest contact among the pairs that `checks` lets through.
pub fn deepest<'b>(
    ones: &'b [Body],
    others: &'b [Body],
    mut checks: impl FnMut(&Body, &Body) -> bool,
) -> Option<(&'b Body, &'b Body, f64)> {
    let mut worst: Option<(&Body, &Body, f64)> = None;
    for one in ones {
        for other in others {
            if checks(one, other)
                && let Some(depth) = one.contact(other)
                && worst.is_none_or(|(_, _, deepest)| depth > deepest)
            {
                worst = Some((one, other, depth));
            }
        }
    }
    worst
}
