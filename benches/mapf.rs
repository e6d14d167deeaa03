#![allow(missing_docs)]

//! Guidance on mode graphs: the paper's switch with shared regions, refined instances as a planner
//! makes them, and the baselines' cost per step.

use criterion::{Criterion, criterion_group, criterion_main};
use quadrille::guidance::generate::{Grid, derangement};
use quadrille::guidance::{Cuts, Effort, Instance, Network, solve};
use quadrille::run::{Control, Seed};
use std::hint::black_box;
use std::time::Duration;

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
    targets = switches, swaps, refined, compiling
}
criterion_main!(mapf);
