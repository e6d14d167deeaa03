//! What the kernels' benchmarks work on, drawn from one seed: shared by `quadrille bench kernels` and
//! the crate's own benchmarks. Each fixture does a fixed amount of work per call, ours or the
//! baseline's.

mod arms;
mod frames;
mod inverse;
mod narrow;
mod workcell;

pub use arms::{ManyArms, OneArm};
pub use frames::Frames;
pub use inverse::Inverse;
pub use narrow::Narrow;
pub use workcell::KnownWorkcell;

use std::collections::BTreeMap;

use rand::Rng as _;

use crate::kinematics::{ArmModel, Config, JointLimits, NoMeshes, library};
use crate::problem::Problem;
use crate::run::Rng;
use crate::scenario;
use crate::wire::{Folder, ReadLimits, read_problem};

/// The shipped scenario of this name.
pub fn shipped(name: &str) -> Option<Problem> {
    let entry = scenario::find(name)?;
    let read = read_problem(entry.text.as_bytes(), &Folder::new("."), &ReadLimits::default());
    Some(read.ok()?.problem)
}

/// The library's robot of this name, up to its flange.
pub fn model(name: &str) -> Option<ArmModel> {
    let urdf = library(name)?.urdf;
    Some(ArmModel::from_urdf(name, urdf, "flange", &BTreeMap::new(), &NoMeshes).ok()?.0)
}

fn limits(model: &ArmModel) -> Vec<JointLimits> {
    model.joints.iter().map(|joint| joint.limits).collect()
}

fn random_config(limits: &[JointLimits], rng: &mut Rng) -> Config {
    limits.iter().map(|l| rng.random_range(l.lower.max(-3.1)..l.upper.min(3.1))).collect()
}
