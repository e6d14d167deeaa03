//! Speeds through corners.
//!
//! A blend at a corner takes `time` seconds of constant joint acceleration, from speed `entry`
//! along the piece before to speed `exit` along the piece after; it starts `entry * time / 2`
//! before the corner and ends `exit * time / 2` after it, and passes the corner at a distance of
//! |exit u2 - entry u1| time / 8. With the ratio exit / entry fixed, every constraint bounds the
//! entry speed in closed form. The pass is: safe speeds with half of each piece for each of its
//! corners, a forward and a backward pass for acceleration, then sweeps that raise one corner at a
//! time between its neighbours as they stand, over a few ratios.

use smallvec::SmallVec;

use super::polyline::{Piece, Polyline};
use super::profile::{SHORTEST_PHASE_S, travel_time};
use crate::kinematics::JointLimits;

/// Sweeps over all corners after the two passes.
const SWEEPS: usize = 2;

/// How a corner is taken; all zero is a stop.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Corner {
    /// Speed along the piece before, when the blend starts.
    pub(super) entry: f64,
    /// Speed along the piece after, when the blend ends.
    pub(super) exit: f64,
    /// Duration of the blend (s).
    pub(super) time: f64,
}

impl Corner {
    /// Length of the piece before that the blend takes.
    pub(super) fn before(&self) -> f64 {
        0.5 * self.entry * self.time
    }

    /// Length of the piece after that the blend takes.
    pub(super) fn after(&self) -> f64 {
        0.5 * self.exit * self.time
    }
}

/// A corner's shape for one ratio of exit to entry speed.
#[derive(Debug, Clone, Copy)]
struct Bend {
    ratio: f64,
    /// Least blend time per unit of entry speed, from the acceleration limits.
    time_per_speed: f64,
    /// Greatest entry speed from the tolerance and the speed limits of both pieces.
    cap: f64,
}

impl Bend {
    fn new(before: &Piece, after: &Piece, limits: &[JointLimits], tolerance: f64, ratio: f64) -> Self {
        let (mut turn, mut time_per_speed) = (0.0_f64, 0.0_f64);
        for ((u, v), l) in before.direction.iter().zip(&after.direction).zip(limits) {
            let change = (ratio * v - u).abs();
            turn = turn.max(change);
            time_per_speed = time_per_speed.max(change / l.acceleration);
        }
        // turn * entry * time / 8 <= tolerance, for both of the terms whose larger is the time.
        let by_tolerance = (8.0 * tolerance / (turn * time_per_speed).max(f64::MIN_POSITIVE)).sqrt();
        let by_spacing = 8.0 * tolerance / (turn * SHORTEST_PHASE_S).max(f64::MIN_POSITIVE);
        let by_speed = before.along.speed.min(after.along.speed / ratio);
        Self { ratio, time_per_speed, cap: by_speed.min(by_tolerance).min(by_spacing) }
    }

    fn corner(&self, entry: f64) -> Corner {
        if entry <= 0.0 {
            return Corner::default();
        }
        let time = (self.time_per_speed * entry).max(SHORTEST_PHASE_S);
        Corner { entry, exit: self.ratio * entry, time }
    }

    /// The greatest speed on one side (`scale` is 1 for the entry side, the ratio for the exit
    /// side; the result is the *entry* speed) that fits beside a neighbour which leaves `room` of
    /// the piece and passes its end of it at `speed`, as far as closed forms tell:
    /// [`fits`] has the last word.
    fn bound(&self, scale: f64, speed: f64, room: f64, acceleration: f64) -> f64 {
        let h = SHORTEST_PHASE_S;
        // In terms of this side's own speed s: blend length k s^2 / 2 or h s / 2.
        let k = self.time_per_speed / scale;
        let reach = speed * speed + 2.0 * acceleration * room;
        let a = acceleration;
        // s^2 <= speed^2 + 2 a (room - blend).
        let mut most = (reach / (1.0 + a * k)).sqrt();
        most = most.min((0.25 * a * a * h * h + reach).sqrt() - 0.5 * a * h);
        // speed^2 <= s^2 + 2 a (room - blend), where raising s can break it.
        if a * k > 1.0 {
            most = most.min(((2.0 * a * room - speed * speed).max(0.0) / (a * k - 1.0)).sqrt());
        }
        // blend + h max(s, speed) <= room.
        let beside = (room - h * speed).max(0.0);
        most = most.min(2.0 * beside / h).min(room / (1.5 * h));
        if k > 0.0 {
            most = most.min((2.0 * beside / k).sqrt());
            most = most.min(2.0 * room / (h + (h * h + 2.0 * k * room).sqrt()));
        }
        most / scale
    }
}

/// Whether a piece can be travelled between the corners at its ends, with a little to spare for
/// rounding: room for a phase that is long enough, and end speeds reachable from each other.
fn fits(piece: &Piece, from: &Corner, to: &Corner) -> bool {
    let rest = piece.length - from.after() - to.before();
    let change = (to.entry * to.entry - from.exit * from.exit).abs();
    rest * (1.0 + 1e-9) >= SHORTEST_PHASE_S * from.exit.max(to.entry)
        && change <= 2.0 * piece.along.acceleration * rest * (1.0 + 1e-9)
}

