//! Instances with known answers: the paper's, and one broken plan for each rule of the checker.

use super::generate::{Grid, derangement};
use super::*;
use crate::run::{Control, Seed};

fn answer(instance: &Instance, effort: &Effort) -> Answer {
    let network = Network::new(instance.clone()).unwrap();
    let state = instance.start();
    let answer = solve(&network, &state, &Cuts::none(), effort, Seed(1), &Control::unbounded()).unwrap();
    if let Some(solution) = answer.solution() {
        check(instance, solution).unwrap();
    }
    answer
}

fn proved_steps(instance: &Instance, effort: &Effort) -> usize {
    let answer = answer(instance, effort);
    let certificate = answer.certificate().copied().unwrap();
    assert_ne!(certificate.proof, Proof::None, "{certificate:?}");
    assert_eq!(certificate.optimum, Some(certificate.steps));
    assert_eq!(certificate.lower_bound, certificate.steps);
    certificate.steps
}

fn grid(depth: usize, lanes: usize) -> Grid {
    Grid { depth, lanes, diagonals: true }
}

#[test]
fn switches_take_the_known_number_of_steps() {
    let quick = Effort::quick();
    assert_eq!(proved_steps(&grid(2, 1).switch(2), &quick), 6);
    assert_eq!(proved_steps(&grid(2, 2).switch(4), &quick), 5);
    assert_eq!(proved_steps(&grid(3, 3).switch(4), &quick), 6);
    assert_eq!(proved_steps(&grid(3, 3).switch(20), &Effort::thorough()), 16);
}

#[test]
fn side_to_side_takes_the_known_number_of_steps() {
    let quick = Effort::quick();
    assert_eq!(proved_steps(&grid(2, 1).side_to_side(2), &quick), 5);
    assert_eq!(proved_steps(&grid(3, 3).side_to_side(20), &quick), 16);
}

#[test]
fn swaps_and_derangements_take_the_known_number_of_steps() {
    let quick = Effort::quick();
    assert_eq!(proved_steps(&derangement(1, 2), &quick), 6);
    assert_eq!(proved_steps(&derangement(3, 2), &quick), 8);
    assert_eq!(proved_steps(&derangement(1, 4), &quick), 10);
}

#[test]
fn a_swap_without_a_spare_place_is_infeasible() {
    let mut instance = derangement(1, 2);
    let buffer = instance.nodes.len() - 1;
    instance.nodes[buffer].capacity = 0;
    assert!(matches!(answer(&instance, &Effort::quick()), Answer::Infeasible(Infeasible::Exhausted(_))));
    instance.edges.retain(|edge| edge.to != NodeId(1));
    assert_eq!(answer(&instance, &Effort::quick()), Answer::Infeasible(Infeasible::NoPath(1)));
}

#[test]
fn the_same_seed_gives_the_same_answer() {
    let instance = grid(3, 3).refined(9, &mut Seed(3).stream("known"));
    let first = answer(&instance, &Effort::quick());
    assert!(first.solution().is_some());
    assert_eq!(first, answer(&instance, &Effort::quick()));
}

#[test]
fn refined_instances_of_the_papers_sizes_are_solved() {
    for (depth, lanes, objects) in [(2, 1, 2), (2, 2, 4), (3, 2, 4), (3, 3, 4), (3, 3, 20)] {
        for seed in 0..3 {
            let instance = grid(depth, lanes).refined(objects, &mut Seed(seed).stream("known"));
            let answer = answer(&instance, &Effort::quick());
            assert!(answer.solution().is_some(), "{depth}x{lanes}, {objects} objects, seed {seed}");
        }
    }
}

/// Follows a guidance from the start; the states until it stops.
fn follow(guidance: &dyn Guidance, instance: &Instance) -> (Vec<ModeState>, bool) {
    let network = Network::new(instance.clone()).unwrap();
    let mut memo = Memo::new();
    let mut states = vec![instance.start()];
    for _ in 0..200 {
        let mut state = states[states.len() - 1].clone();
        let advice =
            guidance.guide(&network, &state, &Cuts::none(), &mut memo, &Control::unbounded()).unwrap();
        let Advice::Go(guide) = advice else { break };
        if guide.immediate.is_empty() {
            break;
        }
        for action in &guide.immediate {
            state[action.object] = action.to;
        }
        states.push(state);
    }
    let solved = instance.is_solved(&states[states.len() - 1]);
    (states, solved)
}

