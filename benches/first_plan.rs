#![allow(missing_docs)]

//! From a problem to its first judged plan at the paper's sizes, on a workcell that is new and on one
//! that was planned on before.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use quadrille::cli::work::shipped;
use quadrille::planner::{PlannerCache, plan_with};
use quadrille::problem::Problem;
use quadrille::run::Control;
use quadrille::scenario::{Family, generate};
use quadrille::wire::{LibraryOnly, ReadLimits, read_problem_value};
use std::hint::black_box;
use std::time::Duration;

fn first_plan(cache: &PlannerCache, problem: &Problem) -> bool {
    let control = Control::with_budget(Duration::from_secs(60));
    plan_with(cache, problem, &control, &mut |_| {}).best.is_some()
}

/// Another arrangement on the workcell of the shipped scenario.
fn another(family: Family, arms: usize, objects: usize) -> Option<Problem> {
    let document = generate(family, arms, objects, 7).ok()?;
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).ok().map(|read| read.problem)
}

fn plans(criterion: &mut Criterion) {
    let families =
        [("switch", Family::Switch), ("side_to_side", Family::SideToSide), ("random", Family::Random)];
    for (name, family) in families {
        for (arms, objects) in [(2, 2), (4, 4), (6, 4), (9, 4)] {
            let name = format!("{name}/{arms}x{objects}");
            let (Some(mut problem), Some(mut before)) = (shipped(&name), another(family, arms, objects))
            else {
                continue;
            };
            problem.options.stop.first_solution = true;
            before.options.stop.first_solution = true;
            criterion.bench_function(&format!("first_plan/new/{name}"), |bencher| {
                bencher.iter(|| first_plan(&PlannerCache::new(0), black_box(&problem)));
            });
            criterion.bench_function(&format!("first_plan/known/{name}"), |bencher| {
                bencher.iter_batched(
                    || {
                        let cache = PlannerCache::default();
                        first_plan(&cache, &before);
                        cache
                    },
                    |cache| first_plan(&cache, black_box(&problem)),
                    BatchSize::PerIteration,
                );
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(100))
        .measurement_time(Duration::from_secs(2));
    targets = plans
}
criterion_main!(benches);
