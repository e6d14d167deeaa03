//! Inverse kinematics in batches, with the arms' limits and the collision filter.

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::run::Rng;
use crate::workcell::ArmId;

use super::scene::{Exemption, Held, Scene};
use super::world::CollisionWorld;

impl CollisionWorld {
    /// For each of `targets`, poses of the TCP of `arm` in the world, up to `most` configurations within the arm's
    /// limits that bring it there, less those at which the arm is not free: against itself, obstacles, resting
    /// objects, its held object included. `rng` chooses where a redundant arm is free to.
    ///
    /// By whatever closed form the arm has, else numerically ([`crate::kinematics::ArmModel::inverse_method`]).
    /// The configurations of all targets go through the lanes together.
    pub fn inverse_free(
        &self,
        arm: ArmId,
        (targets, most): (&[Pose], usize),
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
        rng: &mut Rng,
    ) -> Vec<Vec<Config>> {
        let it = &self.workcell.arms[arm.0];
        let (to_base, to_mount) = (it.base.inverse(), it.tool.tcp.inverse());
        let mut solutions = vec![Vec::new(); targets.len()];
        for (target, found) in targets.iter().zip(&mut solutions) {
            it.inverse(&(to_base * target * to_mount), most, rng, found);
        }
        let all: Vec<&[f64]> = solutions.iter().flatten().map(|q| &q[..]).collect();
        let mut free = self.configs_free(arm, &all, held, scene, exemption).into_iter();
        for found in &mut solutions {
            found.retain(|_| free.next().unwrap_or(false));
        }
        solutions
    }
}
