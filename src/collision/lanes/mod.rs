//! The hot path: the same checks as the exact ones, eight instants at a time in single precision,
//! coarse before fine.
//!
//! An edge is cut in eight; in the middle of each piece every pair must be farther apart than the
//! clearance and the most that both can move in half a piece. What is not, is cut again, with only the
//! pairs that are still open. Single precision errs by less than the inflation that is
//! added to what is asked; where that or an enclosing core leaves the answer open, the exact
//! shapes decide.

mod arm;
mod broad;
mod certify;
mod core;
mod cubics;
mod ensemble;
mod exact;
mod impossible;
mod limb;
mod mover;
mod narrow;
mod place;
mod safe;
mod sweep;
mod tight;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod together_tests;

pub(super) use arm::LaneArm;
pub(super) use certify::{Answers, Apart, Configurations, Motions, PairsApart, cut_in_eight, eighths};
pub(super) use core::{LaneStatic, StaticBlock};
pub use cubics::{CubicRow, Cubics};
pub(super) use ensemble::Ensemble;
pub use mover::Samples;
pub(super) use mover::{LaneHeld, LaneMover};
pub(super) use sweep::{BATCH, LaneSweep, Near, Sweep};
