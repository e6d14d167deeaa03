//! Poses and shapes, and exact distances between them.
//!
//! Units are metres and radians; frames are right-handed with z up. This room knows nothing of
//! robots, problems or plans.

mod distance;
pub mod lanes;
mod pose;
mod shape;

pub use distance::{ExactShape, Overlap};
pub use pose::{Pose, Vec3, pose_from_parts};
pub use shape::{ConvexHull, PlacedShape, Shape, ShapeError};