/// How every waypoint of `line` is passed; the first and the last are stops.
pub(super) fn corner_speeds(line: &Polyline, limits: &[JointLimits]) -> SmallVec<[Corner; 32]> {
    let pieces = &line.pieces;
    let mut corners: SmallVec<[Corner; 32]> = SmallVec::from_elem(Corner::default(), line.waypoints.len());
    if pieces.len() < 2 {
        return corners;
    }
    let mut bends: SmallVec<[Option<Bend>; 32]> = SmallVec::from_elem(None, line.waypoints.len());
    for at in 1..pieces.len() {
        if line.tolerances[at] > 0.0 {
            let (before, after) = (&pieces[at - 1], &pieces[at]);
            let make = |ratio| Bend::new(before, after, limits, line.tolerances[at], ratio);
            let bend = [1.0, natural_ratio(before, after)].map(make).into_iter().max_by(|a, b| {
                let gain = |bend: &Bend| half_way_gain(bend, before, after);
                gain(a).total_cmp(&gain(b))
            });
            bends[at] = bend;
        }
    }
    // Safe speeds, then forward and backward passes. Lowering a corner never breaks the pieces
    // that were in order before it.
    for at in 1..pieces.len() {
        if let Some(bend) = bends[at] {
            let (before, after) = (&pieces[at - 1], &pieces[at]);
            let cap = bend.cap.min(half_way_bound(&bend, before, after));
            let from = &corners[at - 1];
            let reach = bend.bound(1.0, from.exit, before.length - from.after(), before.along.acceleration);
            corners[at] = bend.corner(cap.min(reach));
        }
    }
    for at in (1..pieces.len()).rev() {
        if let Some(bend) = bends[at] {
            let (piece, to) = (&pieces[at], &corners[at + 1]);
            let room = piece.length - to.before();
            let reach = bend.bound(bend.ratio, to.entry, room, piece.along.acceleration);
            if reach < corners[at].entry {
                corners[at] = bend.corner(reach);
            }
        }
    }
    if !(0..pieces.len()).all(|i| fits(&pieces[i], &corners[i], &corners[i + 1])) {
        // Rounding in extreme cases: stopping at every waypoint is always possible.
        corners.fill(Corner::default());
    }
    for sweep in 0..SWEEPS {
        let mut changed = false;
        for step in 1..pieces.len() {
            let at = if sweep % 2 == 0 { pieces.len() - step } else { step };
            if let Some(bend) = &mut bends[at] {
                changed |= improve(line, limits, &mut corners, at, bend);
            }
        }
        if !changed {
            break;
        }
    }
    corners
}

/// The ratio of the speeds that two pieces would have at their own best.
fn natural_ratio(before: &Piece, after: &Piece) -> f64 {
    let best = |piece: &Piece| piece.along.speed.min((piece.along.acceleration * piece.length).sqrt());
    best(after) / best(before)
}

/// The greatest entry speed with which the blend keeps to the halves of both pieces.
fn half_way_bound(bend: &Bend, before: &Piece, after: &Piece) -> f64 {
    let h = SHORTEST_PHASE_S;
    let side = |piece: &Piece, scale: f64| {
        let (room, k) = (0.5 * piece.length, bend.time_per_speed / scale);
        // blend + h s <= room, for both of the terms whose larger is the time.
        (room / (1.5 * h)).min(2.0 * room / (h + (h * h + 2.0 * k * room).sqrt())) / scale
    };
    side(before, 1.0).min(side(after, bend.ratio))
}

/// Minus the time over the two halves beside a corner, if taken from and to the pieces' best
/// speeds: larger is better.
fn half_way_gain(bend: &Bend, before: &Piece, after: &Piece) -> f64 {
    let corner = bend.corner(bend.cap.min(half_way_bound(bend, before, after)));
    let side = |piece: &Piece, speed: f64, taken: f64| {
        let best = piece.along.speed.min((piece.along.acceleration * piece.length).sqrt()).max(speed);
        travel_time(speed.min(best), best, 0.5 * piece.length - taken, piece.along)
    };
    -(side(before, corner.entry, corner.before()) + corner.time + side(after, corner.exit, corner.after()))
}

/// Retakes corner `at` as fast as its neighbours allow, over a few ratios of exit to entry speed,
/// if that saves time. Returns whether it did.
fn improve(
    line: &Polyline,
    limits: &[JointLimits],
    corners: &mut [Corner],
    at: usize,
    bend: &mut Bend,
) -> bool {
    let (before, after) = (&line.pieces[at - 1], &line.pieces[at]);
    let (from, to) = (corners[at - 1], corners[at + 1]);
    let (room_before, room_after) = (before.length - from.after(), after.length - to.before());
    let time = |corner: &Corner| {
        travel_time(from.exit, corner.entry, room_before - corner.before(), before.along)
            + corner.time
            + travel_time(corner.exit, to.entry, room_after - corner.after(), after.along)
    };
    let present = time(&corners[at]);
    let mut best = present;
    let tried = [
        bend.ratio,
        1.0,
        natural_ratio(before, after),
        bend.ratio * 1.3,
        bend.ratio / 1.3,
        bend.ratio * 2.0,
        bend.ratio / 2.0,
    ];
    for (number, ratio) in tried.into_iter().enumerate() {
        if tried[..number].contains(&ratio) {
            continue;
        }
        let candidate = Bend::new(before, after, limits, line.tolerances[at], ratio);
        let entry = candidate
            .cap
            .min(candidate.bound(1.0, from.exit, room_before, before.along.acceleration))
            .min(candidate.bound(ratio, to.entry, room_after, after.along.acceleration));
        let corner = candidate.corner(entry);
        if fits(before, &from, &corner) && fits(after, &corner, &to) {
            let total = time(&corner);
            if total < best {
                best = total;
                corners[at] = corner;
                *bend = candidate;
            }
        }
    }
    best < present - 1e-6
}
