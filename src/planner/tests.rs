//! What a cache may and may not change.

use std::sync::Arc;

use super::{PlannerCache, PlannerEvent, plan_with};
use crate::plan::Plan;
use crate::problem::Problem;
use crate::run::{CancelToken, Control, Deadline};
use crate::scenario::{Family, generate};
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

fn random_2x2(seed: u64) -> Problem {
    let document = generate(Family::Random, 2, 2, seed).unwrap();
    let mut problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
    problem.options.max_iterations = Some(40);
    problem.options.time_budget_s = 600.0;
    problem
}

/// All incumbents of a run, but for when they were found.
fn plans(cache: &PlannerCache, problem: &Problem) -> Vec<String> {
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
    cache.get(&random_2x2(1), &Control { deadline: Deadline::never(), cancel });
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
