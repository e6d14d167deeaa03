//! What an arm can surely not reach: distances against the greatest reach.

use nalgebra::Point3;

use crate::geometry::{Pose, Vec3};
use crate::problem::{InitialPlacement, Problem};
use crate::workcell::{ArmId, ObjectId, Surface, SurfaceId, Symmetry};

/// Play (m) for rounding and for FORMAT's tolerances of poses.
const PLAY: f64 = 5.0e-3;

/// Balls that the arms' mount origins never leave, and how far from the mount origin each arm
/// can hold the objects of each class.
#[derive(Debug)]
pub(super) struct Proof<'a> {
    problem: &'a Problem,
    /// Centre (world) and radius by arm.
    balls: Vec<(Vec3, f64)>,
    /// By class: an object of it, and the holds that are not grasps (object in TCP).
    classes: Vec<(ObjectId, Vec<Pose>)>,
}

impl<'a> Proof<'a> {
    pub(super) fn new(problem: &'a Problem) -> Self {
        let ball = |arm: &crate::workcell::Arm| {
            let reach = arm.model.reach_within(&arm.limits);
            ((arm.base * Point3::from(reach.centre)).coords, reach.radius)
        };
        let count = problem.objects.iter().map(|object| object.class + 1).max().unwrap_or(0);
        let mut classes = vec![(ObjectId(0), Vec::new()); count];
        for (index, object) in problem.objects.iter().enumerate().rev() {
            classes[object.class].0 = ObjectId(index);
        }
        for (object, initial) in problem.objects.iter().zip(&problem.initial) {
            if let InitialPlacement::Held { object_in_tcp, .. } = initial {
                classes[object.class].1.push(*object_in_tcp);
            }
        }
        Self { problem, balls: problem.workcell.arms.iter().map(ball).collect(), classes }
    }

    /// Mount frames in the object's frame, over all ways in which `arm` may hold the class.
    fn mounts(&self, arm: ArmId, class: usize) -> impl Iterator<Item = Pose> + '_ {
        let workcell = &self.problem.workcell;
        let tool = &workcell.arms[arm.0].tool;
        let (object, extra) = &self.classes[class];
        let grasps =
            self.problem.objects[object.0].grasps.iter().filter(|grasp| grasp.fits(tool.max_opening));
        let to_mount = tool.tcp.inverse();
        grasps
            .map(|grasp| grasp.object_in_tcp)
            .chain(extra.iter().copied())
            .map(move |hold| hold.inverse() * to_mount)
    }

    /// Greatest distance (m) from an object's origin to the mount origin of `arm` holding it;
    /// negative infinity when it cannot hold it at all.
    fn farthest_mount(&self, arm: ArmId, class: usize) -> f64 {
        let distances = self.mounts(arm, class).map(|mount| mount.translation.vector.norm());
        distances.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether `arm` may hold an object of `class` at one of `poses`; `false` is a proof.
    pub(super) fn may_hold(&self, arm: ArmId, class: usize, poses: &[Pose]) -> bool {
        let (centre, radius) = self.balls[arm.0];
        let object = self.classes[class].0;
        let symmetry = self.problem.objects[object.0].symmetry;
        if matches!(symmetry, Symmetry::CylinderZ | Symmetry::Sphere) {
            // The poses stand for infinitely many about the same origin.
            let reach = radius + self.farthest_mount(arm, class) + PLAY;
            return poses.iter().any(|pose| (pose.translation.vector - centre).norm() <= reach);
        }
        poses.iter().any(|pose| {
            self.mounts(arm, class).any(|mount| {
                let origin = (pose * mount).translation.vector;
                (origin - centre).norm() <= radius + PLAY
            })
        })
    }

    /// Whether `arm` may hold an object of `class` at rest somewhere on `surface`; `false` is a
    /// proof.
    pub(super) fn may_reach_surface(&self, arm: ArmId, class: usize, surface: SurfaceId) -> bool {
        let (centre, radius) = self.balls[arm.0];
        let surface = &self.problem.workcell.surfaces[surface.0];
        let object = &self.problem.objects[self.classes[class].0.0];
        let reach = radius + self.farthest_mount(arm, class) + object.bounding_radius() + PLAY;
        distance_to_surface(&centre, surface) <= reach
    }

    /// Whether the two arms may hold one object of `class` at once; `false` is a proof.
    pub(super) fn may_meet(&self, a: ArmId, b: ArmId, class: usize) -> bool {
        let ((ca, ra), (cb, rb)) = (self.balls[a.0], self.balls[b.0]);
        (ca - cb).norm() <= ra + rb + self.farthest_mount(a, class) + self.farthest_mount(b, class) + PLAY
    }
}

/// Distance (m) from a point (world) to the surface's rectangle.
fn distance_to_surface(point: &Vec3, surface: &Surface) -> f64 {
    let local = surface.pose.inverse() * Point3::from(*point);
    let beyond = |value: f64, half: f64| (value.abs() - half).max(0.0);
    let aside = beyond(local.x, surface.half_extents[0]).hypot(beyond(local.y, surface.half_extents[1]));
    aside.hypot(local.z)
}
