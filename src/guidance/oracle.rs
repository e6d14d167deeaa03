//! Brute force as the oracle of the solvers: breadth-first search over joint states, written from
//! the rules in [`Instance`] alone, on thousands of small random instances.

use super::*;
use crate::run::{Control, Rng, Seed};
use rand::Rng as _;
use std::collections::{BTreeSet, VecDeque};

/// Least number of steps from the start, or `None` if the goals cannot be met.
fn brute_force(instance: &Instance) -> Option<usize> {
    let start = instance.start();
    let mut seen = BTreeSet::from([start.clone()]);
    let mut queue = VecDeque::from([(start, 0)]);
    while let Some((state, steps)) = queue.pop_front() {
        if instance.is_solved(&state) {
            return Some(steps);
        }
        let mut next = BTreeSet::new();
        joint_steps(instance, &state, &mut state.clone(), 0, &mut next);
        for state in next {
            if seen.insert(state.clone()) {
                queue.push_back((state, steps + 1));
            }
        }
    }
    None
}

fn joint_steps(
    instance: &Instance,
    before: &ModeState,
    after: &mut ModeState,
    object: usize,
    found: &mut BTreeSet<ModeState>,
) {
    if object == before.len() {
        if is_legal(instance, before, after) {
            found.insert(after.clone());
        }
        return;
    }
    joint_steps(instance, before, after, object + 1, found);
    for edge in &instance.edges {
        let fits = edge.class.is_none_or(|class| class == instance.objects[object].class);
        if edge.from == before[object] && fits {
            after[object] = edge.to;
            joint_steps(instance, before, after, object + 1, found);
            after[object] = before[object];
        }
    }
}

fn is_legal(instance: &Instance, before: &ModeState, after: &ModeState) -> bool {
    let moved: Vec<usize> = (0..before.len()).filter(|&object| before[object] != after[object]).collect();
    for node in (0..instance.nodes.len()).map(NodeId) {
        let held = before.iter().filter(|&&at| at == node).count();
        let enters = moved.iter().filter(|&&object| after[object] == node).count();
        let leaves = moved.iter().filter(|&&object| before[object] == node).count();
        if enters > 0 && held + enters > instance.nodes[node.0].capacity as usize {
            return false;
        }
        if instance.is_arm(node) && enters + leaves > 1 {
            return false;
        }
    }
    let is_blocked = moved.iter().any(|&object| {
        let blocks = instance.blocks.iter();
        let mut mine = blocks.filter(|b| (b.from, b.to) == (before[object], after[object]));
        mine.any(|block| before.contains(&block.at) || after.contains(&block.at))
    });
    let clashes = instance.clashes.iter().any(|clash| {
        let means = |&&object: &&usize| {
            clash.actions.iter().any(|one| one.means(object, before[object], after[object]))
        };
        moved.iter().filter(means).count() > 1
    });
    !is_blocked
        && !clashes
        && instance.conflicts.iter().all(|set| {
            let held = before.iter().filter(|at| set.nodes.contains(at)).count();
            let enters = moved.iter().filter(|&&object| set.nodes.contains(&after[object])).count();
            enters == 0 || held + enters <= set.capacity as usize
        })
}