#[test]
fn greedy_gets_stuck_on_the_switch_that_the_others_solve() {
    let switch = grid(2, 1).switch(2);
    assert!(!follow(&Greedy, &switch).1);
    let smart = Smart { effort: Effort::quick(), seed: Seed(0) };
    let (states, solved) = follow(&smart, &switch);
    assert!(solved);
    assert_eq!(states.len(), 7);
    let (states, solved) = follow(&Sequential, &switch);
    assert!(solved);
    assert_eq!(states.len(), 7);
}

#[test]
fn greedy_moves_objects_that_are_in_nobodys_way() {
    let (states, solved) = follow(&Greedy, &grid(2, 1).side_to_side(2));
    assert!(solved);
    assert!(states.len() >= 6);
}

#[test]
fn smart_needs_at_most_half_the_steps_of_sequential_side_to_side() {
    let instance = grid(3, 3).side_to_side(4);
    let smart = Smart { effort: Effort::quick(), seed: Seed(0) };
    let (with, _) = follow(&smart, &instance);
    let (without, _) = follow(&Sequential, &instance);
    let (with, without) = (with.len() - 1, without.len() - 1);
    assert!(2 * with <= without, "{with} {without}");
}

#[test]
fn a_state_on_a_known_plans_way_is_remembered() {
    let instance = grid(3, 3).refined(4, &mut Seed(5).stream("known"));
    let network = Network::new(instance.clone()).unwrap();
    let answer = answer(&instance, &Effort::quick());
    let mut memo = Memo::new();
    memo.keep(&instance.start(), &answer, &Cuts::none());
    let plan = answer.solution().unwrap();
    for (offset, state) in plan.states().iter().enumerate() {
        let known = memo.find(&network, state, &Cuts::none()).unwrap();
        assert_eq!(known.solution().unwrap().steps, plan.steps[offset..]);
        check(&instance, known.solution().unwrap()).unwrap();
        assert_eq!(known.certificate().unwrap().optimum, Some(plan.steps.len() - offset));
    }
    let mut cuts = Cuts::none();
    cuts.add(CutKind::Arm(NodeId(0)), 1, 1);
    assert_eq!(memo.find(&network, &instance.start(), &cuts), None);
}

#[test]
fn cuts_are_avoided_where_that_is_cheaper_and_expire() {
    // Two parallel arms between two tables: a cut on one sends the object over the other.
    let mut instance = Grid { depth: 1, lanes: 2, diagonals: false }.side_to_side(1);
    instance.edges.retain(|edge| edge.class.is_none() && edge.from.0.max(edge.to.0) > 1);
    let network = Network::new(instance.clone()).unwrap();
    let state = instance.start();
    let plan = |cuts: &Cuts| {
        let effort = Effort::quick();
        match solve(&network, &state, cuts, &effort, Seed(0), &Control::unbounded()).unwrap() {
            Answer::Solved(plan, _) => plan,
            other => panic!("{other:?}"),
        }
    };
    let arm = plan(&Cuts::none()).steps[0][0].to;
    let mut cuts = Cuts::none();
    cuts.add(CutKind::Arm(arm), 5, 2);
    assert_ne!(plan(&cuts).steps[0][0].to, arm);
    cuts.advance();
    assert!(!cuts.is_empty());
    cuts.advance();
    assert!(cuts.is_empty());
    // A pair of actions in one step is kept apart, at the price of no more than its penalty.
    let both = grid(2, 2).side_to_side(2);
    let network = Network::new(both.clone()).unwrap();
    let free =
        solve(&network, &both.start(), &Cuts::none(), &Effort::quick(), Seed(0), &Control::unbounded())
            .unwrap();
    let step = free.solution().unwrap().steps.iter().find(|step| step.len() == 2).unwrap().clone();
    let mut cuts = Cuts::none();
    cuts.add(CutKind::Pair(step[1], step[0]), 4, 2);
    let effort = Effort::quick();
    let apart = solve(&network, &both.start(), &cuts, &effort, Seed(0), &Control::unbounded()).unwrap();
    let apart = apart.solution().unwrap();
    check(&both, apart).unwrap();
    assert_eq!(cuts.penalty(&apart.start, &apart.steps), 0);
}

