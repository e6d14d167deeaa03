//! Inverse kinematics: closed form where the structure allows it, numeric for any other chain.
//!
//! Which solver an arm gets is decided once, from the geometry of its axes.

mod angles;
mod arctangent;
mod euler;
mod numeric;
mod offset_seven;
mod redundant;
mod six;
mod spherical_seven;
mod subproblems;

use super::chain::Chain;
use super::{ArmModel, Config, JointLimits};
use crate::geometry::Pose;
use crate::run::{Rng, Seed};
pub(super) use angles::fit;
use numeric::Descent;
use offset_seven::OffsetSeven;
use six::SixAxes;
use spherical_seven::SphericalSeven;

/// The solver for an arm's structure.
#[derive(Debug, Clone)]
pub(super) struct Solver(Structure);

#[derive(Debug, Clone)]
enum Structure {
    /// Spherical shoulder, revolute elbow, spherical wrist.
    SphericalSeven(Box<SphericalSeven>),
    /// Spherical shoulder, revolute elbow, the last axis beside the point where the two before meet.
    OffsetSeven(Box<OffsetSeven>),
    /// Six joints, with a spherical wrist or like the UR arms.
    Six(Box<SixAxes>),
    /// Any other chain.
    Other,
}

impl Solver {
    /// The solver for `chain`.
    pub fn new(chain: &Chain) -> Self {
        let seven = || SphericalSeven::detect(chain).map(|seven| Structure::SphericalSeven(Box::new(seven)));
        let offset = || OffsetSeven::detect(chain).map(|seven| Structure::OffsetSeven(Box::new(seven)));
        let six = || SixAxes::detect(chain).map(|six| Structure::Six(Box::new(six)));
        Self(seven().or_else(offset).or_else(six).unwrap_or(Structure::Other))
    }
}

/// Which method [`ArmModel::inverse`] uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InverseMethod {
    /// Closed form for 7R arms with spherical shoulder and wrist.
    SphericalSeven,
    /// Closed form for 7R arms with a spherical shoulder, given the last joint (Franka Emika's type).
    OffsetSeven,
    /// Closed form for 6R arms with parallel axes 2 and 3 and a spherical wrist.
    SphericalSix,
    /// Closed form for 6R arms with parallel axes 2, 3 and 4 whose last two axes meet (UR type).
    ParallelSix,
    /// Damped least squares with restarts.
    Numeric,
}

impl ArmModel {
    /// The method of inverse kinematics that the arm's structure allows.
    pub fn inverse_method(&self) -> InverseMethod {
        match &self.solver.0 {
            Structure::SphericalSeven(_) => InverseMethod::SphericalSeven,
            Structure::OffsetSeven(_) => InverseMethod::OffsetSeven,
            Structure::Six(six) if six.has_spherical_wrist() => InverseMethod::SphericalSix,
            Structure::Six(_) => InverseMethod::ParallelSix,
            Structure::Other => InverseMethod::Numeric,
        }
    }

    /// Writes to `out` (cleared first) up to `max_solutions` different configurations within
    /// `limits` (one per joint) that bring the mount link to `target`, its pose in the root link's
    /// frame. They are spread over the branches and, for redundant arms, over the free motion.
    ///
    /// In closed form an empty result means that there is none, except for
    /// [`InverseMethod::OffsetSeven`], whose last joint is sampled: a narrow range of it may be missed.
    /// Of a joint's values a whole turn apart only the one nearest to 0 is given.
    pub fn inverse(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        max_solutions: usize,
        rng: &mut Rng,
        out: &mut Vec<Config>,
    ) {
        out.clear();
        if max_solutions == 0 || !self.fits(limits, target) {
            return;
        }
        match &self.solver.0 {
            Structure::SphericalSeven(seven) => seven.spread(limits, target, max_solutions, rng, out),
            Structure::OffsetSeven(seven) => seven.spread(limits, target, max_solutions, rng, out),
            Structure::Six(six) => six.spread(limits, target, max_solutions, rng, out),
            Structure::Other => self.descent(limits, target).spread(max_solutions, rng, out),
        }
    }

    /// Whether it is plain at a glance that [`Self::inverse`] finds nothing for `target`: cheap, and `false` says nothing.
    pub fn is_beyond(&self, limits: &[JointLimits], target: &Pose) -> bool {
        match &self.solver.0 {
            Structure::SphericalSeven(seven) => self.fits(limits, target) && seven.is_beyond(limits, target),
            _ => false,
        }
    }

    /// The configuration for `target` that continues from `seed`: same branch, the free motion of
    /// a redundant arm kept, or moved only as much as `limits` ask for. `None` when there is none
    /// with every joint within `max_step` (rad or m) of the seed. For following the TCP's path in
    /// small steps.
    pub fn inverse_near(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        seed: &[f64],
        max_step: f64,
    ) -> Option<Config> {
        if !self.fits(limits, target) || seed.len() != self.dof() {
            return None;
        }
        let q = match &self.solver.0 {
            Structure::SphericalSeven(seven) => {
                return seven.near(limits, target, seed.try_into().ok()?, max_step);
            }
            Structure::OffsetSeven(seven) => {
                return seven.near(&self.descent(limits, target), seed.try_into().ok()?, max_step);
            }
            Structure::Six(six) => six.closest(limits, target, seed.try_into().ok()?, &[1.0; 6])?,
            Structure::Other => {
                let descent = self.descent(limits, target);
                let mut q = descent.from(seed)?;
                descent.unwind(&mut q, seed);
                q
            }
        };
        q.iter().zip(seed).all(|(a, b)| (a - b).abs() <= max_step).then_some(q)
    }

    /// The configuration for `target` with the least distance to `reference`, the square root of
    /// the sum of `weights[j] * (q[j] - reference[j])^2`, over all branches and the free motion of
    /// a redundant arm (by a sweep and refinement; by descents from `reference` and from fixed
    /// pseudo-random starts where there is no closed form).
    pub fn inverse_closest(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        reference: &[f64],
        weights: &[f64],
    ) -> Option<Config> {
        let dof = self.dof();
        if !self.fits(limits, target) || reference.len() != dof || weights.len() != dof {
            return None;
        }
        match &self.solver.0 {
            Structure::SphericalSeven(seven) => {
                seven.closest(limits, target, reference.try_into().ok()?, weights)
            }
            Structure::OffsetSeven(seven) => {
                seven.closest(limits, target, reference.try_into().ok()?, weights)
            }
            Structure::Six(six) => six.closest(limits, target, reference.try_into().ok()?, weights),
            Structure::Other => {
                let mut rng = Seed(0).stream("inverse kinematics");
                self.descent(limits, target).closest(reference, weights, &mut rng)
            }
        }
    }

    fn descent<'a>(&'a self, limits: &'a [JointLimits], target: &'a Pose) -> Descent<'a> {
        Descent { chain: &self.chain, limits, target }
    }

    /// Whether there is one pair of limits per joint, none crossed, and a finite target.
    fn fits(&self, limits: &[JointLimits], target: &Pose) -> bool {
        limits.len() == self.dof()
            && limits.iter().all(|l| l.lower <= l.upper)
            && target.translation.vector.iter().all(|c| c.is_finite())
            && target.rotation.coords.iter().all(|c| c.is_finite())
    }
}

#[cfg(test)]
mod tests;
