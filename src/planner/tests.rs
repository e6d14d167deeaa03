//! What a cache may and may not change, and how a run goes on from a plan of another one.

use std::sync::Arc;

use super::{PlannerCache, PlannerEvent, improve_with, plan_with, settled_mode_graph};
use crate::collision::CollisionWorld;
use crate::mode_graph::{ModeGraphOptions, build_mode_graph};
use crate::motion::first_roadmaps;
use crate::plan::{ActionKind, Plan};
use crate::problem::Problem;
use crate::run::{CancelToken, Control, Deadline, Seed};
use crate::scenario::{Family, generate};
use crate::search::{Map, NotResumed, Report, Search, Settings};
use crate::transition::SampledReach;
use crate::verify::verify;
use crate::wire::plan::read_plan;
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

pub(super) fn random_2x2(seed: u64) -> Problem {
    let document = generate(Family::Random, 2, 2, seed).unwrap();
    let mut problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
    problem.options.max_iterations = Some(40);
    problem.options.time_budget_s = 600.0;
    problem
}

/// All incumbents of a run, but for when they were found.
pub(super) fn plans(cache: &PlannerCache, problem: &Problem) -> Vec<String> {
    let mut plans = Vec::new();
    let mut observe = |event: PlannerEvent<'_>| {
        if let PlannerEvent::Incumbent(found) = event {
            let mut found: Plan = found.clone();
            found.metrics.found_after_s = 0.0;
            plans.push(crate::wire::plan::to_json(problem, &found).to_string());
        }
    };
    plan_with(cache, problem, &Control::unbounded(), &mut observe);
    plans
}

#[test]
fn plans_are_the_same_with_a_cold_and_a_warm_cache() {
    let (first, second) = (random_2x2(1), random_2x2(2));
    assert_eq!(first.workcell_digest, second.workcell_digest);
    let cold = plans(&PlannerCache::new(0), &first);
    assert!(!cold.is_empty(), "forty iterations solve it");
    let cache = PlannerCache::default();
    plans(&cache, &second);
    assert_eq!(cache.len(), 1);
    // Warmed by another arrangement, then by itself.
    assert_eq!(plans(&cache, &first), cold);
    assert_eq!(plans(&cache, &first), cold);
    assert_eq!(cache.len(), 1);
}

/// So many objects that much of what the guidance says is done in part, and the rest of a step as it was.
#[test]
fn plans_for_many_objects_are_valid_and_come_again() {
    for seed in [1, 3] {
        let document = generate(Family::Random, 4, 18, seed).unwrap();
        let mut problem =
            read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        problem.options.max_iterations = Some(200);
        problem.options.stop.first_solution = true;
        problem.options.time_budget_s = 600.0;
        let cache = PlannerCache::default();
        let found = plans(&cache, &problem);
        assert!(!found.is_empty(), "two hundred iterations solve it");
        for plan in &found {
            let plan = read_plan(plan.as_bytes(), &problem).unwrap();
            assert!(verify(&problem, &plan).valid);
        }
        assert_eq!(plans(&cache, &problem), found);
    }
}

#[test]
fn the_cache_is_bounded_and_keys_by_what_matters() {
    let control = Control::unbounded();
    let cache = PlannerCache::new(2);
    let variant = |change: &dyn Fn(&mut Problem)| {
        let mut problem = random_2x2(1);
        change(&mut problem);
        problem
    };
    let plain = variant(&|_| {});
    let known = cache.get(&plain, &control);
    let same = variant(&|problem| problem.options.seed = 7);
    assert!(Arc::ptr_eq(&known, &cache.get(&same, &control)));
    let others: [&dyn Fn(&mut Problem); 3] = [
        &|problem| problem.options.clearance_m = 0.004,
        &|problem| problem.options.ik_solutions = 2,
        &|problem| problem.workcell_digest.push('x'),
    ];
    for change in others {
        assert!(!Arc::ptr_eq(&known, &cache.get(&variant(change), &control)));
        assert!(cache.len() <= 2);
        // What is used stays.
        assert!(Arc::ptr_eq(&known, &cache.get(&plain, &control)));
    }
}

#[test]
fn what_was_not_built_to_the_end_is_not_kept() {
    let cancel = CancelToken::new();
    cancel.cancel();
    let cache = PlannerCache::default();
    cache.get(&random_2x2(1), &Control::new(Deadline::never(), cancel));
    assert!(cache.is_empty());
}