#[test]
fn a_blocked_action_is_done_before_the_blocker_comes_or_after_it_has_gone() {
    let switch = grid(2, 1).switch(2);
    let network = Network::new(switch.clone()).unwrap();
    let plan = |cuts: &Cuts| {
        let effort = Effort::quick();
        let answer = solve(&network, &switch.start(), cuts, &effort, Seed(0), &Control::unbounded());
        let solution = answer.unwrap().solution().unwrap().clone();
        check(&switch, &solution).unwrap();
        solution
    };
    let free = plan(&Cuts::none());
    // Whoever is put down first then stands in the way of the other's pick.
    let place = free.steps.iter().flatten().find(|action| !switch.is_arm(action.to)).copied().unwrap();
    let other = 1 - place.object;
    let pick = free.steps.iter().flatten().find(|action| action.object == other).copied().unwrap();
    let mut cuts = Cuts::none();
    cuts.add(CutKind::Blocked { action: pick, by: place.object, at: place.to }, 8, 10);
    assert!(cuts.penalty(&free.start, &free.steps) > 0);
    let changed = plan(&cuts);
    assert_eq!(cuts.penalty(&changed.start, &changed.steps), 0);
    assert_eq!(changed.steps.len(), free.steps.len());
}

/// One arm (0), slots 1 and 2 that overlap, a region 3 for one object; object 0 in the region goes to
/// slot 1, object 1 on slot 2 goes anywhere.
fn small() -> Instance {
    let node = |kind, capacity| Node { kind, capacity };
    let mut edges = Vec::new();
    for placement in 1..=3 {
        for (from, to) in [(0, placement), (placement, 0)] {
            edges.push(Edge { from: NodeId(from), to: NodeId(to), weight: 1.0, class: None });
        }
    }
    Instance {
        blocks: Vec::new(),
        clashes: Vec::new(),
        nodes: vec![
            node(NodeKind::Arm, 1),
            node(NodeKind::Slot, 1),
            node(NodeKind::Slot, 1),
            node(NodeKind::Region, 1),
        ],
        edges,
        conflicts: vec![ConflictSet { nodes: vec![NodeId(1), NodeId(2)], capacity: 1 }],
        objects: vec![
            Object { start: NodeId(3), goal: Goal::Nodes(vec![NodeId(1)]), class: 0 },
            Object { start: NodeId(2), goal: Goal::AnyPlacement, class: 0 },
        ],
    }
}

fn replay(instance: &Instance, steps: &[&[(usize, usize, usize)]]) -> Result<(), Violation> {
    let moves = |step: &&[(usize, usize, usize)]| {
        step.iter()
            .map(|&(object, from, to)| Move { object, from: NodeId(from), to: NodeId(to) })
            .collect::<Vec<_>>()
    };
    let steps: Vec<_> = steps.iter().map(moves).collect();
    let weight = steps.iter().flatten().count() as f64;
    check(instance, &Solution { start: instance.start(), steps, weight })
}

