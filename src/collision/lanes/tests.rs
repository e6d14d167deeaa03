//! The lanes against the same certification in double precision with exact shapes.

use rand::Rng as _;

use crate::collision::reference;
use crate::collision::{CollisionWorld, Exemption, Held, JointMotion, Scene, StraightMotion, Taking};
use crate::geometry::lanes::InstructionSet;
use crate::geometry::{ConvexHull, PlacedShape, Shape, Vec3, pose_from_parts};
use crate::kinematics::{ArmModel, Config, NoMeshes};
use crate::problem::{InitialPlacement, Problem};
use crate::run::{Rng, Seed};
use crate::wire::{Folder, ReadLimits, read_problem};
use crate::workcell::{ArmId, ObjectId, ObstacleId};

pub(super) fn problem(name: &str) -> Problem {
    let entry = crate::scenario::find(name).unwrap();
    read_problem(entry.text.as_bytes(), &Folder::new("."), &ReadLimits::default()).unwrap().problem
}

pub(super) fn sets() -> [InstructionSet; 2] {
    [InstructionSet::best(), InstructionSet::portable()]
}

pub(super) fn random_config(problem: &Problem, arm: ArmId, rng: &mut Rng) -> Config {
    let arm = &problem.workcell.arms[arm.0];
    let near_home = rng.random_bool(0.6);
    arm.limits
        .iter()
        .zip(&arm.home)
        .map(|(limit, home)| {
            let half = if near_home { 0.5 } else { 6.0 };
            rng.random_range(limit.lower.max(home - half)..limit.upper.min(home + half))
        })
        .collect()
}

pub(super) fn random_held(problem: &Problem, rng: &mut Rng) -> Option<Held> {
    let object = ObjectId(rng.random_range(0..problem.objects.len()));
    let mut r = || rng.random_range(-1.0..1.0);
    let object_in_tcp =
        pose_from_parts([0.01 * r(), 0.01 * r(), 0.02 * r()], [r(), r(), r(), 1.2 + 0.2 * r()]);
    rng.random_bool(0.5).then_some(Held { object, object_in_tcp })
}

pub(super) fn random_exemption(problem: &Problem, rng: &mut Rng) -> Exemption {
    Exemption {
        hand_with: rng.random_bool(0.3).then(|| ObjectId(rng.random_range(0..problem.objects.len()))),
        held_with: rng
            .random_bool(0.3)
            .then(|| ObstacleId(rng.random_range(0..problem.workcell.obstacles.len()))),
    }
}

/// Objects where they start, and some where the arms will meet them.
fn random_scene(problem: &Problem, rng: &mut Rng) -> Scene {
    let resting = problem.initial.iter().enumerate().filter_map(|(object, placement)| match placement {
        InitialPlacement::Resting { pose, .. } => Some((ObjectId(object), *pose)),
        InitialPlacement::Held { .. } => None,
    });
    let mut scene = Scene { resting: resting.collect() };
    if let Some((_, pose)) = scene.resting.first_mut() {
        let mut r = || rng.random_range(-1.0..1.0);
        *pose = pose_from_parts([0.5 * r(), 0.5 * r(), 1.0 + 0.4 * r()], [r(), r(), r(), 1.2]);
    }
    scene
}

pub(super) struct Case {
    pub(super) arm: ArmId,
    pub(super) q: Config,
    pub(super) to: Config,
    pub(super) held: Option<Held>,
    pub(super) exemption: Exemption,
}

pub(super) fn random_case(problem: &Problem, rng: &mut Rng) -> Case {
    let arm = ArmId(rng.random_range(0..problem.workcell.arms.len()));
    let q = random_config(problem, arm, rng);
    let far = random_config(problem, arm, rng);
    let part = if rng.random_bool(0.5) { 0.05 } else { 0.5 };
    let to = q.iter().zip(&far).map(|(a, b)| a + (b - a) * part).collect();
    Case { arm, q, to, held: random_held(problem, rng), exemption: random_exemption(problem, rng) }
}

