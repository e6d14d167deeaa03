//! Timing of a joint polyline from rest to rest.

use crate::kinematics::{Config, JointLimits};

use super::corners::corner_speeds;
use super::curve::{Curve, CurvePoint};
use super::polyline::Polyline;
use super::profile::phases;

/// Why a path cannot be timed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TimingError {
    /// The path has no waypoint.
    #[error("a path needs at least one waypoint")]
    Empty,
    /// There is not one tolerance for each waypoint.
    #[error("{waypoints} waypoints with {tolerances} corner tolerances")]
    Tolerances {
        /// Number of waypoints.
        waypoints: usize,
        /// Number of tolerances.
        tolerances: usize,
    },
    /// A waypoint has another number of joints than there are limits, or is not finite.
    #[error("waypoint {index} has another number of joints than there are limits, or is not finite")]
    Waypoint {
        /// The waypoint.
        index: usize,
    },
    /// A velocity or acceleration limit is not positive and finite.
    #[error("joint {joint} has no positive velocity and acceleration limit")]
    Limit {
        /// The joint.
        joint: usize,
    },
}

/// Times the polyline `path` from rest at its first to rest at its last waypoint.
///
/// Straight joint segments under trapezoidal speed, with a parabolic blend at each inner waypoint
/// that deviates from the polyline by at most `corner_tolerance` there in any joint (rad or m; one
/// entry per waypoint, those of the first and last are not looked at; 0: stop there, exactly on
/// it). Waypoints at reversals are stops. Velocities and accelerations keep to `limits` (position
/// limits are not looked at); all breakpoints are at least
/// [`MIN_SPACING_S`](super::MIN_SPACING_S) apart, whatever the path. Waypoints on a straight line
/// (within a quarter of their tolerance) cost nothing.
///
/// The path may be of several arms side by side: one clock then moves all joints along it.
/// A path of one waypoint, or of equal ones, gives a curve of a single point.
///
/// # Errors
/// [`TimingError`] when the arguments do not fit together.
pub fn time_path(
    path: &[Config],
    corner_tolerance: &[f64],
    limits: &[JointLimits],
) -> Result<Curve, TimingError> {
    check(path, corner_tolerance, limits)?;
    let line = Polyline::new(path, corner_tolerance, limits);
    let corners = corner_speeds(&line, limits);
    let still = || -> Config { limits.iter().map(|_| 0.0).collect() };
    let mut points = Vec::with_capacity(1 + 4 * line.pieces.len());
    points.push(CurvePoint { t: 0.0, q: path[line.waypoints[0]].clone(), qd: still() });
    let mut t = 0.0;
    for (index, piece) in line.pieces.iter().enumerate() {
        let (from, to) = (&corners[index], &corners[index + 1]);
        let (start, end) = (&path[line.waypoints[index]], &path[line.waypoints[index + 1]]);
        let rest = piece.length - from.after() - to.before();
        let along = phases(from.exit, to.entry, rest, piece.along);
        let (mut at, mut speed) = (from.after(), from.exit);
        for (number, phase) in along.iter().enumerate() {
            t += phase.duration;
            at += 0.5 * (speed + phase.end_speed) * phase.duration;
            speed = phase.end_speed;
            // From the waypoint that is nearer, so that ends of pieces are exact.
            let back = if number + 1 == along.len() { to.before() } else { piece.length - at };
            let place = |((a, b), d): ((&f64, &f64), &f64)| {
                if at < back { a + d * at } else { b - d * back }
            };
            let q = start.iter().zip(end).zip(&piece.direction).map(place).collect();
            points.push(CurvePoint { t, q, qd: piece.direction.iter().map(|d| d * speed).collect() });
        }
        if to.time > 0.0 {
            let next = &line.pieces[index + 1].direction;
            t += to.time;
            let q = end.iter().zip(next).map(|(b, d)| b + d * to.after()).collect();
            points.push(CurvePoint { t, q, qd: next.iter().map(|d| d * to.exit).collect() });
        }
    }
    Ok(Curve::from_trusted(points))
}

fn check(path: &[Config], corner_tolerance: &[f64], limits: &[JointLimits]) -> Result<(), TimingError> {
    if path.is_empty() {
        return Err(TimingError::Empty);
    }
    if path.len() != corner_tolerance.len() {
        return Err(TimingError::Tolerances { waypoints: path.len(), tolerances: corner_tolerance.len() });
    }
    let bad = |x: f64| !(x > 0.0 && x.is_finite());
    if let Some(joint) = limits.iter().position(|l| bad(l.velocity) || bad(l.acceleration)) {
        return Err(TimingError::Limit { joint });
    }
    let wrong = |q: &Config| q.len() != limits.len() || q.iter().any(|x| !x.is_finite());
    match path.iter().position(wrong) {
        Some(index) => Err(TimingError::Waypoint { index }),
        None => Ok(()),
    }
}
