//! Contacts against what they promise.

use rand::Rng as _;

use super::grains::Grains;
use super::{ContactKind, ContactQuery, Contacts, HandoffQuery, ReachMemory};
use crate::collision::{
    CollisionWorld, Exemption, Held, JointMotion as _, PathMotion, Scene, StraightMotion,
};
use crate::geometry::Pose;
use crate::problem::{InitialPlacement, Problem};
use crate::run::Seed;
use crate::scenario::{Family, generate};
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::{ArmId, ObjectId};

fn problem(seed: u64) -> Problem {
    let document = generate(Family::Random, 4, 4, seed).unwrap();
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem
}

/// All questions about picks and places of all objects where they start.
fn queries(problem: &Problem) -> Vec<ContactQuery> {
    let mut queries = Vec::new();
    for (index, initial) in problem.initial.iter().enumerate() {
        let InitialPlacement::Resting { pose, surface } = initial else { continue };
        for arm in (0..problem.workcell.arms.len()).map(ArmId) {
            for kind in [ContactKind::Pick, ContactKind::Place] {
                let (object, pose, surface) = (ObjectId(index), *pose, *surface);
                queries.push(ContactQuery { kind, arm, object, pose, surface });
            }
        }
    }
    queries
}

#[test]
fn the_hand_alone_rules_out_only_what_has_no_configuration() {
    let problem = problem(3);
    let world = CollisionWorld::new(&problem);
    let mut contacts = Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let mut rng = Seed(1).stream("ik");
    let (mut ruled_out, mut kept) = (0, 0);
    for query in queries(&problem) {
        let possible = contacts.possible_holds(&query);
        let arm = &problem.workcell.arms[query.arm.0];
        let carrier = problem.workcell.surfaces[query.surface.0].carrier;
        let touching = Exemption { hand_with: Some(query.object), held_with: carrier };
        for (number, grasp) in problem.objects[query.object.0].grasps.iter().enumerate() {
            if possible.iter().any(|(known, _)| *known == number) {
                kept += 1;
                continue;
            }
            let held = Held { object: query.object, object_in_tcp: grasp.object_in_tcp };
            let tcp = query.pose * grasp.object_in_tcp.inverse();
            let mount = arm.base.inverse() * tcp * arm.tool.tcp.inverse();
            let mut solutions = Vec::new();
            arm.model.inverse(&arm.limits, &mount, 4, &mut rng, &mut solutions);
            for q in &solutions {
                assert!(!world.config_free(query.arm, q, Some(&held), &Scene::default(), touching));
                ruled_out += 1;
            }
        }
    }
    assert!(ruled_out > 100 && kept > 100, "{ruled_out} {kept}");
}

#[test]
fn contacts_do_not_depend_on_the_order_of_questions() {
    let problem = problem(4);
    let world = CollisionWorld::new(&problem);
    let fresh = || Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let (mut lazy, mut eager) = (fresh(), fresh());
    let all = queries(&problem);
    let mut found = 0;
    // One asks for everything at once, the other backwards, piece by piece.
    let at_once: Vec<Vec<_>> = all
        .iter()
        .map(|query| {
            let holds = eager.possible_holds(query);
            holds.iter().map(|(_, hold)| eager.at(query, hold)).collect()
        })
        .collect();
    for (query, expected) in all.iter().zip(&at_once).rev() {
        let holds = lazy.possible_holds(query);
        assert_eq!(holds.len(), expected.len());
        for ((_, hold), expected) in holds.iter().zip(expected) {
            assert_eq!(lazy.has(query, hold), !expected.is_empty());
            for (index, contact) in expected.iter().enumerate() {
                found += 1;
                assert_eq!(lazy.nth(query, hold, index).map(|c| c.q), Some(contact.q.clone()));
                assert_eq!(contact.approach.waypoints[0], contact.q);
                assert_eq!(contact.retreat.waypoints[0], contact.q);
            }
            assert!(lazy.nth(query, hold, expected.len()).is_none());
        }
        assert_eq!(lazy.any(query), expected.iter().any(|contacts| !contacts.is_empty()));
    }
    assert!(found > 50, "{found}");
}