#[test]
fn single_configurations_get_the_exact_verdict() {
    for (name, cases) in [("switch/9x4", 3000), ("in_place_swap/1x2", 1500)] {
        let problem = problem(name);
        for set in sets() {
            let world = CollisionWorld::with_instructions(&problem, set);
            let mut rng = Seed(21).stream(name);
            let mut free = 0;
            for _ in 0..cases {
                let case = random_case(&problem, &mut rng);
                let scene = random_scene(&problem, &mut rng);
                let found = world.config_free(case.arm, &case.q, case.held.as_ref(), &scene, case.exemption);
                let motion = StraightMotion::rest(&case.q);
                let truth = reference::is_free(&world, &case.parts(&motion), &scene);
                assert_eq!(found, truth, "{} {:?} {:?}", set.name(), case.arm, case.q);
                free += usize::from(truth);
            }
            assert!(free > cases / 10 && free < cases * 9 / 10, "{free} of {cases}");
        }
    }
}

impl Case {
    pub(super) fn parts<'a>(&'a self, motion: &'a dyn JointMotion) -> Taking<'a> {
        (self.arm, motion, self.held.as_ref(), self.exemption)
    }
}

/// Cylinders and convex pieces, which their capsules do not show as they are.
#[test]
fn objects_that_are_flat_get_the_exact_verdict() {
    let mut problem = problem("switch/4x4");
    let mut rng = Seed(27).stream("flat");
    for (number, object) in problem.objects.iter_mut().enumerate() {
        let shape = if number % 2 == 0 {
            Shape::Cylinder { radius: 0.09, half_length: 0.02 }
        } else {
            let mut r = || rng.random_range(-1.0..1.0);
            let points: Vec<Vec3> = (0..14).map(|_| Vec3::new(0.1 * r(), 0.08 * r(), 0.02 * r())).collect();
            Shape::Convex(std::sync::Arc::new(ConvexHull::new(&points).unwrap()))
        };
        object.shapes =
            vec![PlacedShape { shape, pose: pose_from_parts([0.01, 0.0, 0.02], [0.1, 0.2, 0.0, 1.0]) }];
    }
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let (mut free, mut apart) = (0, 0);
        for _ in 0..1500 {
            let (mut a, mut b) = (random_case(&problem, &mut rng), random_case(&problem, &mut rng));
            (a.arm, b.arm) = (ArmId(0), ArmId(rng.random_range(1..4)));
            let rests = (StraightMotion::rest(&a.q), StraightMotion::rest(&b.q));
            let scene = random_scene(&problem, &mut rng);
            let found = world.config_free(a.arm, &a.q, a.held.as_ref(), &scene, a.exemption);
            assert_eq!(found, reference::is_free(&world, &a.parts(&rests.0), &scene), "{:?}", a.q);
            free += usize::from(found);
            let found = world.motions_apart(a.parts(&rests.0), b.parts(&rests.1), (0.0, 1.0));
            assert_eq!(found, reference::are_apart(&world, &a.parts(&rests.0), &b.parts(&rests.1)));
            apart += usize::from(found);
        }
        assert!(free > 150 && free < 1350 && apart > 150, "{free} {apart}");
    }
}

#[test]
fn batches_answer_like_single_questions() {
    let problem = problem("switch/4x4");
    let world = CollisionWorld::new(&problem);
    let mut rng = Seed(22).stream("batches");
    for _ in 0..100 {
        let arm = ArmId(rng.random_range(0..4));
        let scene = random_scene(&problem, &mut rng);
        let held = random_held(&problem, &mut rng);
        let exemption = random_exemption(&problem, &mut rng);
        let configs: Vec<Config> =
            (0..rng.random_range(0..20)).map(|_| random_config(&problem, arm, &mut rng)).collect();
        let slices: Vec<&[f64]> = configs.iter().map(|q| &q[..]).collect();
        let found = world.configs_free(arm, &slices, held.as_ref(), &scene, exemption);
        let single: Vec<bool> =
            configs.iter().map(|q| world.config_free(arm, q, held.as_ref(), &scene, exemption)).collect();
        assert_eq!(found, single);
    }
}

