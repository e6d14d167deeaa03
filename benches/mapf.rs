#![allow(missing_docs)]

//! Guidance on mode graphs: the paper's switch with shared regions, refined instances as a planner
//! makes them, and the baselines' cost per step.

use criterion::{Criterion, criterion_group, criterion_main};
use quadrille::collision::CollisionWorld;
use quadrille::guidance::Answer;
use quadrille::guidance::generate::{Grid, derangement};
use quadrille::guidance::{Cuts, Effort, Instance, Network, solve};
use quadrille::mode_graph::{ModeGraphOptions, build_mode_graph};
use quadrille::run::{Control, Seed};
use quadrille::scenario::{Family, generate};
use quadrille::transition::SampledReach;
use quadrille::wire::{LibraryOnly, ReadLimits, read_problem_value};
use std::hint::black_box;
use std::time::{Duration, Instant};

fn run(criterion: &mut Criterion, name: &str, instance: Instance, effort: &Effort) {
    let Ok(network) = Network::new(instance) else { return };
    let state = network.instance().start();
    criterion.bench_function(name, |bencher| {
        bencher.iter(|| {
            let control = Control::unbounded();
            solve(&network, black_box(&state), &Cuts::none(), effort, Seed(1), &control)
        });
    });
}

fn grid(depth: usize, lanes: usize) -> Grid {
    Grid { depth, lanes, diagonals: true }
}

fn switches(criterion: &mut Criterion) {
    for (depth, lanes, objects) in [(2, 1, 2), (2, 2, 4), (3, 3, 4), (3, 3, 9), (3, 3, 20), (4, 4, 32)] {
        let name = format!("switch/{}x{objects}", depth * lanes);
        run(criterion, &name, grid(depth, lanes).switch(objects), &Effort::quick());
    }
}

fn swaps(criterion: &mut Criterion) {
    for (arms, objects) in [(1, 2), (3, 2), (1, 4), (2, 6)] {
        let name = format!("derangement/{arms}x{objects}");
        run(criterion, &name, derangement(arms, objects), &Effort::quick());
    }
}

fn refined(criterion: &mut Criterion) {
    for (depth, lanes, objects) in [(2, 1, 2), (2, 2, 4), (3, 2, 4), (3, 3, 4), (3, 3, 20), (4, 4, 50)] {
        for seed in 0..3 {
            let instance = grid(depth, lanes).refined(objects, &mut Seed(seed).stream("bench"));
            let name = format!("refined/{}x{objects}/{seed}", depth * lanes);
            run(criterion, &name, instance, &Effort::quick());
        }
    }
}

/// The instance that the planner solves for a generated problem.
fn generated(arms: usize, objects: usize, seed: u64) -> Option<Instance> {
    let document = generate(Family::Random, arms, objects, seed).ok()?;
    let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).ok()?.problem;
    let world = CollisionWorld::new(&problem);
    let mut reach = SampledReach::new(&problem, &world, Seed(seed));
    let control = Control::unbounded();
    Some(Instance::from(&build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &control)))
}

/// Prints how many of 20 generated problems of each size are proved within 2 s, with what gap in the
/// others, and measures the first of them.
fn scenarios(criterion: &mut Criterion) {
    for (arms, objects) in [(9, 4), (9, 20), (16, 50)] {
        let instances: Vec<Instance> = (0..20).filter_map(|seed| generated(arms, objects, seed)).collect();
        let (mut proved, mut gap, mut times) = (0, 0, Vec::new());
        for instance in &instances {
            let Ok(network) = Network::new(instance.clone()) else { continue };
            let control = Control::with_budget(Duration::from_secs(2));
            let began = Instant::now();
            let start = instance.start();
            let answer = solve(&network, &start, &Cuts::none(), &Effort::thorough(), Seed(1), &control);
            times.push(began.elapsed());
            if let Ok(Answer::Solved(_, certificate)) = answer {
                proved += usize::from(certificate.optimum.is_some());
                gap = gap.max(certificate.steps - certificate.lower_bound);
            }
        }
        times.sort();
        let median = times.get(times.len() / 2).copied().unwrap_or_default();
        println!("generated/{arms}x{objects}: {proved}/20 proved, greatest gap {gap}, median {median:?}");
        if let Some(instance) = instances.into_iter().next() {
            run(criterion, &format!("generated/{arms}x{objects}"), instance, &Effort::quick());
        }
    }
}

fn compiling(criterion: &mut Criterion) {
    let instance = grid(3, 3).refined(20, &mut Seed(0).stream("bench"));
    criterion.bench_function("network/9x20", |bencher| {
        bencher.iter(|| Network::new(black_box(instance.clone())));
    });
}

criterion_group! {
    name = mapf;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = switches, swaps, refined, scenarios, compiling
}
criterion_main!(mapf);
