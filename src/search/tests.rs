//! The tree alone: random actions instead of the guided ones, and no means of motion but the
//! composite search. Guidance is to make the search fast, not to make it work.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use super::ground::GroundingFailure;
use super::step::Setback;
use super::tree::Whereabouts;
use super::*;
use crate::collision::{CollisionWorld, Exemption, Held};
use crate::guidance::{
    Cuts, Effort, Guide, Instance, ModeState, Move, Network, Solution, Violation, check, solve,
};
use crate::mode_graph::{CarryEnd, RestAction};
use crate::mode_graph::{ModeGraphOptions, build_mode_graph};
use crate::motion::{ArmGoal, Roadmap, StepFailure};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::run::{Control, Rng, Seed};
use crate::scenario::{Family, generate};
use crate::transition::{Contact, ContactKind, ContactQuery, Contacts, HandoffQuery, SampledReach};
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::{ArmId, ObjectId};

fn problem(family: Family, seed: u64) -> Problem {
    let document = generate(family, 4, 4, seed).unwrap();
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem
}

/// Random actions on random objects from `start`: a step that nobody planned.
fn random_step(instance: &Instance, map: &Map, start: &ModeState, rng: &mut Rng) -> Guide {
    let start = start.clone();
    let mut moves: Vec<Move> = Vec::new();
    for (object, &from) in start.iter().enumerate() {
        let class = instance.objects[object].class;
        let edges = instance.edges.iter().filter(|e| e.from == from && e.class.is_none_or(|c| c == class));
        let free: Vec<Move> = edges
            .map(|edge| Move { object, from, to: edge.to })
            .filter(|action| moves.iter().all(|other| other.to != action.to))
            .collect();
        if rng.random_bool(0.7) {
            moves.extend(free.choose(rng));
        }
    }
    let solution = Solution { start, steps: vec![moves], weight: 0.0 };
    Guide::along(map.network(), solution, None)
}

