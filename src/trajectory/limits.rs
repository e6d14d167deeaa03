//! Joint limits over a whole curve, in closed form.

use crate::kinematics::JointLimits;

use super::Curve;

/// A position may pass its limit by this much (rad or m), FORMAT "Plan".
const POSITION_SLACK: f64 = 1e-6;
/// A velocity may pass its limit by this share of it.
const VELOCITY_SLACK: f64 = 1e-4;
/// An acceleration may pass its limit by this share of it.
const ACCELERATION_SLACK: f64 = 1e-3;

/// Which limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitKind {
    /// Joint value (rad or m).
    Position,
    /// Joint velocity.
    Velocity,
    /// Joint acceleration.
    Acceleration,
}

/// A limit that a curve breaks.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("joint {joint} passes its {kind:?} limit {limit} with {value} after {t} s")]
pub struct LimitViolation {
    /// The joint.
    pub joint: usize,
    /// Which of its limits.
    pub kind: LimitKind,
    /// The start of the segment on which it happens (s).
    pub t: f64,
    /// The value at its worst on that segment.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

impl Curve {
    /// Whether position, velocity and acceleration of every joint stay within `limits` at all
    /// times, with FORMAT's tolerances. Joints beyond the given limits are not looked at.
    ///
    /// # Errors
    /// The first [`LimitViolation`] in time.
    pub fn within_limits(&self, limits: &[JointLimits]) -> Result<(), LimitViolation> {
        if self.segments() == 0 {
            for (joint, (limit, value)) in limits.iter().zip(&self.first().q).enumerate() {
                position(joint, self.start_time(), *value, *value, limit)?;
            }
        }
        for segment in 0..self.segments() {
            let t = self.points()[segment].t;
            for (joint, limit) in limits.iter().enumerate().take(self.joints()) {
                let (cubic, h) = self.cubic(segment, joint);
                let (low, high) = cubic.position_range(0.0, h);
                position(joint, t, low, high, limit)?;
                let speed = cubic.max_speed(0.0, h);
                if exceeds(speed, limit.velocity * (1.0 + VELOCITY_SLACK)) {
                    let kind = LimitKind::Velocity;
                    return Err(LimitViolation { joint, kind, t, value: speed, limit: limit.velocity });
                }
                let acceleration = cubic.max_acceleration(0.0, h);
                if exceeds(acceleration, limit.acceleration * (1.0 + ACCELERATION_SLACK)) {
                    let kind = LimitKind::Acceleration;
                    return Err(LimitViolation {
                        joint,
                        kind,
                        t,
                        value: acceleration,
                        limit: limit.acceleration,
                    });
                }
            }
        }
        Ok(())
    }
}

/// Whether `value` is above `limit`; a NaN on either side counts.
fn exceeds(value: f64, limit: f64) -> bool {
    value > limit || value.is_nan() || limit.is_nan()
}

fn position(joint: usize, t: f64, low: f64, high: f64, limits: &JointLimits) -> Result<(), LimitViolation> {
    let kind = LimitKind::Position;
    if exceeds(limits.lower - POSITION_SLACK, low) {
        return Err(LimitViolation { joint, kind, t, value: low, limit: limits.lower });
    }
    if exceeds(high, limits.upper + POSITION_SLACK) {
        return Err(LimitViolation { joint, kind, t, value: high, limit: limits.upper });
    }
    Ok(())
}
