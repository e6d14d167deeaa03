//! Forward and inverse kinematics of the library's arms.

// The macros of criterion make public functions without documentation.
#![allow(missing_docs)]

use std::collections::BTreeMap;
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use quadrille::geometry::Pose;
use quadrille::kinematics::{ArmModel, Config, JointLimits, NoMeshes, library, library_names};
use quadrille::run::{Rng, Seed};
use rand::Rng as _;

fn load(name: &str) -> ArmModel {
    let robot = library(name).expect("a library robot");
    let loaded = ArmModel::from_urdf(name, robot.urdf, "flange", &BTreeMap::new(), &NoMeshes);
    loaded.expect("a good URDF").0
}

/// Poses that random configurations within the limits reach, with these configurations.
fn targets(model: &ArmModel, limits: &[JointLimits], rng: &mut Rng) -> Vec<(Pose, Config)> {
    (0..256)
        .map(|_| {
            let q: Config = limits
                .iter()
                .map(|l| l.lower.max(-3.1) + rng.random::<f64>() * (l.upper.min(3.1) - l.lower.max(-3.1)))
                .collect();
            (model.mount_pose(&q), q)
        })
        .collect()
}

fn kinematics(criterion: &mut Criterion) {
    for name in library_names() {
        let model = load(name);
        let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
        let mut rng = Seed(1).stream("bench");
        let targets = targets(&model, &limits, &mut rng);
        let mut next = targets.iter().cycle();
        let mut poses = Vec::new();
        criterion.bench_function(&format!("{name}/link_poses"), |b| {
            b.iter(|| next.next().map(|(_, q)| model.link_poses(black_box(q), &mut poses)))
        });
        criterion.bench_function(&format!("{name}/mount_pose"), |b| {
            b.iter(|| next.next().map(|(_, q)| model.mount_pose(black_box(q))))
        });
        criterion.bench_function(&format!("{name}/jacobian"), |b| {
            b.iter(|| next.next().map(|(_, q)| model.jacobian(black_box(q))))
        });
        let mut found = Vec::new();
        criterion.bench_function(&format!("{name}/inverse, 5 solutions"), |b| {
            b.iter(|| next.next().map(|(target, _)| model.inverse(&limits, target, 5, &mut rng, &mut found)))
        });
        let step = vec![0.02; model.dof()];
        criterion.bench_function(&format!("{name}/inverse_near"), |b| {
            b.iter(|| {
                next.next().map(|(target, q)| {
                    let seed: Config = q.iter().zip(&step).map(|(q, d)| q + d).collect();
                    model.inverse_near(&limits, target, &seed, 1.0)
                })
            })
        });
        let weights = vec![1.0; model.dof()];
        criterion.bench_function(&format!("{name}/inverse_closest"), |b| {
            b.iter(|| {
                let reference = vec![0.3; weights.len()];
                next.next().map(|(target, _)| model.inverse_closest(&limits, target, &reference, &weights))
            })
        });
    }
}

criterion_group!(benches, kinematics);
criterion_main!(benches);