/// Nothing on a certified edge is in contact, and what stays a little clearer is certified.
#[test]
fn edges_are_certified_where_they_are_clear() {
    let problem = problem("switch/9x4");
    let mut strict = problem.clone();
    strict.options.clearance_m += 3e-4;
    let stricter = CollisionWorld::new(&strict);
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(23).stream("edges");
        let mut certified = 0;
        for _ in 0..600 {
            let case = random_case(&problem, &mut rng);
            let scene = random_scene(&problem, &mut rng);
            let motion = StraightMotion::new(&case.q, &case.to);
            let found =
                world.edge_free(case.arm, &case.q, &case.to, case.held.as_ref(), &scene, case.exemption);
            certified += usize::from(found);
            if found {
                for step in 0..=40 {
                    let q = motion.at(f64::from(step) / 40.0);
                    let rest = StraightMotion::rest(&q);
                    assert!(reference::is_free(&world, &case.parts(&rest), &scene), "{:?}", case.q);
                }
            } else {
                assert!(!reference::is_free(&stricter, &case.parts(&motion), &scene), "{:?}", case.q);
            }
        }
        assert!(certified > 60 && certified < 540, "{certified}");
    }
}

#[test]
fn arms_meet_nowhere_but_in_their_encounters() {
    let problem = problem("switch/9x4");
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(25).stream("sweeps");
        let (mut never, mut now_and_then, mut meet) = (0, 0, 0);
        for _ in 0..600 {
            let (mut a, mut b) = (random_case(&problem, &mut rng), random_case(&problem, &mut rng));
            a.arm = ArmId(4);
            b.arm = ArmId([1, 3, 5, 7, 0][rng.random_range(0..5)]);
            let moves = [StraightMotion::new(&a.q, &a.to), StraightMotion::new(&b.q, &b.to)];
            let [one, two] = [(&a, &moves[0]), (&b, &moves[1])]
                .map(|(case, motion)| world.sweep(case.arm, motion, case.held.as_ref(), (0.0, 1.0)));
            let spans = world.encounters(&one, &two);
            assert!(spans.windows(2).all(|pair| pair[0].1 < pair[1].0), "{spans:?}");
            for step in 0..=32 {
                let s = f64::from(step) / 32.0;
                let rests = [StraightMotion::rest(&moves[0].at(s)), StraightMotion::rest(&moves[1].at(s))];
                let (mut free_a, mut free_b) = (a.parts(&rests[0]), b.parts(&rests[1]));
                // Encounters are told whatever may touch.
                (free_a.3, free_b.3) = Default::default();
                let are_apart = reference::are_apart(&world, &free_a, &free_b);
                let inside = spans.iter().any(|(from, to)| (*from..=*to).contains(&s));
                assert!(inside || are_apart, "{s} {spans:?}");
                meet += usize::from(!are_apart);
            }
            never += usize::from(spans.is_empty());
            now_and_then += usize::from(!spans.is_empty() && spans != [(0.0, 1.0)]);
        }
        assert!(never > 60 && now_and_then > 15 && meet > 60, "{never} {now_and_then} {meet}");
    }
}