#[test]
fn threads_build_the_same_roadmaps() {
    let mut problem = random_2x2(1);
    let control = Control::unbounded();
    let one = super::cache::CompiledWorkcell::new(&problem, &control);
    problem.options.threads = 2;
    let two = super::cache::CompiledWorkcell::new(&problem, &control);
    let vertices = |compiled: &super::cache::CompiledWorkcell| -> Vec<_> {
        compiled.roadmaps().iter().map(|roadmap| roadmap.vertices().to_vec()).collect()
    };
    assert_eq!(vertices(&one), vertices(&two));
    assert!(vertices(&one).iter().all(|roadmap| roadmap.len() > 100));
}

/// A problem, and the first plan found for it, as it comes back from a client.
fn with_first_plan(family: Family, arms: usize, objects: usize) -> (Problem, Plan) {
    let document = generate(family, arms, objects, 1).unwrap();
    let mut problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
    problem.options.stop.first_solution = true;
    let cache = PlannerCache::new(0);
    let outcome = plan_with(&cache, &problem, &Control::unbounded(), &mut |_| {});
    let plan = crate::wire::plan::to_json(&problem, &outcome.best.unwrap());
    let plan = crate::wire::plan::read_plan(plan.as_bytes(), &problem).unwrap();
    problem.options.stop.first_solution = false;
    // Another run, with other roadmaps' growth, transitions and places to put things aside.
    problem.options.seed = 9;
    (problem, plan)
}

/// Runs a fresh search for `iterations` from `plan`; whether it went on from it, and its candidates.
fn resumed(
    problem: &Problem,
    plan: &Plan,
    iterations: usize,
) -> (Result<(), NotResumed>, Vec<crate::search::Candidate>) {
    let (control, seed) = (Control::unbounded(), Seed(problem.options.seed));
    let world = CollisionWorld::new(problem);
    let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
    let mut reach = SampledReach::new(problem, &world, seed);
    let graph = build_mode_graph(problem, &mut reach, &ModeGraphOptions::planning(), &control);
    let contacts = reach.into_contacts();
    let map = Map::new(graph).unwrap();
    let settings = Settings::default();
    let mut search = Search::new(problem, &world, &map, contacts, roadmaps, settings, seed, &control);
    let answer = search.resume(plan, &control);
    let mut found = Vec::new();
    for _ in 0..iterations {
        if let Report::Candidate(candidate) = search.iterate(&control) {
            search.accept(candidate.cost(problem.options.objective));
            found.push(candidate);
        }
    }
    (answer, found)
}

/// Which objects are taken, put down and handed over, by whom and in which hold, step by step.
fn doings(actions: &[crate::plan::Action]) -> Vec<(usize, usize, ActionKind)> {
    actions.iter().map(|action| (action.step, action.object.0, action.kind.clone())).collect()
}

#[test]
fn the_search_goes_on_from_a_plan_of_another_run() {
    let mut kept = 0;
    for (family, arms, objects) in [
        (Family::Switch, 2, 2),
        (Family::SideToSide, 4, 4),
        (Family::Random, 2, 3),
        (Family::InPlaceSwap, 1, 2),
    ] {
        let (problem, plan) = with_first_plan(family, arms, objects);
        let (answer, found) = resumed(&problem, &plan, 60);
        assert_eq!(answer, Ok(()), "{}", family.name());
        let mut best = plan.metrics.cost(problem.options.objective);
        for candidate in &found {
            let cost = candidate.cost(problem.options.objective);
            assert!(cost < best, "{}: {cost:?} after {best:?}", family.name());
            best = cost;
        }
        // What was changed in one window has the same actions as the plan itself.
        kept += found.iter().filter(|candidate| doings(&candidate.actions) == doings(&plan.actions)).count();
        if let Some(last) = found.last() {
            let metrics = crate::plan::Metrics {
                duration_s: last.duration,
                duration_synchronous_s: last.duration,
                arc_length: last.arc_length,
                actions: last.actions.len(),
                steps: last.steps,
                ..plan.metrics.clone()
            };
            let (arms, actions) = (last.trajectories(), last.actions.clone());
            let verdict = verify(&problem, &Plan { arms, actions, metrics, ..plan.clone() });
            assert!(verdict.valid, "{}: {:?}", family.name(), verdict.first);
        }
    }
    assert!(kept > 0, "windows of the plans are planned again");
}

