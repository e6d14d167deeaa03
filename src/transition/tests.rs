//! Contacts against what they promise.

use rand::Rng as _;

use super::{ContactKind, ContactQuery, Contacts};
use crate::collision::{CollisionWorld, Exemption, Held, Scene};
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
