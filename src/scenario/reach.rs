//! The geometric rule of the generator, held against inverse kinematics and exact collision.

use nalgebra::Translation3;

use super::{Family, generate};
use crate::geometry::{ExactShape, Pose, Vec3};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::run::Seed;
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::{Arm, ArmBody, ArmId, ObjectModel, ObstacleId};

struct Cell<'p> {
    problem: &'p Problem,
    obstacles: Vec<Vec<ExactShape>>,
}

impl<'p> Cell<'p> {
    fn new(problem: &'p Problem) -> Self {
        let obstacles = problem.workcell.obstacles.iter();
        let obstacles = obstacles.map(|o| o.shapes.iter().map(ExactShape::new).collect()).collect();
        Self { problem, obstacles }
    }

    /// Whether the arm touches neither itself nor an obstacle at `q`.
    fn is_free(&self, index: usize, q: &[f64]) -> bool {
        let arm = &self.problem.workcell.arms[index];
        let mut poses = Vec::new();
        arm.model.link_poses(q, &mut poses);
        let mut parts: Vec<(ArmBody, Pose, ExactShape)> = Vec::new();
        for (body, link, shapes) in arm.bodies() {
            parts.extend(shapes.iter().map(|s| (body, arm.base * poses[link], ExactShape::new(s))));
        }
        for (at, (part, pose, shape)) in parts.iter().enumerate() {
            for (other_part, other_pose, other) in &parts[..at] {
                if arm.checks_bodies(*part, *other_part)
                    && shape.signed_distance(pose, other, other_pose, 0.002) < 0.002
                {
                    return false;
                }
            }
            for (id, (body, shapes)) in
                self.problem.workcell.obstacles.iter().zip(&self.obstacles).enumerate()
            {
                if self.problem.workcell.arm_may_touch(ArmId(index), *part, ObstacleId(id)) {
                    continue;
                }
                if shapes.iter().any(|o| shape.signed_distance(pose, o, &body.pose, 0.002) < 0.002) {
                    return false;
                }
            }
        }
        true
    }

    /// Whether the arm follows the TCP's straight way from `q` by `offset` (world) freely.
    fn follows(&self, index: usize, arm: &Arm, tcp: &Pose, q: &[f64], offset: Vec3) -> bool {
        let mut q = q.to_vec();
        (1..=8).all(|step| {
            let at = Translation3::from(offset * (f64::from(step) / 8.0)) * tcp;
            let target = arm.base.inverse() * at * arm.tool.tcp.inverse();
            match arm.model.inverse_near(&arm.limits, &target, &q, 0.3) {
                Some(next) => {
                    q = next.to_vec();
                    self.is_free(index, &q)
                }
                None => false,
            }
        })
    }

    /// Whether some arm can come to the object at `pose`, grasp it and lift it.
    fn is_served(&self, object: &ObjectModel, pose: &Pose) -> bool {
        let mut rng = Seed(1).stream("reach");
        let mut solutions = Vec::new();
        self.problem.workcell.arms.iter().enumerate().any(|(index, arm)| {
            if (pose.translation.vector - arm.base.translation.vector).norm() > 1.2 {
                return false;
            }
            object.grasps.iter().any(|grasp| {
                let tcp = pose * grasp.object_in_tcp.inverse();
                let approach = tcp.rotation * Vec3::z();
                // From above, as the table allows.
                if approach.z > -0.5 {
                    return false;
                }
                let target = arm.base.inverse() * tcp * arm.tool.tcp.inverse();
                arm.model.inverse(&arm.limits, &target, 5, &mut rng, &mut solutions);
                solutions.iter().any(|q| {
                    self.is_free(index, q)
                        && self.follows(index, arm, &tcp, q, -approach * object.approach)
                        && self.follows(index, arm, &tcp, q, Vec3::z() * object.retreat)
                })
            })
        })
    }
}

#[test]
fn every_place_is_served_by_an_arm() {
    let sizes = [
        (Family::Random, 2, 4),
        (Family::Random, 4, 6),
        (Family::Random, 9, 8),
        (Family::Derangement, 1, 4),
        (Family::Ring, 5, 6),
        (Family::Ring, 12, 8),
    ];
    for (family, arms, objects) in sizes {
        for seed in 0..2 {
            let document = generate(family, arms, objects, seed).unwrap();
            let problem =
                read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
            let cell = Cell::new(&problem);
            let placements = problem.objects.iter().zip(&problem.initial).zip(&problem.goal);
            for ((object, initial), goal) in placements {
                let (InitialPlacement::Resting { pose: start, .. }, GoalPlacement::Pose { pose: end, .. }) =
                    (initial, goal)
                else {
                    panic!("the generator gives poses");
                };
                for pose in [start, end] {
                    assert!(
                        cell.is_served(object, pose),
                        "{} {arms} arms, seed {seed}, {}",
                        family.name(),
                        pose.translation
                    );
                }
            }
        }
    }
}
