//! Inverse kinematics.

use std::hint::black_box;

use super::{limits, model, random_config};
use crate::geometry::Pose;
use crate::kinematics::{ArmModel, Config, JointLimits};
use crate::run::Rng;

/// Targets that random configurations of one robot reach.
#[derive(Debug)]
pub struct Inverse {
    model: ArmModel,
    limits: Vec<JointLimits>,
    targets: Vec<Pose>,
    most: usize,
    rng: Rng,
    found: Vec<Config>,
}

impl Inverse {
    /// How many targets a call works on.
    pub const TARGETS: usize = 64;

    /// For the library's robot `name`, with at most `most` solutions asked for; `None` without it.
    pub fn new(name: &str, most: usize, rng: &mut Rng) -> Option<Self> {
        let model = model(name)?;
        let limits = limits(&model);
        let targets = (0..Self::TARGETS).map(|_| model.mount_pose(&random_config(&limits, rng))).collect();
        Some(Self { model, limits, targets, most, rng: rng.clone(), found: Vec::new() })
    }

    /// Solves for every target; how many solutions there were.
    pub fn solve(&mut self) -> usize {
        let mut count = 0;
        for target in &self.targets {
            let (rng, found) = (&mut self.rng, &mut self.found);
            self.model.inverse(&self.limits, black_box(target), self.most, rng, found);
            count += found.len();
        }
        count
    }
}
