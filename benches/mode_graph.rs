#![allow(missing_docs)]

//! From a problem to its mode graph, on a workcell that was never seen and on one that was, and what
//! else stands before the search: bodies and roadmaps.

use criterion::{Criterion, criterion_group, criterion_main};
use quadrille::collision::CollisionWorld;
use quadrille::mode_graph::{ModeGraphOptions, build_mode_graph, optimistic_mode_graph};
use quadrille::motion::first_roadmaps;
use quadrille::problem::Problem;
use quadrille::run::{Control, Seed};
use quadrille::scenario::{Family, generate};
use quadrille::transition::{ReachMemory, SampledReach};
use quadrille::wire::{LibraryOnly, ReadLimits, read_problem_value};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

fn problem(arms: usize, objects: usize, seed: u64) -> Option<Problem> {
    let document = generate(Family::Random, arms, objects, seed).ok()?;
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).ok().map(|read| read.problem)
}

fn build(problem: &Problem, memory: Arc<ReachMemory>) -> usize {
    let world = CollisionWorld::new(problem);
    let mut reach = SampledReach::remembering(problem, &world, Seed(0), memory);
    build_mode_graph(problem, &mut reach, &ModeGraphOptions::planning(), &Control::unbounded()).edges.len()
}

fn modes(criterion: &mut Criterion) {
    for (arms, objects) in [(2, 2), (4, 4), (6, 4), (9, 4), (9, 20), (16, 50)] {
        let (Some(first), Some(second)) = (problem(arms, objects, 0), problem(arms, objects, 1)) else {
            continue;
        };
        let name = format!("{arms}x{objects}");
        criterion.bench_function(&format!("mode_graph/new/{name}"), |bencher| {
            bencher.iter(|| build(black_box(&first), Arc::default()));
        });
        // Another arrangement was planned before; each round plans one that was not.
        criterion.bench_function(&format!("mode_graph/known/{name}"), |bencher| {
            bencher.iter_batched(
                || {
                    let memory = Arc::<ReachMemory>::default();
                    build(&second, memory.clone());
                    memory
                },
                |memory| build(black_box(&first), memory),
                criterion::BatchSize::PerIteration,
            );
        });
        criterion.bench_function(&format!("optimistic_graph/{name}"), |bencher| {
            bencher.iter(|| optimistic_mode_graph(black_box(&first)));
        });
        criterion.bench_function(&format!("collision_world/{name}"), |bencher| {
            bencher.iter(|| CollisionWorld::new(black_box(&first)));
        });
        let world = CollisionWorld::new(&first);
        criterion.bench_function(&format!("first_roadmaps/{name}"), |bencher| {
            bencher.iter(|| first_roadmaps(&first.workcell, &world, 1, &Control::unbounded()));
        });
    }
}

criterion_group! {
    name = mode_graph;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1));
    targets = modes
}
criterion_main!(mode_graph);