/// A small random instance: any mixture of tight and loose capacities, held starts, absent, exact and
/// surface goals, exclusion between slots, classes, one-way edges; often without a solution.
pub(super) fn random_instance(rng: &mut Rng) -> Instance {
    let arms = rng.random_range(1..=3);
    let placements = rng.random_range(2..=4);
    let loose = rng.random_ratio(1, 2);
    let blocking = rng.random_ratio(1, 2);
    let mut nodes = vec![Node { kind: NodeKind::Arm, capacity: 1 }; arms];
    for _ in 0..placements {
        let slot = rng.random_ratio(2, 3);
        let most = if loose { 3 } else { 1 };
        let capacity = if slot { 1 } else { rng.random_range(u32::from(loose)..=most) };
        nodes.push(Node { kind: if slot { NodeKind::Slot } else { NodeKind::Region }, capacity });
    }
    let mut edges = Vec::new();
    let dense = rng.random_range(5..=9);
    for from in 0..nodes.len() {
        for to in 0..nodes.len() {
            if from != to && from.min(to) < arms && rng.random_ratio(dense, 10) {
                let class = rng.random_ratio(1, 8).then(|| rng.random_range(0..2));
                let weight = rng.random_range(0..4) as f64 * 0.5;
                edges.push(Edge { from: NodeId(from), to: NodeId(to), weight, class });
            }
        }
    }
    // Now and then a slot has a twin with the same neighbours.
    let slot = (arms..nodes.len()).find(|&node| nodes[node].kind == NodeKind::Slot);
    if let Some(slot) = slot.filter(|_| rng.random_ratio(1, 3)) {
        let twin = NodeId(nodes.len());
        nodes.push(nodes[slot]);
        let instead = |node: NodeId| if node.0 == slot { twin } else { node };
        let alike: Vec<Edge> = edges.iter().filter(|e| e.from.0 == slot || e.to.0 == slot).copied().collect();
        edges.extend(alike.iter().map(|e| Edge { from: instead(e.from), to: instead(e.to), ..*e }));
    }
    let mut conflicts = Vec::new();
    for one in arms..nodes.len() {
        for other in arms..one {
            if rng.random_ratio(1, 6) {
                let capacity = rng.random_range(1..=2);
                conflicts.push(ConflictSet { nodes: vec![NodeId(one), NodeId(other)], capacity });
            }
        }
    }
    // Now and then two arm nodes are one arm.
    let twins = arms > 1 && rng.random_ratio(1, 3);
    if twins {
        conflicts.push(ConflictSet { nodes: vec![NodeId(0), NodeId(1)], capacity: 1 });
        edges.retain(|edge| edge.from.0 > 1 || edge.to.0 > 1);
    }
    let count = rng.random_range(1..=4.min(nodes.len() - 1));
    let mut held = vec![false; arms];
    let mut objects: Vec<Object> = Vec::new();
    for _ in 0..count {
        let start = loop {
            let node = rng.random_range(0..nodes.len());
            let taken = objects.iter().filter(|object| object.start.0 == node).count();
            // Now and then a placement starts fuller than its capacity.
            let fits = taken < nodes[node].capacity as usize || rng.random_ratio(1, 12);
            if node < arms && (held[node] || rng.random_ratio(1, 2)) {
                continue;
            }
            if node >= arms && !fits {
                continue;
            }
            if node < arms {
                held[node] = true;
                if twins && node < 2 {
                    held[1 - node] = true;
                }
            }
            break NodeId(node);
        };
        let goal = match rng.random_range(0..6) {
            0 => Goal::AnyPlacement,
            1 => Goal::Nodes((0..2).map(|_| NodeId(rng.random_range(arms..nodes.len()))).collect()),
            2 => Goal::Nodes(vec![NodeId(rng.random_range(0..nodes.len()))]),
            3 if !objects.is_empty() => Goal::Nodes(vec![objects[0].start]),
            _ => Goal::Nodes(vec![NodeId(rng.random_range(arms..nodes.len()))]),
        };
        objects.push(Object { start, goal, class: rng.random_range(0..2) });
    }
    let mut blocks: Vec<Block> = Vec::new();
    for edge in &edges {
        let at = NodeId(rng.random_range(arms..nodes.len()));
        let is_slot = nodes[at.0].kind == NodeKind::Slot;
        if blocking && is_slot && at != edge.from && at != edge.to && rng.random_ratio(1, 4) {
            blocks.push(Block { from: edge.from, to: edge.to, at });
        }
    }
    let mut clashes: Vec<Clash> = Vec::new();
    let clashing = rng.random_ratio(1, 3);
    for (number, one) in edges.iter().enumerate().filter(|_| clashing) {
        for other in &edges[..number] {
            if rng.random_ratio(1, 8) {
                let mut meant = |edge: &Edge| {
                    let named = rng.random_ratio(1, 2);
                    let object = named.then(|| rng.random_range(0..objects.len()));
                    Clashing { from: edge.from, to: edge.to, object }
                };
                clashes.push(Clash { actions: vec![meant(one), meant(other)] });
            }
        }
    }
    Instance { nodes, edges, conflicts, blocks, clashes, objects }
}

/// What a run over many instances came to.
#[derive(Debug, Default)]
struct Tally {
    feasible: usize,
    infeasible: usize,
    unsolved: usize,
    refuted: usize,
    proved: usize,
}

fn compare(instance: &Instance, optimum: Option<usize>, answer: &Answer, tally: &mut Tally) {
    match optimum {
        Some(_) => tally.feasible += 1,
        None => tally.infeasible += 1,
    }
    match answer {
        Answer::Solved(solution, certificate) => {
            check(instance, solution).unwrap_or_else(|fault| panic!("{fault}: {instance:?} {solution:?}"));
            let optimum = optimum.unwrap_or_else(|| panic!("solved the infeasible: {instance:?}"));
            assert_eq!(certificate.steps, solution.steps.len());
            assert!(certificate.lower_bound <= optimum, "bound over optimum {optimum}: {instance:?}");
            assert!(optimum <= certificate.steps, "fewer steps than possible: {instance:?}");
            if let Some(proved) = certificate.optimum {
                assert_eq!(proved, optimum, "{instance:?}");
                assert_ne!(certificate.proof, Proof::None);
                tally.proved += 1;
            } else {
                assert_eq!(certificate.proof, Proof::None);
            }
        }
        Answer::Infeasible(reason) => {
            assert_eq!(optimum, None, "{reason}: {instance:?}");
            tally.refuted += 1;
        }
        Answer::Unknown { lower_bound } => {
            assert!(optimum.is_none_or(|optimum| *lower_bound <= optimum), "{instance:?}");
            tally.unsolved += 1;
        }
    }
}

