//! What is called impossible never happens: random configurations of real arms.

use rand::Rng as _;

use super::cell::{Cell, Cube, at};
use crate::kinematics::Config;
use crate::mode_graph::proof::Proof;
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::workcell::{ArmId, SurfaceId, rests_on};

fn random_hold(problem: &Problem, arm: usize, rng: &mut Rng) -> crate::geometry::Pose {
    let arm = &problem.workcell.arms[arm];
    let q: Config = arm.limits.iter().map(|l| rng.random_range(l.lower..=l.upper)).collect();
    let grasps = &problem.objects[0].grasps;
    arm.tcp_pose(&q) * grasps[rng.random_range(0..grasps.len())].object_in_tcp
}

#[test]
fn whatever_an_arm_holds_it_may_hold() {
    let problem = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]).problem();
    let proof = Proof::new(&problem);
    let mut rng = Seed(3).stream("proofs");
    let mut rested = 0;
    for _ in 0..5_000 {
        for arm in 0..2 {
            let pose = random_hold(&problem, arm, &mut rng);
            assert!(proof.may_hold(ArmId(arm), 0, &[pose]));
            // The same with a surface slid under it.
            let mut low = pose;
            low.translation.vector.z = 0.03;
            low.rotation = nalgebra::UnitQuaternion::identity();
            let surface = &problem.workcell.surfaces[arm];
            let on = rests_on(&problem.objects[0].shapes, &low, surface).is_ok();
            if on && proof.may_hold(ArmId(arm), 0, &[low]) {
                rested += 1;
                assert!(proof.may_reach_surface(ArmId(arm), 0, SurfaceId(arm)));
            }
        }
    }
    assert!(rested > 20);
}

#[test]
fn arms_that_hold_one_object_may_meet() {
    let problem = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]).problem();
    let mut rng = Seed(4).stream("proofs");
    for _ in 0..500 {
        // Put the second arm so that both hold the object at one pose.
        let pose = random_hold(&problem, 0, &mut rng);
        let other = random_hold(&problem, 1, &mut rng);
        let mut moved = problem.clone();
        let mut workcell = (*problem.workcell).clone();
        workcell.arms[1].base = pose * other.inverse() * workcell.arms[1].base;
        moved.workcell = std::sync::Arc::new(workcell);
        assert!(Proof::new(&moved).may_meet(ArmId(0), ArmId(1), 0));
    }
}

#[test]
fn far_things_are_out_of_reach() {
    let problem = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]).problem();
    let proof = Proof::new(&problem);
    // The far table is 1.46 m or more from the first base.
    assert!(!proof.may_reach_surface(ArmId(0), 0, SurfaceId(1)));
    assert!(!proof.may_hold(ArmId(0), 0, &[at(1.66, 0.0, 0.0)]));
    assert!(proof.may_hold(ArmId(0), 0, &[at(-0.56, 0.0, 0.0)]));
    let mut far = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]);
    far.arms[1] = [3.0, 0.0];
    assert!(!Proof::new(&far.problem()).may_meet(ArmId(0), ArmId(1), 0));
}
