//! The planner's collision checks: single configurations in batches, straight joint edges and
//! timed curves, each certified continuously.
//!
//! Every body is a union of atoms: convex pieces with a cheap core (a capsule or a box that
//! encloses the piece) and its exact shape. The core decides when it can; where it reports less
//! than the clearance that is asked for and is not exact itself, parry decides. What may touch is
//! FORMAT.md, "What may touch": static exemptions come compiled in the workcell, dynamic ones with
//! each query.
//!
//! The decision rule for a moving pair: at the middle of an interval its distance must exceed the
//! clearance by the most that both bodies can move in the remaining half; otherwise the interval
//! is halved, until the motion bound falls below 0.1 mm.
//!
//! This room knows no plans, modes or trees.

mod arm_bodies;
mod atom;
mod certify;
mod cylinder_box;
mod cylinder_capsule;
mod hand;
mod held;
mod inverse;
mod lanes;
#[cfg(test)]
mod reference;
mod scene;
mod segment_distance;
mod sweep;
mod world;

pub use arm_bodies::ArmBodies;
pub use atom::Atom;
pub use certify::{JointMotion, PathMotion, StraightMotion};
pub use lanes::{CubicRow, Cubics, Samples};
pub use scene::{Exemption, Held, Scene};
pub use sweep::Swept;
pub use world::{CollisionWorld, Resting, Taking};

/// The name of the instructions that checks run on: others may round otherwise.
pub fn instructions() -> &'static str {
    crate::geometry::lanes::InstructionSet::best().name()
}

/// Motion bound (m) below which a pair that is still not certified counts as blocked.
pub const UNDECIDED_MOTION: f64 = 1.0e-4;
