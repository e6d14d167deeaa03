//! Poses and distances against Pinocchio and coal (tests/foreign), and motion bounds against
//! sampling, on the library's iiwa14.

use proptest::prelude::*;
use rand::Rng as _;

use super::super::arms::Arms;
use super::super::chain::Chain;
use super::super::contact::least_distance;
use super::super::curve::Curve;
use super::super::gap::Frame;
use super::super::scene::{Owner, Scene};
use crate::geometry::{Vec3, pose_from_parts};
use crate::plan::{ArmTrajectory, TrajectoryPoint};
use crate::problem::Problem;
use crate::run::Seed;
use crate::wire::{LibraryOnly, ReadLimits, read_problem};
use crate::workcell::ArmId;

/// The cell of tests/foreign.
fn cell() -> Problem {
    let document = include_bytes!("../../../tests/foreign/cell.json");
    read_problem(document, &LibraryOnly, &ReadLimits::default()).expect("a sound problem").problem
}

/// An arm that stands still at `q` for a second.
fn still(q: &[f64]) -> Curve {
    let point = |t| TrajectoryPoint { t, q: q.to_vec(), qd: vec![0.0; q.len()], qdd: vec![0.0; q.len()] };
    Curve::new(&ArmTrajectory { points: vec![point(0.0), point(1.0)] }, q.len())
}

#[test]
fn poses_and_distances_are_those_of_pinocchio_and_coal() {
    let problem = cell();
    let chains = || problem.workcell.arms.iter().map(Chain::new).collect::<Vec<_>>();
    let chain = chains();
    let scene = Scene::new(&problem, |arm| &chain[arm]);
    let mut compared = 0;
    for line in include_str!("../../../tests/foreign/reference.csv").lines() {
        let row: Vec<f64> = line.split(',').map(|value| value.parse().expect("a number")).collect();
        let [one, two, position, turn, distances] =
            [&row[0..7], &row[7..14], &row[14..17], &row[17..21], &row[21..24]];
        let mut arms = Arms::new(chains(), vec![still(one), still(two)]);
        let tcp = arms.tcp(ArmId(0), 0.5);
        let wanted = pose_from_parts(
            position.try_into().expect("three values"),
            turn.try_into().expect("four values"),
        );
        assert!((tcp.position - wanted.translation.vector).norm() < 3e-6, "{line}");
        let off = wanted.rotation.to_rotation_matrix().matrix() - tcp.rotation;
        assert!(off.norm() < 1e-5, "{line}");
        let mut frames = [Vec::new(), Vec::new()];
        let mut excursions = Vec::new();
        for (arm, frames) in frames.iter_mut().enumerate() {
            arms.place(arm, 0.5, 0.5, &mut Vec::new(), frames, &mut excursions);
        }
        // Where each body is: the arm's index (2 for the box), movable joints before it, its frame.
        let bodies: Vec<(usize, usize, Frame)> = scene
            .bodies
            .iter()
            .map(|body| match body.owner {
                Owner::Arm { arm, node } => (arm, chain[arm].depth(node), frames[arm][node]),
                _ => (2, 0, Frame::of(scene.obstacle_pose(0))),
            })
            .collect();
        let least = |wanted: &dyn Fn((usize, usize), (usize, usize)) -> bool| {
            let mut least = f64::INFINITY;
            for (i, a) in bodies.iter().enumerate() {
                for (j, b) in bodies.iter().enumerate() {
                    if wanted((a.0, a.1), (b.0, b.1)) {
                        least = least.min(least_distance(&scene.bodies[i], &a.2, &scene.bodies[j], &b.2));
                    }
                }
            }
            least
        };
        let found = [
            least(&|a, b| a.0 == 0 && b.0 == 1 && a.1.min(b.1) >= 3),
            least(&|a, b| a.0 == 0 && b.0 == 2),
            least(&|a, b| a.0 == 0 && b.0 == 0 && a.1 + 3 <= b.1),
        ];
        for (found, wanted) in found.into_iter().zip(distances) {
            if *wanted > 1e-6 {
                compared += 1;
                assert!((found - wanted).abs() < 2e-5, "{found} {wanted} {line}");
            } else {
                assert!(found < 1e-5, "{found} {wanted} {line}");
            }
        }
    }
    assert!(compared > 2500, "{compared}");
}