/// What is open depends on what was confirmed or refused before, and on no other question.
#[test]
fn holds_are_open_until_they_are_refused() {
    let problem = problem(4);
    let world = CollisionWorld::new(&problem);
    let fresh = || Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let (mut contacts, mut asked_before) = (fresh(), fresh());
    let resting = problem.initial.iter().enumerate().filter_map(|(index, initial)| match initial {
        InitialPlacement::Resting { pose, .. } => Some((ObjectId(index), *pose)),
        InitialPlacement::Held { .. } => None,
    });
    let scene = Scene { resting: resting.collect() };
    let (mut refused, mut confirmed) = (0, 0);
    for query in queries(&problem) {
        let possible = contacts.possible_holds(&query);
        asked_before.any(&query);
        assert_eq!(contacts.open_holds(&query, &scene), possible);
        assert_eq!(asked_before.open_holds(&query, &scene), possible);
        let mut clear = possible.clone();
        clear.retain(|(_, hold)| contacts.confirm(&query, hold, &scene));
        assert!(clear.iter().all(|(_, hold)| asked_before.is_clear_of(&query, hold, &scene)));
        assert_eq!(contacts.open_holds(&query, &scene), clear);
        refused += possible.len() - clear.len();
        confirmed += clear.len();
        // More contacts may be clear where those before were not.
        if let Some((_, hold)) = clear.first()
            && contacts.more(&query, hold)
        {
            assert_eq!(contacts.open_holds(&query, &scene), possible);
        }
    }
    assert!(refused > 20 && confirmed > 20, "{refused} {confirmed}");
}

#[test]
fn contacts_that_are_sampled_later_are_looked_at_too() {
    let mut problem = problem(4);
    problem.options.ik_solutions = 1;
    let world = CollisionWorld::new(&problem);
    let mut contacts = Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let (mut late, mut poses) = (0, Vec::new());
    for query in queries(&problem) {
        let arm = &problem.workcell.arms[query.arm.0];
        let other = ObjectId((query.object.0 + 1) % problem.objects.len());
        for (_, hold) in contacts.possible_holds(&query) {
            let Some(first) = contacts.nth(&query, &hold, 0) else { continue };
            // Another object where the forearm is, which the arm may pass with its elbow elsewhere.
            arm.model.link_poses(&first.q, &mut poses);
            let Some(link) = arm.model.link_index("link_5") else { continue };
            let scene = Scene { resting: vec![(other, arm.base * poses[link])] };
            if contacts.is_clear_of(&query, &hold, &scene) {
                continue;
            }
            for _ in 0..4 {
                contacts.more(&query, &hold);
            }
            let known = contacts.at(&query, &hold);
            let some_clear = known.iter().any(|contact| contacts.is_clear(&query, contact, &scene));
            assert_eq!(contacts.confirm(&query, &hold, &scene), some_clear);
            late += usize::from(some_clear);
        }
    }
    assert!(late > 3, "{late}");
}

/// The lines of a place come in along the normal and go out along the tool; of a pick it is the
/// other way round.
#[test]
fn a_place_is_a_pick_backwards() {
    let mut problem = problem(5);
    let straight = |problem: &Problem| {
        let world = CollisionWorld::new(problem);
        let mut contacts = Contacts::new(problem, &world, Seed(1).stream("contacts"));
        let mut seen = 0;
        for query in queries(problem) {
            let arm = &problem.workcell.arms[query.arm.0];
            let normal = problem.workcell.surfaces[query.surface.0].normal();
            for (_, hold) in contacts.holds(&query) {
                let Some(contact) = contacts.nth(&query, &hold, 0) else { continue };
                let (with, without) = match query.kind {
                    ContactKind::Pick => (&contact.retreat, &contact.approach),
                    ContactKind::Place => (&contact.approach, &contact.retreat),
                };
                let start = arm.tcp_pose(&contact.q);
                let end = |line: &super::Line| {
                    let last = line.waypoints.last().unwrap();
                    (arm.tcp_pose(last).translation.vector - start.translation.vector).normalize()
                };
                assert!((end(with) - normal).norm() < 1e-3);
                let backwards = -(start.rotation * crate::geometry::Vec3::z());
                assert!((end(without) - backwards).norm() < 1e-3);
                seen += 1;
            }
        }
        assert!(seen > 20, "{seen}");
    };
    straight(&problem);
    // With lines of different lengths neither mirrors the other.
    problem.objects.iter_mut().for_each(|object| object.retreat = 0.05);
    straight(&problem);
}

