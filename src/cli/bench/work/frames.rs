//! Forward kinematics.

use std::hint::black_box;

use rand::Rng as _;

use super::{limits, model, random_config};
use crate::geometry::Pose;
use crate::geometry::lanes::{Float8, InstructionSet, Kernel};
use crate::kinematics::{ArmModel, Config, Frames8, MovingFrames};
use crate::run::Rng;

/// Batches of eight.
const BLOCKS: usize = 32;

struct Forward<'a>(&'a MovingFrames, &'a [[[f32; 8]; 7]]);

impl Kernel for Forward<'_> {
    type Output = f32;
    #[inline(always)]
    fn run<F: Float8>(self) -> f32 {
        let mut frames = Frames8::<F>::new();
        let mut sum = F::splat(0.0);
        for q in self.1 {
            self.0.place(q, &mut frames);
            if let Some(last) = frames.last() {
                sum = sum + last.origin[0];
            }
        }
        sum.store()[0]
    }
}

/// All frames of the iiwa14, in lanes and in double precision.
#[derive(Debug)]
pub struct Frames {
    set: InstructionSet,
    model: ArmModel,
    frames: MovingFrames,
    batches: Vec<[[f32; 8]; 7]>,
    q: Config,
    poses: Vec<Pose>,
}

impl Frames {
    /// How many configurations a call of [`Self::place`] works on.
    pub const CONFIGURATIONS: usize = 8 * BLOCKS;

    /// Draws the configurations; `None` without the robot.
    pub fn new(rng: &mut Rng) -> Option<Self> {
        let model = model("iiwa14")?;
        let frames = MovingFrames::new(&model, &Pose::identity());
        let batches =
            (0..BLOCKS).map(|_| [0; 7].map(|_| [0; 8].map(|_| rng.random_range(-2.0..2.0_f32)))).collect();
        let q = random_config(&limits(&model), rng);
        Some(Self { set: InstructionSet::best(), model, frames, batches, q, poses: Vec::new() })
    }

    /// In lanes.
    pub fn place(&self) -> f32 {
        self.set.run(Forward(black_box(&self.frames), black_box(&self.batches)))
    }

    /// One configuration in double precision.
    pub fn link_poses(&mut self) {
        self.model.link_poses(black_box(&self.q), &mut self.poses);
    }
}