fn solve_from_start(instance: &Instance, cuts: &Cuts, effort: &Effort, seed: u64) -> Answer {
    let network = Network::new(instance.clone()).unwrap();
    solve(&network, &instance.start(), cuts, effort, Seed(seed), &Control::unbounded()).unwrap()
}

#[test]
fn bound_optimum_and_plan_are_in_order_on_random_instances() {
    let mut tally = Tally::default();
    let mut rng = Seed(7).stream("guidance/oracle");
    for case in 0..2000 {
        let instance = random_instance(&mut rng);
        let answer = solve_from_start(&instance, &Cuts::none(), &Effort::quick(), case);
        compare(&instance, brute_force(&instance), &answer, &mut tally);
    }
    assert!(tally.feasible > 800 && tally.infeasible > 800, "{tally:?}");
    // On instances as small as these nothing may be left open.
    assert_eq!(tally.unsolved, 0, "{tally:?}");
    assert_eq!((tally.proved, tally.refuted), (tally.feasible, tally.infeasible), "{tally:?}");
}

#[test]
fn bounds_without_exhaustive_search_hold() {
    let effort = Effort { states: 0, ..Effort::quick() };
    let mut tally = Tally::default();
    let mut rng = Seed(8).stream("guidance/oracle");
    for case in 0..800 {
        let instance = random_instance(&mut rng);
        let answer = solve_from_start(&instance, &Cuts::none(), &effort, case);
        compare(&instance, brute_force(&instance), &answer, &mut tally);
    }
    let solved = tally.feasible + tally.infeasible - tally.unsolved - tally.refuted;
    assert!(solved * 100 >= tally.feasible * 98, "the repair search misses too many plans: {tally:?}");
    assert!(tally.proved * 10 >= tally.feasible * 7, "the bounds close too few gaps: {tally:?}");
}

/// Only the integer program closes gaps, and it may spend what it likes.
fn program_only() -> Effort {
    Effort {
        states: 0,
        first_refutations: 0,
        refutations: 0,
        repair_rounds: 20,
        program_iterations: u64::MAX,
        program_nodes: u64::MAX,
        ..Effort::quick()
    }
}

#[test]
fn the_integer_program_finds_what_brute_force_finds() {
    let mut tally = Tally::default();
    let mut rng = Seed(12).stream("guidance/oracle");
    for case in 0..300 {
        let instance = random_instance(&mut rng);
        let answer = solve_from_start(&instance, &Cuts::none(), &program_only(), case);
        compare(&instance, brute_force(&instance), &answer, &mut tally);
    }
    assert!(tally.feasible > 100);
    let solved = tally.feasible + tally.infeasible - tally.unsolved - tally.refuted;
    assert_eq!(tally.proved, solved, "{tally:?}");
}

#[test]
fn the_program_decides_every_horizon_like_brute_force() {
    let mut rng = Seed(13).stream("guidance/oracle");
    let control = Control::unbounded();
    let (mut yes, mut no) = (0, 0);
    for _ in 0..400 {
        let instance = random_instance(&mut rng);
        let Some(optimum) = brute_force(&instance).filter(|&steps| steps > 0) else { continue };
        let network = Network::new(instance.clone()).unwrap();
        let start: Vec<u16> = instance.start().iter().map(|node| node.0 as u16).collect();
        let reach = bounds::Reach::new(&network, &start);
        let limits = interruptible::Limits { control: &control, iterations: u64::MAX, nodes: u64::MAX };
        for horizon in [optimum - 1, optimum] {
            if horizon == 0 {
                continue;
            }
            let merge = program::Commodities::Kinds;
            match program::decide(&network, &start, &reach, horizon, merge, &limits) {
                program::Outcome::Routes(_) => {
                    assert_eq!(horizon, optimum, "{instance:?}");
                    yes += 1;
                }
                program::Outcome::Infeasible => {
                    assert!(horizon < optimum, "{instance:?}");
                    no += 1;
                }
                program::Outcome::Limit | program::Outcome::Unclear => {
                    panic!("no verdict at {horizon} steps: {instance:?}")
                }
            }
        }
    }
    assert!(yes > 80 && no > 50, "{yes} {no}");
}