#[test]
fn frames_are_those_of_the_arm_model() {
    let problem = cell();
    let mut rng = Seed(1).stream("frames");
    for arm in &problem.workcell.arms {
        let chain = Chain::new(arm);
        let (mut frames, mut poses) = (Vec::new(), Vec::new());
        for _ in 0..100 {
            let q: Vec<f64> = arm.limits.iter().map(|l| rng.random_range(l.lower..l.upper)).collect();
            chain.frames(&q, &mut frames);
            arm.model.link_poses(&q, &mut poses);
            for (link, pose) in poses.iter().enumerate() {
                let (node, local) = chain.link(link);
                let found = frames[node].compose(&local);
                let wanted = Frame::of(&(arm.base * pose));
                assert!((found.position - wanted.position).norm() < 1e-9);
                assert!((found.rotation - wanted.rotation).norm() < 1e-9);
            }
            assert!((chain.tcp_frame(&frames).position - arm.tcp_pose(&q).translation.vector).norm() < 1e-9);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// No point of a ball on any link moves farther than the bound, in the world and as seen from
    /// any link before it.
    #[test]
    fn motion_bounds_hold(
        ends in proptest::array::uniform2([-2.0..2.0_f64, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0]),
        speeds in proptest::array::uniform2([-2.0..2.0_f64, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0]),
        span in 0.001..1.0_f64,
        centre in [-0.3..0.3_f64, -0.3..0.3, -0.3..0.3],
        radius in 0.0..0.2_f64,
        direction in [-1.0..1.0_f64, -1.0..1.0, -1.0..1.0],
    ) {
        let problem = cell();
        let chain = Chain::new(&problem.workcell.arms[0]);
        let points = (0..2).map(|i| TrajectoryPoint {
            t: i as f64,
            q: ends[i].to_vec(),
            qd: speeds[i].to_vec(),
            qdd: vec![0.0; 7],
        });
        let curve = Curve::new(&ArmTrajectory { points: points.collect() }, 7);
        let (a, b) = (0.5 - 0.5 * span, 0.5 + 0.5 * span);
        let arms = Arms::new(vec![chain.clone()], vec![curve]);
        let (mut frames, mut excursions) = (Vec::new(), Vec::new());
        arms.place(0, a, b, &mut Vec::new(), &mut frames, &mut excursions);
        let centre = Vec3::from(centre);
        let point = centre + Vec3::from(direction).try_normalize(1e-6).unwrap_or_else(Vec3::x) * radius;
        for node in 0..chain.len() {
            let world = frames[node].apply(&centre);
            let mut bounds = vec![0.0; chain.depth(node) + 1];
            chain.motion_bounds(node, &world, radius, &frames, &excursions, &mut bounds);
            let (mut now, mut unused) = (Vec::new(), Vec::new());
            for i in 0..=40 {
                let t = a + (b - a) * f64::from(i) / 40.0;
                arms.place(0, t, t, &mut Vec::new(), &mut now, &mut unused);
                let moved = (now[node].apply(&point) - frames[node].apply(&point)).norm();
                prop_assert!(moved <= bounds[0] + 1e-9, "{moved} {bounds:?}");
                for before in 0..node {
                    let seen = |frames: &[Frame]| frames[before].inverse().apply(&frames[node].apply(&point));
                    let moved = (seen(&now) - seen(&frames)).norm();
                    let bound = bounds[chain.common(before, node)];
                    prop_assert!(moved <= bound + 1e-9, "{moved} {bound}");
                }
            }
        }
    }
}
