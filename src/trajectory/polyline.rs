//! A polyline made ready for timing: repeated and needless waypoints dropped, straight pieces
//! with directions and limits, corners with what blends may cut.

use smallvec::SmallVec;

use crate::kinematics::{Config, JointLimits};

use super::profile::Along;

/// Waypoints closer than this in every joint are one (rad or m).
const SAME: f64 = 1e-11;
/// Share of a waypoint's tolerance that may go into dropping it; blends keep the rest.
const DROP_SHARE: f64 = 0.25;
/// Cosine of the angle beyond which a corner is a reversal.
const REVERSAL: f64 = -1.0 + 1e-9;
/// At most this many waypoints are dropped in a row, which keeps the pass linear.
const LONGEST_RUN: usize = 64;

/// A straight piece between two kept waypoints. Its unit of length is s^2: joint distances are
/// weighted by one over the joint's acceleration limit, so that mixed units compare.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    /// Joint displacement per unit of length.
    pub(super) direction: Config,
    /// Length, positive.
    pub(super) length: f64,
    /// Greatest speed and acceleration along it.
    pub(super) along: Along,
}

/// The cleaned polyline: `waypoints[i]` to `waypoints[i + 1]` is `pieces[i]`.
#[derive(Debug)]
pub(super) struct Polyline {
    /// Kept waypoints, by index in the path.
    pub(super) waypoints: SmallVec<[usize; 32]>,
    /// What a blend may deviate from each kept waypoint in any joint; 0 to stop there.
    pub(super) tolerances: SmallVec<[f64; 32]>,
    /// The straight pieces, one fewer than waypoints.
    pub(super) pieces: Vec<Piece>,
}

impl Polyline {
    /// Prepares `path`; tolerances and limits are checked by the caller.
    pub(super) fn new(path: &[Config], tolerances: &[f64], limits: &[JointLimits]) -> Self {
        let mut line = Self { waypoints: SmallVec::new(), tolerances: SmallVec::new(), pieces: Vec::new() };
        line.collapse_repeated(path, tolerances);
        line.drop_needless(path, limits);
        line.make_pieces(path, limits);
        line
    }

    /// Keeps one of each run of equal waypoints, with the least tolerance of the run. The last
    /// waypoint is kept rather than one equal to it.
    fn collapse_repeated(&mut self, path: &[Config], tolerances: &[f64]) {
        for (index, waypoint) in path.iter().enumerate() {
            let tolerance =
                if index == 0 || index + 1 == path.len() { 0.0 } else { tolerances[index].max(0.0) };
            match (self.waypoints.last().copied(), self.tolerances.last_mut()) {
                (Some(before), Some(last)) if farthest(&path[before], waypoint) <= SAME => {
                    *last = last.min(tolerance);
                }
                _ => {
                    self.waypoints.push(index);
                    self.tolerances.push(tolerance);
                }
            }
        }
    }

    /// Drops waypoints near which the path is straight within a share of their tolerance, and
    /// takes what that costs from the tolerances of the corners that remain.
    fn drop_needless(&mut self, path: &[Config], limits: &[JointLimits]) {
        let count = self.waypoints.len();
        let mut kept: SmallVec<[usize; 32]> = SmallVec::new();
        let mut used: SmallVec<[f64; 32]> = SmallVec::new();
        let mut anchor = 0;
        while anchor < count {
            kept.push(anchor);
            used.push(0.0);
            if anchor + 1 == count {
                break;
            }
            let mut next = anchor + 1;
            let mut cost = 0.0;
            while next + 1 < count && self.tolerances[next] > 0.0 && next - anchor < LONGEST_RUN {
                match self.chord_cost(path, limits, anchor, next + 1) {
                    Some(more) => cost = more,
                    None => break,
                }
                next += 1;
            }
            if let Some(last) = used.last_mut() {
                *last = cost;
            }
            anchor = next;
        }
        let mut before = 0.0_f64;
        let mut tolerances: SmallVec<[f64; 32]> = SmallVec::new();
        for (&index, &after) in kept.iter().zip(&used) {
            tolerances.push((self.tolerances[index] - before.max(after)).max(0.0));
            before = after;
        }
        self.waypoints = kept.iter().map(|&index| self.waypoints[index]).collect();
        self.tolerances = tolerances;
    }

    /// How far the waypoints between `from` and `to` are off the chord between these two (largest
    /// joint difference), if the chord may replace them.
    fn chord_cost(&self, path: &[Config], limits: &[JointLimits], from: usize, to: usize) -> Option<f64> {
        let (a, b) = (&path[self.waypoints[from]], &path[self.waypoints[to]]);
        let square: f64 =
            a.iter().zip(b).zip(limits).map(|((x, y), l)| ((y - x) / l.acceleration).powi(2)).sum();
        if square <= 0.0 {
            return None;
        }
        // The blends at the ends may pass a dropped waypoint at their own tolerance; where an end
        // is a stop there is no blend.
        let ends = [self.tolerances[from], self.tolerances[to]];
        let widest = ends[0].max(ends[1]);
        let allowed = ends.into_iter().filter(|t| *t > 0.0).fold(f64::INFINITY, f64::min);
        let (mut at, mut cost) = (0.0, 0.0_f64);
        for between in from + 1..to {
            let point = &path[self.waypoints[between]];
            let joints = a.iter().zip(b).zip(point).zip(limits);
            let dot: f64 =
                joints.map(|(((x, y), p), l)| (y - x) * (p - x) / (l.acceleration * l.acceleration)).sum();
            let fraction = dot / square;
            if !(at..=1.0).contains(&fraction) {
                return None;
            }
            at = fraction;
            let off = a.iter().zip(b).zip(point).map(|((x, y), p)| (x + fraction * (y - x) - p).abs());
            let off = off.fold(0.0, f64::max);
            let own = self.tolerances[between];
            if own < widest || off > DROP_SHARE * allowed.min(own) {
                return None;
            }
            cost = cost.max(off);
        }
        Some(cost)
    }

    /// Directions and limits of the pieces; reversals become stops.
    fn make_pieces(&mut self, path: &[Config], limits: &[JointLimits]) {
        self.pieces.reserve_exact(self.waypoints.len().saturating_sub(1));
        for pair in self.waypoints.windows(2) {
            let (a, b) = (&path[pair[0]], &path[pair[1]]);
            let weighted = a.iter().zip(b).zip(limits).map(|((x, y), l)| ((y - x) / l.acceleration).powi(2));
            let length = weighted.sum::<f64>().sqrt();
            let direction: Config = a.iter().zip(b).map(|(x, y)| (y - x) / length).collect();
            let mut along = Along { speed: f64::INFINITY, acceleration: f64::INFINITY };
            for (d, l) in direction.iter().zip(limits).filter(|(d, _)| **d != 0.0) {
                along.speed = along.speed.min(l.velocity / d.abs());
                along.acceleration = along.acceleration.min(l.acceleration / d.abs());
            }
            self.pieces.push(Piece { direction, length, along });
        }
        for (corner, pair) in self.pieces.windows(2).enumerate() {
            let joints = pair[0].direction.iter().zip(&pair[1].direction).zip(limits);
            let cosine: f64 = joints.map(|((u, v), l)| u * v / (l.acceleration * l.acceleration)).sum();
            if cosine <= REVERSAL {
                self.tolerances[corner + 1] = 0.0;
            }
        }
    }
}

/// Largest difference of any joint.
fn farthest(a: &Config, b: &Config) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}