#[test]
fn arms_are_kept_apart_like_in_double_precision() {
    let problem = problem("switch/9x4");
    let mut strict = problem.clone();
    strict.options.clearance_m += 3e-4;
    let stricter = CollisionWorld::new(&strict);
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(24).stream("pairs");
        let mut apart = 0;
        for _ in 0..1500 {
            let (mut a, mut b) = (random_case(&problem, &mut rng), random_case(&problem, &mut rng));
            // Neighbours, mostly.
            a.arm = ArmId(4);
            b.arm = ArmId([1, 3, 5, 7, 0][rng.random_range(0..5)]);
            let rests = (StraightMotion::rest(&a.q), StraightMotion::rest(&b.q));
            let still = world.arms_apart(
                (a.arm, &a.q, a.held.as_ref(), a.exemption),
                (b.arm, &b.q, b.held.as_ref(), b.exemption),
            );
            assert_eq!(still, reference::are_apart(&world, &a.parts(&rests.0), &b.parts(&rests.1)));
            let moves = (StraightMotion::new(&a.q, &a.to), StraightMotion::new(&b.q, &b.to));
            let found = world.motions_apart(a.parts(&moves.0), b.parts(&moves.1), (0.0, 1.0));
            apart += usize::from(found);
            if found {
                for step in 0..=20 {
                    let s = f64::from(step) / 20.0;
                    let (qa, qb) =
                        (StraightMotion::rest(&moves.0.at(s)), StraightMotion::rest(&moves.1.at(s)));
                    assert!(reference::are_apart(&world, &a.parts(&qa), &b.parts(&qb)));
                }
            } else {
                assert!(!reference::are_apart(&stricter, &a.parts(&moves.0), &b.parts(&moves.1)));
            }
        }
        assert!(apart > 150 && apart < 1495, "{apart}");
    }
}

/// Looking at all arms at once gives the verdict of looking at every pair.
#[test]
fn an_ensemble_is_free_where_all_its_pairs_are() {
    let problem = problem("switch/9x4");
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(25).stream("ensembles");
        let mut free = 0;
        for _ in 0..400 {
            let cases: Vec<Case> =
                (0..9).map(|arm| Case { arm: ArmId(arm), ..random_case(&problem, &mut rng) }).collect();
            let motions: Vec<StraightMotion> =
                cases.iter().map(|case| StraightMotion::new(&case.q, &case.to)).collect();
            let takings: Vec<Taking<'_>> =
                cases.iter().zip(&motions).map(|(case, motion)| case.parts(motion)).collect();
            let found = world.conflict_among(&takings, (0.0, 1.0));
            let apart = |i: usize, j: usize| world.motions_apart(takings[i], takings[j], (0.0, 1.0));
            match found {
                Some((i, j)) => assert!(!apart(i, j)),
                None => assert!((0..9).all(|i| (i + 1..9).all(|j| apart(i, j)))),
            }
            free += usize::from(found.is_none());
        }
        assert!(free > 20 && free < 380, "{free}");
    }
}

/// A fork whose two fingers one joint turns towards each other.
const FORK: &str = r#"<robot name="fork"><link name="base"/><link name="palm"/>
    <link name="left"><collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
    <link name="right"><collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
    <joint name="a" type="revolute"><parent link="base"/><child link="palm"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
    <joint name="b" type="revolute"><parent link="palm"/><child link="left"/><origin xyz="-0.06 0 0"/><axis xyz="0 1 0"/>
        <limit lower="-1.2" upper="1.2" velocity="1" effort="1"/></joint>
    <joint name="c" type="revolute"><parent link="palm"/><child link="right"/><origin xyz="0.06 0 0"/><axis xyz="0 1 0"/>
        <mimic joint="b" multiplier="-1"/><limit lower="-1.2" upper="1.2" velocity="1" effort="1"/></joint></robot>"#;