/// What is remembered of contacts among other objects is what fresh eyes see, in whatever order it was asked.
#[test]
fn clear_contacts_are_remembered_as_they_are() {
    let problem = problem(6);
    let world = CollisionWorld::new(&problem);
    let fresh = || Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let mut remembering = fresh();
    let mut rng = Seed(1).stream("scenes");
    let (mut clear, mut blocked) = (0, 0);
    for _ in 0..3 {
        for query in queries(&problem) {
            for (_, hold) in remembering.holds(&query) {
                let Some(contact) = remembering.nth(&query, &hold, 0) else { continue };
                let beside = |rng: &mut crate::run::Rng| {
                    let turn = crate::geometry::Vec3::z() * rng.random_range(-3.0..3.0);
                    let mut pose = query.pose;
                    pose.translation.vector.x += rng.random_range(-0.2..0.2);
                    pose.translation.vector.y += rng.random_range(-0.2..0.2);
                    pose.rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
                    pose
                };
                let others = (0..problem.objects.len()).map(ObjectId).filter(|other| *other != query.object);
                let resting: Vec<_> = others.take(2).map(|other| (other, beside(&mut rng))).collect();
                let one = Scene { resting: resting[..1].to_vec() };
                for scene in [one, Scene { resting }, Scene::default()] {
                    let seen = fresh().is_clear(&query, &contact, &scene);
                    for _ in 0..2 {
                        assert_eq!(remembering.is_clear(&query, &contact, &scene), seen);
                    }
                    *(if seen { &mut clear } else { &mut blocked }) += 1;
                }
            }
        }
    }
    assert!(clear > 100 && blocked > 50, "{clear} {blocked}");
}

/// A few grasps of object 0.
fn handoff_holds(problem: &Problem) -> Vec<(usize, Pose)> {
    let grasps = problem.objects[0].grasps.iter().enumerate().step_by(5);
    grasps.map(|(number, grasp)| (number, grasp.object_in_tcp)).collect()
}

fn handoff_query<'a>(
    arms: (usize, usize),
    giving: &'a [(usize, Pose)],
    taking: &'a [(usize, Pose)],
) -> HandoffQuery<'a> {
    HandoffQuery {
        giver: ArmId(arms.0),
        receiver: ArmId(arms.1),
        object: ObjectId(0),
        giver_holds: giving,
        receiver_holds: taking,
        giver_near: &[],
        receiver_near: &[],
    }
}

const NEIGHBOURS: [(usize, usize); 4] = [(0, 1), (1, 0), (2, 3), (0, 2)];

#[test]
fn in_a_handoff_both_hands_hold_one_object_and_nothing_touches() {
    let problem = problem(7);
    let world = CollisionWorld::new(&problem);
    let mut contacts = Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let holds = handoff_holds(&problem);
    let mut rng = Seed(3).stream("handoffs");
    let mut seen = 0;
    for arms in NEIGHBOURS {
        for found in contacts.handoffs(&handoff_query(arms, &holds, &holds), 2000, 8, &mut rng) {
            let [giver, receiver] = [arms.0, arms.1].map(|arm| &problem.workcell.arms[arm]);
            let by_giver = giver.tcp_pose(&found.giver_q) * found.giver_hold;
            let by_receiver = receiver.tcp_pose(&found.receiver_q) * found.receiver_hold;
            assert!((by_giver.translation.vector - by_receiver.translation.vector).norm() < 1e-8);
            assert!(by_giver.rotation.angle_to(&by_receiver.rotation) < 1e-8);
            assert!(holds.iter().any(|(_, hold)| *hold == found.giver_hold));
            assert!(holds.iter().any(|(_, hold)| *hold == found.receiver_hold));
            // With these very holds, of which the remembered one may differ by a turn of the cube.
            let held = |hold: Pose| Held { object: ObjectId(0), object_in_tcp: hold };
            let (giving, taking) = (held(found.giver_hold), held(found.receiver_hold));
            let (none, empty) = (Exemption::default(), Scene::default());
            let touching = Exemption { hand_with: Some(ObjectId(0)), held_with: None };
            let (a, b) = (ArmId(arms.0), ArmId(arms.1));
            assert!(world.config_free(a, &found.giver_q, Some(&giving), &empty, none));
            assert!(world.config_free(b, &found.receiver_q, Some(&taking), &empty, none));
            assert!(world.arms_apart(
                (a, &found.giver_q, Some(&giving), none),
                (b, &found.receiver_q, None, touching)
            ));
            assert!(world.arms_apart(
                (a, &found.giver_q, None, touching),
                (b, &found.receiver_q, Some(&taking), none)
            ));
            let (approach, retreat) = (
                PathMotion::new(&found.receiver_approach.waypoints),
                PathMotion::new(&found.giver_retreat.waypoints),
            );
            let (p, q) = (StraightMotion::rest(&found.giver_q), StraightMotion::rest(&found.receiver_q));
            assert!(world.motions_apart(
                (a, &p, Some(&giving), none),
                (b, &approach, None, touching),
                approach.span()
            ));
            assert!(world.motions_apart(
                (a, &retreat, None, touching),
                (b, &q, Some(&taking), none),
                retreat.span()
            ));
            assert_eq!(found.giver_retreat.waypoints[0], found.giver_q);
            assert_eq!(found.receiver_approach.waypoints[0], found.receiver_q);
            seen += 1;
        }
    }
    assert!(seen >= 20, "{seen}");
}

