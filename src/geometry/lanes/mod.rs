//! Eight numbers at a time: the arithmetic of the planner's hot path, in f32.
//!
//! A kernel is written once, generic over [`Float8`], and runs through
//! [`InstructionSet::run`] with what the processor has: AVX2 and FMA, or plain arrays, which
//! compile to SSE2 on x86-64. The first fuses products and sums, the second rounds twice; callers
//! allow for the error of both by an inflation of what they test. The same instruction set always
//! gives the same bits.
//!
//! Kernels and all that they call must be `#[inline(always)]`, so that they are compiled with
//! the features of the place that runs them; so no closures around lanes. `avx2.rs` is one of the
//! crate's files that may be `unsafe`. The judge does not know this module.

mod avx2;
mod box_box;
mod dispatch;
mod float8;
mod portable;
mod segment_box;
mod segment_segment;
mod trigonometry;

#[cfg(test)]
mod tests;

pub use box_box::{Box8, box_box_gap};
pub use dispatch::{InstructionSet, Kernel};
pub use float8::{Bits8, Float8, V3, add3, column_sum, dot3, scale3, splat3, square3, sub3};
pub use portable::Portable;
pub use segment_box::{segment_box_outside, segment_box_squared};
pub use segment_segment::{Segment8, lengths, segment_segment_squared};
pub use trigonometry::sin_cos;