#[test]
fn the_papers_single_call_gives_legal_plans_and_knows_what_is_too_short() {
    let mut rng = Seed(14).stream("guidance/oracle");
    let mut solved = 0;
    for _ in 0..200 {
        let instance = random_instance(&mut rng);
        let Some(optimum) = brute_force(&instance).filter(|&steps| steps > 1) else { continue };
        let network = Network::new(instance.clone()).unwrap();
        let state = instance.start();
        let plan = single_call(&network, &state, optimum + 1, 60.0).unwrap();
        check(&instance, &plan).unwrap();
        assert!((optimum..=optimum + 1).contains(&plan.steps.len()));
        let short = single_call(&network, &state, optimum - 1, 60.0);
        assert_eq!(short, Err(SingleCallError::Infeasible(optimum - 1)), "{instance:?}");
        solved += 1;
    }
    assert!(solved > 20, "{solved}");
}

#[test]
fn smart_guidance_leads_to_the_goal_in_the_steps_it_promises() {
    let mut rng = Seed(9).stream("guidance/oracle");
    let smart = Smart { effort: Effort::quick(), seed: Seed(1) };
    let control = Control::unbounded();
    let mut walked = 0;
    for _ in 0..500 {
        let instance = random_instance(&mut rng);
        let Some(mut left) = brute_force(&instance) else { continue };
        let network = Network::new(instance.clone()).unwrap();
        let mut memo = Memo::new();
        let mut state = instance.start();
        loop {
            let advice = smart.guide(&network, &state, &Cuts::none(), &mut memo, &control);
            let Ok(Advice::Go(guide)) = advice else {
                panic!("{advice:?} from {state:?} of {instance:?}");
            };
            check(&instance, &guide.solution).unwrap();
            assert_eq!(guide.solution.start, state);
            assert_eq!(guide.remaining_steps, Some(left));
            assert_eq!(guide.certificate.unwrap().optimum, Some(left));
            for first in &guide.heuristic {
                let action = &guide.solution.steps[first.step - 1];
                assert!(action.contains(&first.action));
                assert!(
                    [first.action.from, first.action.to]
                        .iter()
                        .any(|node| { network.arm_number[node.0] == network.arm_number[first.arm.0] })
                );
            }
            if guide.immediate.is_empty() {
                break;
            }
            for action in &guide.immediate {
                state[action.object] = action.to;
            }
            left -= 1;
            walked += 1;
        }
        assert!(instance.is_solved(&state));
    }
    assert!(walked > 300, "{walked}");
}

#[test]
fn sequential_plans_are_legal_and_move_one_object_at_a_time() {
    let mut rng = Seed(10).stream("guidance/oracle");
    let (mut solved, mut feasible) = (0, 0);
    for _ in 0..600 {
        let instance = random_instance(&mut rng);
        let optimum = brute_force(&instance);
        let network = Network::new(instance.clone()).unwrap();
        let state = instance.start();
        let mut memo = Memo::new();
        let advice =
            Sequential.guide(&network, &state, &Cuts::none(), &mut memo, &Control::unbounded()).unwrap();
        feasible += usize::from(optimum.is_some());
        match advice {
            Advice::Go(guide) => {
                check(&instance, &guide.solution).unwrap();
                assert!(guide.solution.steps.iter().all(|moves| moves.len() == 1));
                assert!(guide.solution.steps.len() >= optimum.unwrap());
                solved += 1;
            }
            Advice::Infeasible(_) => assert_eq!(optimum, None),
            Advice::Unknown { .. } => {}
        }
    }
    assert!(solved * 10 >= feasible * 8, "{solved} of {feasible}");
}

#[test]
fn under_cuts_plans_are_legal_and_nothing_is_claimed() {
    let mut rng = Seed(11).stream("guidance/oracle");
    let (mut avoided, mut cut) = (0, 0);
    for case in 0..600 {
        let instance = random_instance(&mut rng);
        let Answer::Solved(free, _) = solve_from_start(&instance, &Cuts::none(), &Effort::quick(), case)
        else {
            continue;
        };
        let Some(&action) = free.steps.first().and_then(|moves| moves.first()) else { continue };
        let mut cuts = Cuts::none();
        cuts.add(CutKind::Action(action), 3, 10);
        match solve_from_start(&instance, &cuts, &Effort::quick(), case) {
            Answer::Solved(plan, certificate) => {
                check(&instance, &plan).unwrap();
                assert_eq!((certificate.lower_bound, certificate.optimum), (0, None));
                assert_eq!(certificate.proof, Proof::None);
                let dear = |plan: &Solution| plan.steps.len() as u64 + cuts.penalty(&plan.start, &plan.steps);
                cut += 1;
                avoided += usize::from(dear(&plan) < dear(&free));
            }
            Answer::Infeasible(reason) => panic!("{reason} under cuts"),
            Answer::Unknown { lower_bound } => assert_eq!(lower_bound, 0),
        }
    }
    assert!(cut > 100 && avoided > 20, "{avoided} of {cut}");
}