/// Whatever was asked of the memory before, by whomever, and in whatever order.
#[test]
fn handoffs_do_not_depend_on_what_is_remembered() {
    let (one, other) = (problem(8), problem(9));
    let (world, other_world) = (CollisionWorld::new(&one), CollisionWorld::new(&other));
    let holds = handoff_holds(&one);
    let ask = |contacts: &mut Contacts<'_>, seed: u64| -> Vec<String> {
        let mut rng = Seed(seed).stream("handoffs");
        let mut found = Vec::new();
        for arms in NEIGHBOURS {
            for (from, to) in [(0, 4), (3, 9), (0, 4)] {
                let query = handoff_query(arms, &holds[from..to], &holds);
                found.extend(contacts.handoffs(&query, 400, 2, &mut rng));
                found.extend(contacts.first_handoffs(&query, 100, 1, &mut Seed(5).stream("first")));
            }
        }
        found.into_iter().map(|contact| format!("{contact:?}")).collect()
    };
    let rng = || Seed(1).stream("contacts");
    let fresh = ask(&mut Contacts::new(&one, &world, rng()), 1);
    assert!(fresh.len() > 20, "{}", fresh.len());
    let memory = std::sync::Arc::new(ReachMemory::new());
    // An equal workcell with other arrangements, asked by other dice, and by two at once.
    ask(&mut Contacts::remembering(&other, &other_world, rng(), memory.clone()), 2);
    let known = memory.draws().bytes();
    assert!(known > 0);
    for _ in 0..2 {
        std::thread::scope(|scope| {
            for seed in [1, 6, 1] {
                let (memory, fresh) = (memory.clone(), &fresh);
                let (one, world) = (&one, &world);
                scope.spawn(move || {
                    let found = ask(&mut Contacts::remembering(one, world, rng(), memory), seed);
                    assert_eq!(found == *fresh, seed == 1);
                });
            }
        });
    }
    // What was asked for is remembered, and what was remembered is not worked out again.
    let learnt = memory.draws().bytes();
    assert!(learnt > known);
    assert_eq!(ask(&mut Contacts::remembering(&one, &world, rng(), memory.clone()), 1), fresh);
    assert_eq!(memory.draws().bytes(), learnt);
    // All is forgotten when it is too much, and comes back as it was.
    memory.draws().forget();
    assert_eq!(ask(&mut Contacts::remembering(&one, &world, rng(), memory), 1), fresh);
}

#[test]
fn no_handoff_of_two_holds_comes_twice() {
    let problem = problem(7);
    let world = CollisionWorld::new(&problem);
    let mut contacts = Contacts::new(&problem, &world, Seed(1).stream("contacts"));
    let mut rng = Seed(3).stream("handoffs");
    let holds = handoff_holds(&problem);
    let mut found: Vec<Vec<f64>> = Vec::new();
    // More than are remembered of one pair of holds.
    for _ in 0..30 {
        let query = handoff_query((0, 1), &holds[..1], &holds[3..5]);
        let fresh = contacts.handoffs(&query, 40, 40, &mut rng);
        found.extend(fresh.into_iter().map(|contact| contact.giver_q.to_vec()));
    }
    let count = found.len();
    found.sort_by(|a, b| a.partial_cmp(b).unwrap());
    found.dedup();
    assert_eq!(found.len(), count);
    assert!(count > 10, "{count}");
}

#[test]
fn equal_poses_have_equal_grains() {
    let mut rng = Seed(2).stream("poses");
    let mut random = || {
        let mut within = |half: f64| rng.random_range(-half..half);
        let turn = crate::geometry::Vec3::new(within(1.8), within(1.8), within(1.8));
        Pose::new(crate::geometry::Vec3::new(within(2.0), within(2.0), within(2.0)), turn)
    };
    let mut equal = 0;
    for _ in 0..1000 {
        let (a, b) = (random(), random());
        let pose = Grains::of(&a).pose();
        assert!((pose.translation.vector - a.translation.vector).norm() < 1e-10);
        assert!(pose.rotation.angle_to(&a.rotation) < 1e-7);
        // The same pose by another way, and with the quaternion's other sign.
        let again = (a * b) * b.inverse();
        let negative = Pose::from_parts(a.translation, nalgebra::UnitQuaternion::new_unchecked(-*a.rotation));
        assert_eq!(Grains::of(&negative), Grains::of(&a));
        equal += usize::from(Grains::of(&again) == Grains::of(&a));
        assert_ne!(Grains::of(&b), Grains::of(&a));
    }
    assert!(equal > 950, "{equal}");
}