/// Lets `act` look at a search that has not begun, with its map and a stream of random numbers.
fn with_search(problem: &Problem, act: impl FnOnce(&mut Search<'_>, &Map, &mut Rng)) {
    let (seed, control) = (Seed(5), Control::unbounded());
    let world = CollisionWorld::new(problem);
    let mut reach = SampledReach::new(problem, &world, seed);
    let graph = build_mode_graph(problem, &mut reach, &ModeGraphOptions::planning(), &control);
    let contacts = reach.into_contacts();
    let map = Map::new(graph).unwrap();
    let mut rng = seed.stream("test");
    let roadmaps = problem.workcell.arms.iter().enumerate().map(|(index, arm)| {
        let mut roadmap = Roadmap::new(ArmId(index), arm);
        roadmap.grow(&world, arm, 300, &control, &mut rng);
        roadmap
    });
    let roadmaps: Vec<Roadmap> = roadmaps.collect();
    let settings = Settings::default();
    let mut search = Search::new(problem, &world, &map, contacts, roadmaps, settings, seed, &control);
    act(&mut search, &map, &mut rng);
}

/// A move of object 0 for every handoff edge of its class.
fn handoffs(instance: &Instance) -> Vec<Move> {
    let class = instance.objects[0].class;
    let edges = instance.edges.iter().filter(|e| e.class.is_none_or(|c| c == class));
    edges
        .filter(|edge| instance.is_arm(edge.from) && instance.is_arm(edge.to))
        .map(|edge| Move { object: 0, from: edge.from, to: edge.to })
        .collect()
}

#[test]
fn handoffs_that_never_fit_into_one_step_become_a_rule() {
    let control = Control::unbounded();
    with_search(&problem(Family::SideToSide, 1), |search, map, _| {
        let all = handoffs(map.network().instance());
        let arms = |action: &Move| [map.arm(action.from).unwrap(), map.arm(action.to).unwrap()];
        let one = all[0];
        let two = *all.iter().find(|two| arms(two).iter().all(|arm| !arms(&one).contains(arm))).unwrap();
        let rules = |search: &Search<'_>| search.network.instance().clashes.len();
        let proved = search.certificate().copied();
        for _ in 0..2 {
            search.suspect(&one, &two, &control);
            assert_eq!(rules(search), 0);
        }
        search.suspect(&two, &one, &control);
        assert_eq!(rules(search), 1);
        search.suspect(&one, &two, &control);
        assert_eq!(rules(search), 1);
        let clash = search.network.instance().clashes[0].clone();
        for action in [one, two] {
            assert!(clash.actions.iter().any(|one| one.means(action.object, action.from, action.to)));
        }
        search.guide(0, &control);
        let guide = search.tree[0].guide.clone().unwrap();
        check(search.network.instance(), &guide.solution).unwrap();
        assert_eq!(search.certificate().copied(), proved);
        bounds_are_kept_apart(search, map);
    });
}

/// What is proved is about the map's network, what is sought about the one with the rules learnt.
fn bounds_are_kept_apart(search: &mut Search<'_>, map: &Map) {
    let control = Control::unbounded();
    search.examine(&control);
    let optimum = |network: &Network| {
        let start = network.instance().start();
        let answer = solve(network, &start, &Cuts::none(), &Effort::thorough(), Seed(77), &control).unwrap();
        answer.certificate().unwrap().optimum.unwrap()
    };
    assert_eq!(search.certificate().unwrap().optimum, Some(optimum(map.network())));
    assert!(!search.network.instance().clashes.is_empty());
    assert_eq!(search.least_steps, optimum(&search.network.clone()));
    assert_eq!(search.tree[0].remaining(), Some(search.least_steps));
}

/// Two picks of the guide's first step from where the objects stood at the start, and the arms that do them.
fn two_picks(search: &Search<'_>, map: &Map, guide: &Guide) -> Option<[(Move, ArmId); 2]> {
    let instance = search.network.instance();
    let picks: Vec<(Move, ArmId)> =
        guide.immediate.iter().filter_map(|action| Some((*action, map.arm(action.to)?))).collect();
    let from_start = picks.iter().all(|(action, _)| action.from == instance.start()[action.object]);
    let [one, two, ..] = picks[..] else { return None };
    from_start.then_some([one, two])
}

#[test]
fn contacts_that_never_fit_into_one_step_become_a_rule_for_their_objects() {
    let control = Control::unbounded();
    let mut learnt = 0;
    for seed in 0..4 {
        with_search(&problem(Family::Switch, seed), |search, map, _| {
            let guide = search.tree[0].guide.clone().unwrap();
            let Some([(one, first), (two, second)]) = two_picks(search, map, &guide) else { return };
            let proved = search.certificate().copied();
            let rules = |search: &Search<'_>| search.network.instance().clashes.len();
            // What did not fail by the same two arms each time is no sign of it.
            for _ in 0..20 {
                search.note_crowds(0, &guide, &[Some((first, second)), None], &control);
                search.note_crowds(0, &guide, &[], &control);
            }
            for _ in 0..7 {
                search.note_crowds(0, &guide, &[Some((first, second)); 2], &control);
            }
            assert_eq!(rules(search), 0);
            search.note_crowds(0, &guide, &[Some((second, first)); 2], &control);
            assert_eq!(rules(search), 1);
            let clash = search.network.instance().clashes[0].clone();
            for action in [one, two] {
                assert!(clash.actions.iter().any(|it| it.means(action.object, action.from, action.to)));
            }
            assert!(
                clash.actions.iter().all(|it| it.object == Some(one.object) || it.object == Some(two.object))
            );
            search.guide(0, &control);
            let next = search.tree[0].guide.clone().unwrap();
            check(search.network.instance(), &next.solution).unwrap();
            assert!(!(next.immediate.contains(&one) && next.immediate.contains(&two)));
            assert_eq!(search.certificate().copied(), proved);
            bounds_are_kept_apart(search, map);
            learnt += 1;
        });
    }
    assert!(learnt > 0);
}

/// The contacts of `end` in all holds in which its object can be carried, sampled for themselves.
fn contacts_of_carry(
    problem: &Problem,
    world: &CollisionWorld,
    end: &CarryEnd,
    rng: &mut Rng,
) -> (ArmId, Vec<Contact>) {
    let mut contacts = Contacts::new(problem, world, Seed(99).stream("fresh"));
    let object = end.object;
    let (InitialPlacement::Resting { pose, surface }, GoalPlacement::Pose { pose: goal, surface: on }) =
        (&problem.initial[object.0], &problem.goal[object.0])
    else {
        panic!("from a pose to a pose");
    };
    let (giver, receiver) = (end.carriers[0], *end.carriers.last().unwrap());
    let ask =
        |kind, arm, pose: &_, surface: &_| ContactQuery { kind, arm, object, pose: *pose, surface: *surface };
    let pick = ask(ContactKind::Pick, giver, pose, surface);
    let place = ask(ContactKind::Place, receiver, goal, on);
    let (taking, putting) = (contacts.holds(&pick), contacts.holds(&place));
    let (arm, asked, own) = match end.action {
        RestAction::Pick => (giver, pick, &taking),
        RestAction::Place => (receiver, place, &putting),
    };
    let mut found = Vec::new();
    for hold in own {
        let alone = std::slice::from_ref(hold);
        let (giver_holds, receiver_holds) = match end.action {
            RestAction::Pick => (alone, &putting[..]),
            RestAction::Place => (&taking[..], alone),
        };
        let (object, near) = (end.object, &[][..]);
        let handoff = HandoffQuery {
            giver,
            receiver,
            object,
            giver_holds,
            receiver_holds,
            giver_near: near,
            receiver_near: near,
        };
        if giver == receiver || !contacts.handoffs(&handoff, 200, 1, rng).is_empty() {
            for _ in 0..4 {
                contacts.more(&asked, &hold.1);
            }
            found.extend(contacts.at(&asked, &hold.1).iter().cloned());
        }
    }
    (arm, found)
}

#[test]
fn ends_of_carries_leave_room_or_are_not_to_be_in_one_step() {
    let control = Control::unbounded();
    let mut crowded = 0;
    for seed in 0..3 {
        let problem = problem(Family::Switch, seed);
        with_search(&problem, |search, map, rng| {
            assert!(map.graph().crowdings.is_empty());
            let Some([one, two]) = search.crowding(&control) else { return };
            crowded += 1;
            let world = CollisionWorld::new(&problem);
            let (first, of_one) = contacts_of_carry(&problem, &world, &one, rng);
            let (second, of_two) = contacts_of_carry(&problem, &world, &two, rng);
            assert!(of_one.len() >= 10 && of_two.len() >= 10, "{} and {}", of_one.len(), of_two.len());
            let held = |object: ObjectId, contact: &Contact, holds: bool| {
                holds.then_some(Held { object, object_in_tcp: contact.object_in_tcp })
            };
            let none = Exemption::default();
            for (a, b) in of_one.iter().flat_map(|a| of_two.iter().map(move |b| (a, b))) {
                let apart = [RestAction::Place, RestAction::Pick].into_iter().all(|holder| {
                    let in_one = held(one.object, a, one.action == holder);
                    let in_two = held(two.object, b, two.action == holder);
                    world.arms_apart(
                        (first, &a.q, in_one.as_ref(), none),
                        (second, &b.q, in_two.as_ref(), none),
                    )
                });
                assert!(!apart, "{one:?} and {two:?} leave room");
            }
            // The search that follows does not have them in one step; all else it may do as before.
            let fewest = |map: &Map| {
                let (network, effort) = (map.network(), Effort::thorough());
                let start = network.instance().start();
                let answer = solve(network, &start, &Cuts::none(), &effort, Seed(3), &control).unwrap();
                check(network.instance(), answer.solution().unwrap()).unwrap();
                answer.certificate().unwrap().optimum.unwrap()
            };
            let mut graph = map.graph().clone();
            graph.crowdings.push([one, two]);
            let refined = Map::new(graph).unwrap();
            assert_eq!(refined.network().instance().clashes.len(), 1);
            assert!((fewest(map)..=fewest(map) + 1).contains(&fewest(&refined)));
        });
    }
    assert!(crowded > 0);
}

#[test]
fn pruning_keeps_a_way_whose_vertices_came_in_another_order() {
    with_search(&problem(Family::Random, 1), |search, _, _| {
        // 0 -> 3 -> 1 -> 4: rewiring gives vertices parents that came later. 2 and 5 lie beside.
        for (depth, parent) in [(2, 3), (1, 0), (1, 0), (3, 1), (2, 3)] {
            let mut vertex = search.tree[0].clone();
            (vertex.depth, vertex.parent, vertex.failures) = (depth, Some(parent), 2);
            search.tree.push(vertex);
        }
        search.best_way = vec![0, 3, 1, 4];
        search.prune();
        assert_eq!(search.best_way, [0, 1, 2, 3]);
        let parents: Vec<Option<usize>> = search.tree.iter().map(|vertex| vertex.parent).collect();
        assert_eq!(parents, [None, Some(0), Some(1), Some(2)]);
        let depths: Vec<usize> = search.tree.iter().map(|vertex| vertex.depth).collect();
        assert_eq!(depths, [0, 1, 2, 3]);
    });
}

#[test]
fn other_sequences_of_actions_are_tried() {
    let control = Control::unbounded();
    with_search(&problem(Family::Random, 1), |search, _, _| {
        let guide = search.tree[0].guide.clone().unwrap();
        let network = search.network.clone();
        let mut firsts: Vec<Move> = Vec::new();
        for _ in 0..60 {
            let Some(other) = search.another_first_action(0, &guide, &control) else { continue };
            let [first] = other.immediate[..] else { panic!("{:?}", other.immediate) };
            assert!(!guide.immediate.contains(&first));
            check(network.instance(), &other.solution).unwrap();
            assert!(other.remaining_steps >= guide.remaining_steps);
            firsts.push(first);
        }
        firsts.sort_unstable();
        firsts.dedup();
        assert!(firsts.len() > 1, "{firsts:?}");
    });
}

#[test]
fn a_step_is_done_in_part_where_two_of_its_actions_do_not_go_together() {
    let control = Control::unbounded();
    let mut done = 0;
    for seed in 0..4 {
        with_search(&problem(Family::Switch, seed), |search, map, _| {
            let guide = search.tree[0].guide.clone().unwrap();
            let Some([(_, first), (_, second)]) = two_picks(search, map, &guide) else { return };
            let outline = search.grounder.outline(&search.tree[0], &guide);
            let setback = Setback::Motion(vec![StepFailure::Conflict(first, second)], Vec::new());
            let Some((part, (grounding, _))) = search.step_in_part(0, &guide, &outline, &setback, &control)
            else {
                return;
            };
            assert!(part.immediate.len() < guide.immediate.len());
            assert!(part.immediate.iter().all(|action| guide.immediate.contains(action)));
            assert_eq!(grounding.actions.len(), part.immediate.len());
            let mut after = search.tree[0].mode.clone();
            part.immediate.iter().for_each(|action| after[action.object] = action.to);
            let rest = search.rest_after(&guide, &part, &after).unwrap();
            assert!(rest.steps.len() <= guide.solution.steps.len());
            check(search.network.instance(), &rest).unwrap();
            done += 1;
        });
    }
    assert!(done > 0);
}

#[test]
fn meetings_of_one_step_are_apart_or_said_to_clash() {
    // The handoffs along both diagonals of a square of arms, by the graph's own witnesses of grasps.
    let (mut apart, mut clashes) = (0, 0);
    for seed in 0..4 {
        with_search(&problem(Family::SideToSide, seed), |search, _, _| {
            let guide = search.tree[0].guide.clone().unwrap();
            let outline = search.grounder.outline(&search.tree[0], &guide);
            let now: Vec<_> = search.tree[0].arms.iter().map(|arm| arm.q.clone()).collect();
            // Every handoff that an object comes to first, as if all were done at once.
            let mut together: Vec<Move> = Vec::new();
            for leg in &outline.legs {
                let handing = |action: &&(usize, Move)| {
                    search.map.arm(action.1.from).is_some() && search.map.arm(action.1.to).is_some()
                };
                let known = outline.chains.get(&leg.object).is_some_and(|c| !c[0].handoffs.is_empty());
                let taken = |action: &Move| {
                    let ends = [search.map.arm(action.from), search.map.arm(action.to)];
                    let used = |other: &Move| [search.map.arm(other.from), search.map.arm(other.to)];
                    together.iter().any(|other| used(other).iter().any(|arm| ends.contains(arm)))
                };
                if let Some((_, action)) = leg.moves.iter().find(handing).filter(|(_, a)| known && !taken(a))
                {
                    together.push(*action);
                }
            }
            match search.grounder.meetings(&now, &together, &outline) {
                Ok(chosen) => {
                    assert_eq!(chosen.len(), together.len());
                    for (n, one) in chosen.iter().enumerate() {
                        for two in &chosen[..n] {
                            assert!(search.grounder.are_apart(one, two));
                            apart += 1;
                        }
                    }
                }
                Err(GroundingFailure::Clash(one, two)) => {
                    assert!(together.contains(&one) && together.contains(&two));
                    clashes += 1;
                }
                Err(other) => panic!("{other:?}"),
            }
        });
    }
    assert!(apart + clashes > 0);
}

#[test]
fn random_steps_grow_the_tree_through_modes_that_nobody_planned() {
    let control = Control::unbounded();
    for family in [Family::Switch, Family::SideToSide, Family::Random] {
        with_search(&problem(family, 2), |search, map, rng| {
            let instance = map.network().instance();
            let mut deepest = 0;
            for _ in 0..200 {
                let tau = rng.random_range(0..search.tree.len());
                let guide = random_step(instance, map, &search.tree[tau].mode, rng);
                let allowed = match check(instance, &guide.solution) {
                    Ok(()) | Err(Violation::GoalMissed(_)) => !guide.immediate.is_empty(),
                    Err(_) => false,
                };
                if !allowed || search.tree[tau].is_goal {
                    continue;
                }
                let outline = search.grounder.outline(&search.tree[tau], &guide);
                if let Some(new) = search.extend(tau, &guide, outline, &control) {
                    let vertex = &search.tree[new];
                    deepest = deepest.max(vertex.depth);
                    for (object, &node) in vertex.objects.iter().zip(&vertex.mode) {
                        match object {
                            Whereabouts::Held { arm, .. } => assert_eq!(map.arm(node), Some(*arm)),
                            Whereabouts::Resting { .. } => assert_eq!(map.arm(node), None),
                        }
                    }
                }
                if deepest == 4 {
                    break;
                }
            }
            assert_eq!(deepest, 4, "{}", family.name());
        });
    }
}

#[test]
fn the_tree_reaches_mode_goals_without_guidance() {
    let control = Control::unbounded();
    for family in [Family::Switch, Family::SideToSide, Family::Random] {
        with_search(&problem(family, 1), |search, map, rng| {
            let reached = (0..40).any(|_| {
                let instance = map.network().instance();
                let guide = random_step(instance, map, &instance.start(), rng);
                if guide.immediate.is_empty() {
                    return false;
                }
                let outline = search.grounder.outline(&search.tree[0], &guide);
                let Ok(grounding) = search.grounder.ground(&search.tree[0], &guide, &outline) else {
                    return false;
                };
                let Ok(motion) = search.planner.plan_as_one_robot(&grounding.task, &control) else {
                    return false;
                };
                // modal_check: every arm with an action stands at its contact, all at the same time.
                motion.arms.iter().zip(&grounding.task.arms).all(|(arm, task)| match &task.goal {
                    ArmGoal::Contact { q, .. } => {
                        let end = &arm.curve.last().q;
                        let near = end.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-9);
                        near && (arm.curve.end_time() - motion.duration).abs() < 1e-9
                    }
                    _ => true,
                })
            });
            assert!(reached, "{}", family.name());
        });
    }
}

#[test]
fn a_search_that_struggles_leaves_idle_arms_where_they_are_until_there_is_a_plan() {
    let control = Control::unbounded();
    with_search(&problem(Family::Switch, 1), |search, _, _| {
        let (mut guide, outline) = search.advise(0, &control).unwrap();
        guide.immediate.truncate(1);
        let goes_somewhere = |search: &mut Search<'_>| {
            let grounding = search.grounder.ground(&search.tree[0], &guide, &outline).unwrap();
            let idle: Vec<_> = grounding.task.arms.iter().filter(|arm| !arm.acts()).collect();
            assert!(!idle.is_empty());
            idle.iter().any(|arm| matches!(arm.goal, ArmGoal::Toward(_)))
        };
        assert!(search.asks_freely() && goes_somewhere(search));
        search.setbacks = 1000;
        search.set_pace();
        assert!(search.struggles() && search.is_crowded() && !search.asks_freely());
        assert!(!goes_somewhere(search));
        search.set_incumbent([1000.0, 1000.0]);
        assert!(!search.struggles() && search.asks_freely() && goes_somewhere(search));
    });
}