#[test]
fn the_checker_names_each_broken_rule() {
    let instance = small();
    assert_eq!(replay(&instance, &[]), Err(Violation::GoalMissed(0)));
    assert_eq!(replay(&instance, &[&[]]), Err(Violation::EmptyStep(1)));
    assert_eq!(replay(&instance, &[&[(2, 3, 0)]]), Err(Violation::NoSuchObject { step: 1, object: 2 }));
    assert_eq!(
        replay(&instance, &[&[(1, 2, 0), (0, 3, 0)]]),
        Err(Violation::OutOfOrder { step: 1, object: 0 })
    );
    assert_eq!(replay(&instance, &[&[(0, 1, 0)]]), Err(Violation::NotThere { step: 1, object: 0 }));
    assert_eq!(replay(&instance, &[&[(0, 3, 1)]]), Err(Violation::NoSuchEdge { step: 1, object: 0 }));
    assert_eq!(replay(&instance, &[&[(0, 3, 0), (1, 2, 0)]]), Err(Violation::ArmTwice { step: 1, node: 0 }));
    assert_eq!(
        replay(&instance, &[&[(0, 3, 0)], &[(0, 0, 1)]]),
        Err(Violation::OverConflict { step: 2, set: 0 })
    );
    assert_eq!(
        replay(&instance, &[&[(1, 2, 0)], &[(1, 0, 3)]]),
        Err(Violation::OverCapacity { step: 2, node: 3 })
    );
    let mut two_arms = instance.clone();
    two_arms.nodes.push(Node { kind: NodeKind::Arm, capacity: 1 });
    for (from, to) in [(2, 4), (4, 2)] {
        two_arms.edges.push(Edge { from: NodeId(from), to: NodeId(to), weight: 1.0, class: None });
    }
    two_arms
        .clashes
        .push(Clash { actions: [(3, 0), (2, 4)].map(|(a, b)| (NodeId(a), NodeId(b)).into()).to_vec() });
    assert_eq!(replay(&two_arms, &[&[(0, 3, 0), (1, 2, 4)]]), Err(Violation::Clashing { step: 1, clash: 0 }));
    assert_eq!(replay(&two_arms, &[&[(0, 3, 0)], &[(1, 2, 4)]]), Err(Violation::GoalMissed(0)));
    // Of another object than the one that is meant the same is allowed.
    two_arms.clashes[0].actions[1].object = Some(0);
    assert_eq!(replay(&two_arms, &[&[(0, 3, 0), (1, 2, 4)]]), Err(Violation::GoalMissed(0)));
    let mut wide = instance.clone();
    wide.conflicts.clear();
    assert_eq!(replay(&wide, &[&[(0, 3, 0)], &[(0, 0, 1)]]), Ok(()));
    let steps = vec![
        vec![Move { object: 0, from: NodeId(3), to: NodeId(0) }],
        vec![Move { object: 0, from: NodeId(0), to: NodeId(1) }],
    ];
    let cheap = Solution { start: wide.start(), steps, weight: 1.0 };
    assert_eq!(check(&wide, &cheap), Err(Violation::WrongWeight { claimed: 1.0, actual: 2.0 }));
    let mut lost = wide.clone();
    lost.objects[0].start = NodeId(9);
    assert!(matches!(replay(&lost, &[]), Err(Violation::Malformed(InstanceError::NoSuchNode { .. }))));
}

/// Two objects that would clash on the way by one slot, but not by its twin: nobody may claim that this takes longer.
#[test]
fn a_clash_at_one_slot_is_none_at_its_twin() {
    let arm = Node { kind: NodeKind::Arm, capacity: 1 };
    let slot = Node { kind: NodeKind::Slot, capacity: 1 };
    let ways = [(4, 0), (0, 5), (0, 6), (5, 1), (6, 1), (1, 7), (8, 2), (2, 9), (9, 3), (3, 10)];
    let edge = |(from, to)| Edge { from: NodeId(from), to: NodeId(to), weight: 1.0, class: None };
    let object =
        |start, goal| Object { start: NodeId(start), goal: Goal::Nodes(vec![NodeId(goal)]), class: 0 };
    for twin in [5, 6] {
        let instance = Instance {
            nodes: [vec![arm; 4], vec![slot; 7]].concat(),
            edges: ways.map(edge).to_vec(),
            clashes: vec![Clash {
                actions: [(0, twin), (2, 9)].map(|(a, b)| (NodeId(a), NodeId(b)).into()).to_vec(),
            }],
            objects: vec![object(4, 7), object(8, 10)],
            ..Instance::default()
        };
        let network = Network::new(instance).unwrap();
        let start = network.instance().start();
        for states in [0, 1_000] {
            let effort = Effort { states, ..Effort::quick() };
            let answer = solve(&network, &start, &Cuts::none(), &effort, Seed(0), &Control::unbounded());
            let known = answer.unwrap().certificate().copied().unwrap();
            assert_eq!(known.lower_bound, 4);
        }
    }
}

