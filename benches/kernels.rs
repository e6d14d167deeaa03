#![allow(missing_docs)]

//! The planner's kernels on the work of `quadrille bench kernels`, with parry beside them where it can do
//! the same: forward kinematics, pairs of shapes, one arm, two arms, nine arms, edges, inverse
//! kinematics, and a known workcell made ready.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use quadrille::cli::work::{Frames, Inverse, KnownWorkcell, ManyArms, Narrow, OneArm};
use quadrille::run::Seed;
use std::hint::black_box;
use std::time::Duration;

fn measure<T>(criterion: &mut Criterion, name: &str, count: usize, mut work: impl FnMut() -> T) {
    let mut group = criterion.benchmark_group(name.split('/').next().unwrap_or(name));
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function(name.split_once('/').map_or(name, |(_, rest)| rest), |bencher| {
        bencher.iter(|| black_box(work()));
    });
    group.finish();
}

fn kernels(criterion: &mut Criterion) {
    let mut rng = Seed(1).stream("bench/kernels");
    let pairs = Narrow::new(&mut rng);
    measure(criterion, "capsule_capsule/lanes", Narrow::PAIRS, || pairs.capsule_capsule());
    measure(criterion, "capsule_capsule/parry", Narrow::PAIRS, || pairs.capsule_capsule_by_parry());
    measure(criterion, "capsule_box/lanes", Narrow::PAIRS, || pairs.capsule_box());
    measure(criterion, "capsule_box/parry", Narrow::PAIRS, || pairs.capsule_box_by_parry());
    if let Some(mut frames) = Frames::new(&mut rng) {
        measure(criterion, "frames/lanes", Frames::CONFIGURATIONS, || frames.place());
        measure(criterion, "frames/in f64", 1, || frames.link_poses());
    }
    if let Some(arm) = OneArm::new(&mut rng) {
        measure(criterion, "one_arm/random", OneArm::CONFIGURATIONS, || arm.random());
        measure(criterion, "one_arm/random by parry", OneArm::CONFIGURATIONS, || arm.random_by_parry());
        measure(criterion, "one_arm/along edges", OneArm::CONFIGURATIONS, || arm.along());
        measure(criterion, "one_arm/along edges by parry", OneArm::CONFIGURATIONS, || arm.along_by_parry());
        measure(criterion, "one_arm/edge certified", OneArm::EDGES, || arm.certified());
        measure(criterion, "one_arm/inverse, free", OneArm::TARGETS, || arm.inverse(&mut rng));
    }
    if let Some(arms) = ManyArms::new(&mut rng) {
        measure(criterion, "two_arms/edge certified", ManyArms::EDGES, || arms.pair());
        measure(criterion, "nine_arms/edge certified", ManyArms::EDGES, || arms.all());
    }
    for (robot, most) in [("iiwa14", 5), ("ur_type", 8), ("panda_type", 5)] {
        if let Some(mut targets) = Inverse::new(robot, most, &mut rng) {
            measure(criterion, &format!("inverse/{robot}"), Inverse::TARGETS, || targets.solve());
        }
    }
    if let Some(known) = KnownWorkcell::new("switch/9x4") {
        measure(criterion, "known_workcell/nine arms", 1, || known.ready());
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = kernels
}
criterion_main!(benches);