/// Links that one joint drives both are not carried as one: lanes and the exact certification know.
#[test]
fn links_that_share_a_joint_move_against_each_other() {
    let mut problem = problem("in_place_swap/1x2");
    let mut workcell = problem.workcell.as_ref().clone();
    let arm = &mut workcell.arms[0];
    let (model, _) =
        ArmModel::from_urdf("fork", FORK, "left", &std::collections::BTreeMap::new(), &NoMeshes).unwrap();
    arm.limits = model.joints.iter().map(|joint| joint.limits).collect();
    arm.home = [0.0, -1.0].into_iter().collect();
    arm.tool.shapes.clear();
    let group = |name: &str| model.links.iter().find(|link| link.name == name).unwrap().group;
    let neighbours = [("base", "palm"), ("palm", "left"), ("palm", "right")];
    arm.exempt_groups = neighbours.map(|(a, b)| (group(a), group(b))).to_vec();
    arm.exempt_groups.sort_unstable();
    arm.exempt_bodies.clear();
    arm.hand_groups = vec![group("left")];
    arm.model = std::sync::Arc::new(model);
    problem.workcell = std::sync::Arc::new(workcell);
    let (scene, none) = (Scene::default(), Exemption::default());
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let exact =
            |motion: &dyn JointMotion| reference::is_free(&world, &(ArmId(0), motion, None, none), &scene);
        // The fingers cross at the end, and are far apart in the middle.
        let closing = ([0.0, -1.0], [0.0, 0.3]);
        assert!(!world.edge_free(ArmId(0), &closing.0, &closing.1, None, &scene, none));
        assert!(!exact(&StraightMotion::new(&closing.0, &closing.1)));
        let mut rng = Seed(26).stream("forks");
        let mut certified = [0; 2];
        for _ in 0..300 {
            let mut q = || [rng.random_range(-2.0..2.0), rng.random_range(-1.2..1.0)];
            let (from, to) = (q(), q());
            let motion = StraightMotion::new(&from, &to);
            let verdicts = [world.edge_free(ArmId(0), &from, &to, None, &scene, none), exact(&motion)];
            let clear = (0..=40).all(|step| exact(&StraightMotion::rest(&motion.at(f64::from(step) / 40.0))));
            for (verdict, count) in verdicts.into_iter().zip(&mut certified) {
                assert!(clear || !verdict, "{from:?} {to:?}");
                *count += usize::from(verdict);
            }
        }
        assert!(certified.iter().all(|count| (30..270).contains(count)), "{certified:?}");
    }
}

#[test]
fn inverse_kinematics_in_batches_gives_what_is_within_limits_and_free() {
    for name in ["switch/4x4", "switch_panda_type/2x2", "switch_ur_type/2x2"] {
        let problem = problem(name);
        let world = CollisionWorld::new(&problem);
        let mut rng = Seed(11).stream("inverse");
        let (mut kept, mut struck) = (0, 0);
        for _ in 0..40 {
            let arm = ArmId(rng.random_range(0..problem.workcell.arms.len()));
            let (held, exemption) = (random_held(&problem, &mut rng), random_exemption(&problem, &mut rng));
            let (it, scene) = (&problem.workcell.arms[arm.0], random_scene(&problem, &mut rng));
            let targets: Vec<_> =
                (0..7).map(|_| it.tcp_pose(&random_config(&problem, arm, &mut rng))).collect();
            // One after the other, from the same stream.
            let mut stream = rng.clone();
            let found = world.inverse_free(arm, (&targets, 4), held.as_ref(), &scene, exemption, &mut rng);
            assert_eq!(found.len(), targets.len());
            for (target, found) in targets.iter().zip(found) {
                let mut all = Vec::new();
                let mount = it.base.inverse() * target * it.tool.tcp.inverse();
                it.inverse(&mount, 4, &mut stream, &mut all);
                for q in &found {
                    let reached = it.tcp_pose(q);
                    assert!((reached.translation.vector - target.translation.vector).norm() < 1e-9);
                    assert!(reached.rotation.angle_to(&target.rotation) < 1e-7);
                    assert!(
                        it.limits.iter().zip(q).all(|(limit, q)| (limit.lower..=limit.upper).contains(q))
                    );
                }
                let count = all.len();
                all.retain(|q| world.config_free(arm, q, held.as_ref(), &scene, exemption));
                assert_eq!(found, all, "{name}");
                (kept, struck) = (kept + all.len(), struck + count - all.len());
            }
        }
        assert!(kept > 100 && struck > 100, "{name}: {kept} {struck}");
    }
}