#[test]
fn solving_ends_soon_after_it_is_told_to() {
    // States of so many objects have more joint steps than can be listed, and programs of such a size keep the
    // solver in its presolve for long.
    let grid = Grid { depth: 4, lanes: 4, diagonals: true };
    let instances =
        [grid.switch(18), grid.refined(20, &mut Seed(3).stream("guidance/limits")), derangement(2, 9)];
    for (case, instance) in instances.into_iter().enumerate() {
        let network = Network::new(instance).unwrap();
        let state = network.instance().start();
        let budget = std::time::Duration::from_millis(40);
        let control = Control::with_budget(budget);
        solve(&network, &state, &Cuts::none(), &Effort::thorough(), Seed(1), &control).unwrap();
        // Ten times what it takes; without a limit it was minutes.
        assert!(control.deadline.elapsed_s() < 2.0, "case {case}: {} s", control.deadline.elapsed_s());
    }
}

#[test]
fn malformed_instances_are_refused() {
    let fault = |change: &dyn Fn(&mut Instance)| {
        let mut instance = small();
        change(&mut instance);
        Network::new(instance).err()
    };
    assert_eq!(fault(&|_| ()), None);
    assert_eq!(fault(&|i| i.nodes[0].capacity = 2), Some(InstanceError::ArmCapacity(0)));
    assert_eq!(fault(&|i| i.edges[0].from = NodeId(2)), Some(InstanceError::NotAnAction(0)));
    assert_eq!(fault(&|i| i.edges[0].to = NodeId(0)), Some(InstanceError::NotAnAction(0)));
    assert_eq!(fault(&|i| i.edges[1].weight = f64::NAN), Some(InstanceError::BadWeight(1)));
    assert_eq!(fault(&|i| i.conflicts[0].nodes.push(NodeId(0))), Some(InstanceError::ArmInConflict(0)));
    let block = |at| Block { from: NodeId(0), to: NodeId(2), at: NodeId(at) };
    assert_eq!(fault(&|i| i.blocks.push(block(1))), None);
    for at in [0, 2, 3] {
        assert_eq!(fault(&|i| i.blocks.push(block(at))), Some(InstanceError::BadBlock(0)));
    }
    let clash = |to| Clash { actions: [1, to].map(|to| (NodeId(0), NodeId(to)).into()).to_vec() };
    assert_eq!(fault(&|i| i.clashes.push(clash(2))), None);
    assert!(matches!(fault(&|i| i.clashes.push(clash(9))), Some(InstanceError::NoSuchNode { .. })));
    let named = |i: &mut Instance| {
        i.clashes.push(clash(2));
        i.clashes[0].actions[0].object = Some(2);
    };
    assert_eq!(fault(&named), Some(InstanceError::NoSuchObject { object: 2, count: 2 }));
    let one_arm = |capacity| ConflictSet { nodes: vec![NodeId(0)], capacity };
    assert_eq!(fault(&|i| i.conflicts.push(one_arm(1))), None);
    assert_eq!(fault(&|i| i.conflicts.push(one_arm(2))), Some(InstanceError::ArmInConflict(1)));
    assert_eq!(
        fault(&|i| i.conflicts.extend([one_arm(1), one_arm(1)])),
        Some(InstanceError::ArmInConflict(2))
    );
    assert_eq!(
        fault(&|i| i.objects.iter_mut().for_each(|object| object.start = NodeId(0))),
        Some(InstanceError::HeldTwice(0))
    );
    let network = Network::new(small()).unwrap();
    let control = Control::unbounded();
    let short = solve(&network, &[NodeId(1)], &Cuts::none(), &Effort::quick(), Seed(0), &control);
    assert_eq!(short, Err(InstanceError::StateLength { placed: 1, objects: 2 }));
}
