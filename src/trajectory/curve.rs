//! The joint curve that is certified and emitted.

use std::ops::Range;

use crate::kinematics::Config;

use super::hermite::Cubic;

/// Points of an emitted curve are at least this far apart (s), FORMAT "Plan".
pub const MIN_SPACING_S: f64 = 1e-3;

/// Two curves that are joined may differ by this much in position and velocity at the junction.
const JUNCTION: f64 = 1e-9;

/// One breakpoint of a [`Curve`].
#[derive(Debug, Clone, PartialEq)]
pub struct CurvePoint {
    /// Seconds on the curve's own clock.
    pub t: f64,
    /// Joint values (rad or m).
    pub q: Config,
    /// Joint velocities (rad/s or m/s).
    pub qd: Config,
}

/// A joint motion: the cubic Hermite interpolant of its points, of one arm or of several arms'
/// joints side by side.
///
/// Holds at least one point; all points have the same number of joints; times strictly increase.
/// A curve of a single point is a configuration at an instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    points: Vec<CurvePoint>,
}

/// Why points do not make a curve, or two curves not one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// There is no point.
    #[error("a curve needs at least one point")]
    Empty,
    /// A point has another number of joints than the first one.
    #[error("point {index} has another number of joints than the first one")]
    Joints {
        /// The point.
        index: usize,
    },
    /// A time is not after the one before it, or a number is not finite.
    #[error("point {index} is not after the one before it, or not finite")]
    Order {
        /// The point.
        index: usize,
    },
    /// The second curve does not start where and as fast as the first one ends.
    #[error("the curves do not meet: joint {joint} differs by {difference}")]
    Junction {
        /// The joint that differs most.
        joint: usize,
        /// By how much (rad or m, or per second).
        difference: f64,
    },
}

impl Curve {
    /// The curve through `points`.
    ///
    /// # Errors
    /// [`CurveError`] when the points break what [`Curve`] promises.
    pub fn new(points: Vec<CurvePoint>) -> Result<Self, CurveError> {
        let Some(first) = points.first() else { return Err(CurveError::Empty) };
        let joints = first.q.len();
        let mut before = f64::NEG_INFINITY;
        for (index, point) in points.iter().enumerate() {
            if point.q.len() != joints || point.qd.len() != joints {
                return Err(CurveError::Joints { index });
            }
            let finite = point.q.iter().chain(&point.qd).all(|x| x.is_finite());
            if !finite || !point.t.is_finite() || point.t <= before {
                return Err(CurveError::Order { index });
            }
            before = point.t;
        }
        Ok(Self { points })
    }

    /// The curve through points that keep the promise by construction.
    pub(super) fn from_trusted(points: Vec<CurvePoint>) -> Self {
        debug_assert!(!points.is_empty());
        debug_assert!(points.windows(2).all(|w| w[1].t > w[0].t));
        Self { points }
    }

    /// Standing at `q` from 0 to `duration` (s): a single point when that is not positive, and at
    /// least [`MIN_SPACING_S`] otherwise.
    pub fn rest(q: &Config, duration: f64) -> Self {
        let still: Config = q.iter().map(|_| 0.0).collect();
        let mut points = vec![CurvePoint { t: 0.0, q: q.clone(), qd: still.clone() }];
        if duration > 0.0 {
            points.push(CurvePoint { t: duration.max(MIN_SPACING_S), q: q.clone(), qd: still });
        }
        Self { points }
    }

    /// The breakpoints.
    pub fn points(&self) -> &[CurvePoint] {
        &self.points
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.first().q.len()
    }

    /// Whether no joint ever moves.
    pub fn stands_still(&self) -> bool {
        let first = &self.points[0].q;
        self.points.iter().all(|point| point.q == *first && point.qd.iter().all(|speed| *speed == 0.0))
    }

    /// Number of pieces between breakpoints.
    pub fn segments(&self) -> usize {
        self.points.len() - 1
    }

    /// The first point.
    pub fn first(&self) -> &CurvePoint {
        &self.points[0]
    }

    /// The last point.
    pub fn last(&self) -> &CurvePoint {
        &self.points[self.points.len() - 1]
    }

    /// When it starts (s).
    pub fn start_time(&self) -> f64 {
        self.first().t
    }

    /// When it ends (s).
    pub fn end_time(&self) -> f64 {
        self.last().t
    }

    /// Seconds from the first to the last point.
    pub fn duration(&self) -> f64 {
        self.end_time() - self.start_time()
    }

    /// Joint `joint` on segment `segment`, and the segment's length in time.
    #[inline]
    pub(super) fn cubic(&self, segment: usize, joint: usize) -> (Cubic, f64) {
        let (a, b) = (&self.points[segment], &self.points[segment + 1]);
        let h = b.t - a.t;
        (Cubic::hermite(a.q[joint], a.qd[joint], b.q[joint], b.qd[joint], h), h)
    }

    /// The segment that holds time `t`; at a breakpoint the one after it, beyond the ends the
    /// first or last. 0 when there is none.
    pub fn segment_at(&self, t: f64) -> usize {
        self.points.partition_point(|point| point.t <= t).clamp(1, self.points.len().max(2) - 1) - 1
    }

