//! Joint motions over time: curves, their bounds, and the timing of polylines under velocity and
//! acceleration limits.
//!
//! A [`Curve`] is what is certified and emitted: cubic Hermite by (q, qd) between its points. All
//! that this room makes is piecewise quadratic with a point at every break, which the Hermite form
//! reproduces exactly. [`time_path`] times a polyline: straight joint segments with parabolic
//! blends at the corners (after Kunz and Stilman, "Turning paths into trajectories using parabolic
//! blends", 2011), with free speeds on either side of a blend.
//!
//! This room must not know arms, scenes or collisions: whoever blends corners checks the result.

mod bounds;
mod corners;
mod curve;
mod hermite;
mod limits;
mod polyline;
mod profile;
mod table;
mod time_path;

pub use curve::{Curve, CurveError, CurvePoint, MIN_SPACING_S};
pub use limits::{LimitKind, LimitViolation};
pub use profile::minimum_time;
pub use table::{CurveTable, TableRow};
pub use time_path::{TimingError, time_path};

#[cfg(test)]
mod tests;