#[test]
fn what_begins_from_a_plan_is_never_worse() {
    let (mut problem, plan) = with_first_plan(Family::Switch, 2, 2);
    problem.options.max_iterations = Some(60);
    let objective = problem.options.objective;
    let mut costs = vec![plan.metrics.cost(objective)];
    let cache = PlannerCache::new(0);
    let mut observe = |event: PlannerEvent<'_>| {
        if let PlannerEvent::Incumbent(found) = event {
            assert_eq!(found.revision, plan.revision + costs.len() as u64);
            costs.push(found.metrics.cost(objective));
        }
    };
    let outcome = improve_with(&cache, &problem, &plan, &Control::unbounded(), &mut observe);
    assert!(costs.len() > 1, "sixty iterations make it better");
    assert!(costs.windows(2).all(|pair| pair[1] < pair[0]), "{costs:?}");
    assert_eq!(outcome.best.map(|best| best.metrics.cost(objective)).as_ref(), costs.last());
    // With nothing left to spend the plan is what comes out.
    problem.options.max_iterations = Some(0);
    let outcome = improve_with(&cache, &problem, &plan, &Control::unbounded(), &mut |_| {});
    assert_eq!(outcome.best.as_ref(), Some(&plan));
}

#[test]
fn a_plan_without_rests_between_its_steps_is_a_bound_alone() {
    let (problem, mut plan) = with_first_plan(Family::Switch, 2, 2);
    let first = plan.actions[0].t;
    for action in plan.actions.iter_mut().filter(|action| action.step == 1) {
        action.t = first + 0.2;
    }
    let (answer, found) = resumed(&problem, &plan, 3);
    assert_eq!(answer, Err(NotResumed::Moving(1)));
    // The tree was left as it was: the search begins anew.
    assert!(found.iter().all(|candidate| !candidate.actions.is_empty()));
    plan.actions.clear();
    assert_eq!(resumed(&problem, &plan, 0).0, Err(NotResumed::NoSteps));
}

#[test]
fn threads_go_on_from_each_others_plans() {
    let mut problem = random_2x2(4);
    problem.options.max_iterations = Some(400);
    problem.options.threads = 2;
    let mut found: Vec<Plan> = Vec::new();
    let mut judged = (0, 0);
    let outcome =
        plan_with(&PlannerCache::new(0), &problem, &Control::unbounded(), &mut |event| match event {
            PlannerEvent::Incumbent(plan) => found.push(plan.clone()),
            PlannerEvent::Judged { valid, .. } => {
                judged.0 += 1;
                judged.1 += usize::from(valid);
            }
            PlannerEvent::Progress { .. } => {}
        });
    assert!(found.len() > 2, "{:?}", outcome.diagnosis);
    assert_eq!(judged.0, judged.1, "a plan that the judge rejects");
    for pair in found.windows(2) {
        let [before, after] = pair else { unreachable!() };
        assert_eq!(after.revision, before.revision + 1);
        let cost = |plan: &Plan| plan.metrics.cost(problem.options.objective);
        assert!(cost(after) < cost(before));
    }
    for plan in &found {
        assert!(verify(&problem, plan).valid);
    }
    // A search that never had a plan of its own goes on from one of another.
    let goal = found.last().unwrap();
    let (answer, better) = resumed(&problem, goal, 300);
    assert_eq!(answer, Ok(()));
    for candidate in better {
        let objective = problem.options.objective;
        assert!(candidate.cost(objective) < goal.metrics.cost(objective));
    }
}

/// The thorough look after the first plan promises a way with a step less, on which two arms would have to be where there
/// is room for one.
#[test]
fn the_optimum_is_that_of_a_graph_that_knows_what_does_not_go_together() {
    let text = include_str!("../../scenarios/switch/4x4.json");
    let document = serde_json::from_str(text).unwrap();
    let mut problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
    problem.options.time_budget_s = 600.0;
    let control = Control::unbounded();
    let world = CollisionWorld::new(&problem);
    let seed = Seed(problem.options.seed);
    let mut reach = SampledReach::new(&problem, &world, seed);
    let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &control);
    assert!(graph.crowdings.is_empty());
    let settled = settled_mode_graph(&problem, &world, graph, reach, seed, &control);
    assert!(!settled.crowdings.is_empty());
    for threads in [1, 2] {
        problem.options.threads = threads;
        problem.options.max_iterations = Some(60);
        let mut last = None;
        plan_with(&PlannerCache::new(0), &problem, &control, &mut |event| {
            if let PlannerEvent::Incumbent(plan) = event {
                assert!(verify(&problem, plan).valid);
                last = Some(plan.metrics.clone());
            }
        });
        let last = last.unwrap();
        // Another thread's plan may come while the first one changes the graph, and says nothing of the optimum then.
        let optimum = last.mode_graph_optimum.or((threads > 1).then_some(6));
        assert_eq!((last.steps, optimum), (6, Some(6)));
    }
}