    /// Joint values and velocities at time `t`; before the start and after the end the curve
    /// stands still at its ends.
    pub fn state_at(&self, t: f64) -> (Config, Config) {
        let still = || self.first().q.iter().map(|_| 0.0).collect();
        if t < self.start_time() {
            return (self.first().q.clone(), still());
        }
        if t > self.end_time() {
            return (self.last().q.clone(), still());
        }
        let segment = self.segment_at(t);
        if self.points[segment].t == t || self.segments() == 0 {
            return (self.points[segment].q.clone(), self.points[segment].qd.clone());
        }
        if self.points[segment + 1].t == t {
            return (self.points[segment + 1].q.clone(), self.points[segment + 1].qd.clone());
        }
        let tau = t - self.points[segment].t;
        (0..self.joints())
            .map(|joint| {
                let (cubic, _) = self.cubic(segment, joint);
                (cubic.position(tau), cubic.velocity(tau))
            })
            .unzip()
    }

    /// Joint values at time `t`, as [`Self::state_at`].
    pub fn position_at(&self, t: f64) -> Config {
        let segment = self.segment_at(t);
        if t <= self.start_time() || t >= self.end_time() || self.points[segment].t == t {
            return self.state_at(t).0;
        }
        let tau = t - self.points[segment].t;
        (0..self.joints()).map(|joint| self.cubic(segment, joint).0.position(tau)).collect()
    }

    /// Joint accelerations on `segment` just after its start; zero past the last one.
    pub fn acceleration_after(&self, segment: usize) -> Config {
        if segment >= self.segments() {
            return self.first().q.iter().map(|_| 0.0).collect();
        }
        (0..self.joints()).map(|joint| self.cubic(segment, joint).0.acceleration(0.0)).collect()
    }

    /// The same motion `dt` seconds later.
    pub fn shifted(mut self, dt: f64) -> Self {
        for point in &mut self.points {
            point.t += dt;
        }
        self
    }

    /// Adds `next` after this curve's end, its clock moved so that it starts there.
    ///
    /// # Errors
    /// [`CurveError::Junction`] or [`CurveError::Joints`] when the curves do not meet within 1e-9
    /// in position and velocity; this curve is unchanged then.
    pub fn append(&mut self, next: &Curve) -> Result<(), CurveError> {
        if next.joints() != self.joints() {
            return Err(CurveError::Joints { index: 0 });
        }
        let (end, start) = (self.last(), next.first());
        let differences = end.q.iter().zip(&start.q).zip(end.qd.iter().zip(&start.qd));
        for (joint, ((q0, q1), (v0, v1))) in differences.enumerate() {
            let difference = (q0 - q1).abs().max((v0 - v1).abs());
            if difference > JUNCTION {
                return Err(CurveError::Junction { joint, difference });
            }
        }
        let shift = end.t - start.t;
        self.points.extend(next.points.iter().skip(1).map(|p| CurvePoint { t: p.t + shift, ..p.clone() }));
        Ok(())
    }

    /// Stands still at the end until `time` (s on the curve's clock), where that is later than
    /// its end. A wait shorter than [`MIN_SPACING_S`] is made that long. The curve must end at rest.
    pub fn wait_until(&mut self, time: f64) {
        if time > self.end_time() {
            let mut point = self.last().clone();
            point.t = time.max(point.t + MIN_SPACING_S);
            self.points.push(point);
        }
    }

    /// The same geometric path over `duration` seconds, slowed down evenly: q(t/s). A duration not
    /// above the present one leaves the curve as it is. A curve that only rests rests longer.
    /// Velocities fall by s, accelerations by s squared, so limits that held still hold.
    pub fn stretched_to(mut self, duration: f64) -> Self {
        if duration <= self.duration() {
            return self;
        }
        if self.segments() == 0 {
            self.wait_until(self.start_time() + duration);
            return self;
        }
        let start = self.start_time();
        let factor = duration / self.duration();
        for point in &mut self.points {
            point.t = start + (point.t - start) * factor;
            for speed in &mut point.qd {
                *speed /= factor;
            }
        }
        if let Some(last) = self.points.last_mut() {
            last.t = start + duration;
        }
        self
    }

    /// The motion of the joints in `range` alone, such as one arm out of a composite curve.
    /// Breakpoints that these joints do not need are kept.
    pub fn select(&self, range: Range<usize>) -> Self {
        let pick = |values: &Config| values.iter().take(range.end).skip(range.start).copied().collect();
        let points =
            self.points.iter().map(|p| CurvePoint { t: p.t, q: pick(&p.q), qd: pick(&p.qd) }).collect();
        Self { points }
    }

    /// Least time between two neighbouring points (s); infinite with a single point.
    pub fn least_spacing(&self) -> f64 {
        self.points.windows(2).map(|pair| pair[1].t - pair[0].t).fold(f64::INFINITY, f64::min)
    }

    /// Whether every two points are at least [`MIN_SPACING_S`] apart.
    pub fn is_spaced(&self) -> bool {
        self.least_spacing() >= MIN_SPACING_S
    }

    /// Whether it starts and ends with all velocities exactly zero.
    pub fn rests_at_ends(&self) -> bool {
        self.first().qd.iter().chain(&self.last().qd).all(|v| *v == 0.0)
    }
}
