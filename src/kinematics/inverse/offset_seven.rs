//! Closed form for 7R arms with a spherical shoulder whose fifth and sixth axes meet, and whose last
//! axis passes that point by (Franka Emika's type).
//!
//! The idea of He and Liu (2021), "Analytical inverse kinematics for Franka Emika Panda", with the last
//! joint as the free one, but on axes in space instead of Denavit-Hartenberg frames. With joint 7
//! given, the motion of link 6 is known, so the point W in which axes 5 and 6 meet is known as well.
//! Its distance from the shoulder S gives the elbow (two values). What is left is a turn about the line
//! S-W, by which axis 5 must come to stand at its fixed angle to axis 6 (two values); the rest splits
//! into turns about single axes, the shoulder's in two ways. So joint 7 leaves eight branches.

use std::f64::consts::TAU;

use nalgebra::Matrix3;
use rand::Rng as _;
use smallvec::SmallVec;

use super::angles::{fit, fit_all, neutral, turn_between, weighted_square};
use super::euler::AxisTriple;
use super::numeric::Descent;
use super::spherical_seven::{common_point, least_rotation};
use super::subproblems::{Turn, turn_onto, turns_to_component};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::chain::Chain;
use crate::kinematics::{Config, JointLimits};
use crate::run::Rng;

/// Draws of joint 7 without any solution before a target is given up: solutions fill most often a third
/// of the range or more, and the last of so many draws lie close together.
const BLIND_DRAWS: usize = 64;
/// Steps of joint 7 in the sweep for the closest solution.
const SWEEP: usize = 48;
/// The part of the golden ratio by which draws advance, which spreads any number of them evenly.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Two solutions whose joints all agree within this (rad) are one.
const SAME: f64 = 1e-7;

/// The structure of such an arm; everything in the root frame at zero.
#[derive(Debug, Clone)]
pub(super) struct OffsetSeven {
    shoulder: AxisTriple,
    shoulder_centre: Vec3,
    /// Where axes 5 and 6 meet.
    wrist: Vec3,
    /// Axes 4 to 7, and a point of the last.
    axes: [Vec3; 4],
    last_point: Vec3,
    /// From the shoulder to a point of the elbow's axis, and on to the wrist.
    upper: Vec3,
    lower: Vec3,
    /// |S-W|^2 = `square` + 2 `swing` cos(q4 - `phase`).
    square: f64,
    swing: f64,
    phase: f64,
    /// The cosine between axes 5 and 6.
    tilt: f64,
    /// A direction at a right angle to axis 6.
    beside_sixth: Vec3,
    mount_inverse: Pose,
}

/// A target made ready: the motion that all joints together have to make.
struct Aim {
    rotation: Matrix3<f64>,
    shift: Vec3,
}

/// The solutions for one value of joint 7.
type Solutions = SmallVec<[[f64; 7]; 8]>;

/// Stretches of joint 7 in which the elbow can make the distance.
type Stretches = SmallVec<[(f64, f64); 6]>;

impl OffsetSeven {
    /// The structure of `chain`, if it is such an arm.
    pub fn detect(chain: &Chain) -> Option<Self> {
        if chain.dof != 7 || !chain.is_plain_revolute() {
            return None;
        }
        let lines = chain.axes_at_zero();
        let shoulder_centre = common_point(&lines[0..3])?;
        let shoulder = AxisTriple::new(&lines[0].0, &lines[1].0, &lines[2].0)?;
        let wrist = common_point(&lines[4..6])?;
        let (elbow_axis, elbow) = lines[3];
        let (upper, lower) = (elbow - shoulder_centre, wrist - elbow);
        let along = upper.dot(&elbow_axis) * lower.dot(&elbow_axis);
        let even = upper.dot(&lower) - along;
        let odd = upper.dot(&elbow_axis.cross(&lower));
        let swing = even.hypot(odd);
        let (fifth, sixth) = (lines[4].0, lines[5].0);
        if swing < 1e-6 || fifth.cross(&sixth).norm() < 1e-6 {
            return None;
        }
        let other = if sixth.x.abs() < 0.6 { Vec3::x() } else { Vec3::y() };
        Some(Self {
            shoulder,
            shoulder_centre,
            wrist,
            axes: std::array::from_fn(|index| lines[index + 3].0.normalize()),
            last_point: lines[6].1,
            upper,
            lower,
            square: upper.norm_squared() + lower.norm_squared() + 2.0 * along,
            swing,
            phase: odd.atan2(even),
            tilt: fifth.dot(&sixth),
            beside_sixth: sixth.cross(&other).normalize(),
            mount_inverse: chain.mount_pose(&[0.0; 7]).inverse(),
        })
    }

    fn aim(&self, target: &Pose) -> Aim {
        let goal = target * self.mount_inverse;
        Aim { rotation: *goal.rotation.to_rotation_matrix().matrix(), shift: goal.translation.vector }
    }

    /// All solutions with joint 7 at `last`, before limits. Where an angle is not determined it is that
    /// of `hold`.
    fn solutions(&self, aim: &Aim, last: f64, hold: &[f64; 7]) -> Solutions {
        let mut out = Solutions::new();
        let [elbow_axis, fifth_axis, sixth_axis, last_axis] = &self.axes;
        let of_last = Turn::by(last).about(last_axis);
        let of_six = aim.rotation * of_last.transpose();
        // Joint 7 turned back about a point of its axis.
        let shift = aim.rotation * self.last_point - of_six * self.last_point + aim.shift;
        let line = of_six * self.wrist + shift - self.shoulder_centre;
        let square = line.norm_squared();
        let cosine = (square - self.square) / (2.0 * self.swing);
        if cosine.is_nan() || cosine.abs() > 1.0 + 1e-12 || square < 1e-12 {
            return out;
        }
        let bend = cosine.clamp(-1.0, 1.0).acos();
        let direction = line / square.sqrt();
        let wanted = of_six * sixth_axis;
        for elbow in [self.phase + bend, self.phase - bend] {
            let bent = Turn::by(elbow).about(elbow_axis);
            let unturned = self.upper + bent * self.lower;
            let carried = least_rotation(&unturned, &direction);
            let fifth = carried * (bent * fifth_axis);
            for psi in turns_to_component(&direction, &fifth, &wanted, self.tilt, 0.0) {
                let swung = psi.about(&direction) * carried;
                let before = swung * bent;
                let q5 = turn_onto(fifth_axis, sixth_axis, &(before.transpose() * wanted));
                let q5 = q5.unwrap_or_else(|| Turn::by(hold[4]));
                let rest = (before * q5.about(fifth_axis)).transpose() * of_six;
                let q6 = turn_onto(sixth_axis, &self.beside_sixth, &(rest * self.beside_sixth));
                let (q5, q6) = (q5.angle(), q6.map_or(hold[5], Turn::angle));
                let m = self.shoulder.frame.transpose() * swung * self.shoulder.end;
                for [a, b, c] in self.shoulder.angles(&m, hold[0]) {
                    out.push([a, b, c, elbow, q5, q6, last]);
                }
            }
        }
        out
    }

    /// The solutions with joint 7 at `last` within `limits`, each joint as near to `near` as whole turns
    /// allow.
    fn within(&self, aim: &Aim, last: f64, limits: &[JointLimits], near: &[f64; 7]) -> Solutions {
        let mut found = self.solutions(aim, last, near);
        found.retain(|q| fit_all(q, limits, near));
        found
    }

    /// Where joint 7 leaves the wrist at a distance that the elbow can make within its limits; nothing
    /// means that there is no solution at all. The squared distance is constant + even cos q7 + odd sin
    /// q7, and is cut at the least and the greatest one that the elbow allows.
    fn stretches(&self, aim: &Aim, limits: &[JointLimits]) -> Stretches {
        let axis = self.axes[3];
        // The wrist seen from the last axis: turning joint 7 back swings it about that.
        let from_last = self.wrist - self.last_point;
        let along = axis * axis.dot(&from_last);
        let to_shoulder =
            aim.rotation.transpose() * (self.shoulder_centre - aim.shift) - self.last_point - along;
        let aside = from_last - along;
        let constant = to_shoulder.norm_squared() + aside.norm_squared();
        let even = -2.0 * to_shoulder.dot(&aside);
        // Back by q7, hence the sign.
        let odd = 2.0 * to_shoulder.dot(&axis.cross(&aside));
        let size = even.hypot(odd);
        let (least, greatest) = self.distances(&limits[3]);
        let last = &limits[6];
        let (from, to) = if last.upper - last.lower < TAU {
            (last.lower, last.upper)
        } else {
            (neutral(last) - TAU / 2.0, neutral(last) + TAU / 2.0)
        };
        let mut out = Stretches::new();
        let slack = 1e-9;
        if constant + size < least - slack || constant - size > greatest + slack {
            return out;
        }
        if size < 1e-12 {
            out.push((from, to));
            return out;
        }
        // Around the phase, the distance falls on both sides: near(angle) in [inner, outer].
        let phase = odd.atan2(even);
        let at = |bound: f64| ((bound - constant) / size).clamp(-1.0, 1.0).acos();
        let (inner, outer) = (at(greatest + slack), at(least - slack));
        for (a, b) in [(phase + inner, phase + outer), (phase - outer, phase - inner)] {
            let first = ((from - b) / TAU).ceil() as i64;
            for turn in first..first + 3 {
                let (a, b) = (a + TAU * turn as f64, b + TAU * turn as f64);
                let (a, b) = (a.max(from), b.min(to));
                if a < b {
                    out.push((a, b));
                }
            }
        }
        out
    }

    /// The least and the greatest squared distance (m^2) of S and W over the elbow's limits.
    fn distances(&self, limits: &JointLimits) -> (f64, f64) {
        let at = |angle: f64| self.square + 2.0 * self.swing * (angle - self.phase).cos();
        let has = |angle: f64| fit(angle, limits, neutral(limits)).is_some();
        let (full, folded) = (self.phase, self.phase + TAU / 2.0);
        let ends =
            [limits.lower, limits.upper].map(|end| if end.is_finite() { at(end) } else { self.square });
        let greatest = if has(full) { at(full) } else { ends[0].max(ends[1]) };
        let least = if has(folded) { at(folded) } else { ends[0].min(ends[1]) };
        (least, greatest)
    }

    /// Up to `max` solutions within `limits`, spread over joint 7 and the branches.
    pub fn spread(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        max: usize,
        rng: &mut Rng,
        out: &mut Vec<Config>,
    ) {
        let aim = self.aim(target);
        let stretches = self.stretches(&aim, limits);
        let length: f64 = stretches.iter().map(|(from, to)| to - from).sum();
        if stretches.is_empty() {
            return;
        }
        let near: [f64; 7] = std::array::from_fn(|joint| neutral(&limits[joint]));
        let per_draw = max.div_ceil(4);
        let start: f64 = rng.random();
        for draw in 0..BLIND_DRAWS + 4 * max {
            if out.len() >= max || (draw >= BLIND_DRAWS && out.is_empty()) {
                return;
            }
            let mut along = (start + GOLDEN * draw as f64).fract() * length;
            let within = stretches.iter().find_map(|(from, to)| {
                let here = along <= to - from;
                if !here {
                    along -= to - from;
                }
                here.then_some(from + along)
            });
            let last = within.unwrap_or(stretches[0].0);
            let found = self.within(&aim, last, limits, &near);
            if found.is_empty() {
                continue;
            }
            let first = rng.random_range(0..found.len());
            let mut taken = 0;
            for index in 0..found.len() {
                if taken == per_draw || out.len() >= max {
                    break;
                }
                let q = &found[(first + index) % found.len()];
                let known =
                    out.iter().any(|other| other.iter().zip(q).all(|(a, b)| turn_between(*a, *b) < SAME));
                if !known {
                    out.push(q.iter().copied().collect());
                    taken += 1;
                }
            }
        }
    }

    /// The solution that continues from `seed` with joint 7 kept where that can be, else what a descent
    /// from there finds; no joint farther than `max_step` (rad) from the seed.
    pub fn near(&self, descent: &Descent<'_>, seed: &[f64; 7], max_step: f64) -> Option<Config> {
        let aim = self.aim(descent.target);
        let close = |q: &[f64]| q.iter().zip(seed).all(|(a, b)| (a - b).abs() <= max_step);
        let square = |q: &[f64; 7]| weighted_square(q, seed, &[1.0; 7]);
        let kept = self
            .within(&aim, seed[6], descent.limits, seed)
            .into_iter()
            .filter(|q| close(q))
            .min_by(|a, b| square(a).total_cmp(&square(b)));
        if let Some(q) = kept {
            return Some(q.into_iter().collect());
        }
        let mut q = descent.from(seed)?;
        descent.unwind(&mut q, seed);
        close(&q).then_some(q)
    }

    /// The solution of least weighted square distance to `reference`: a sweep over joint 7, then
    /// halving steps about the best.
    pub fn closest(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        reference: &[f64; 7],
        weights: &[f64],
    ) -> Option<Config> {
        let aim = self.aim(target);
        let stretches = self.stretches(&aim, limits);
        let best_at = |last: f64| {
            let found = self.within(&aim, last, limits, reference).into_iter();
            found.map(|q| (weighted_square(&q, reference, weights), q)).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let mut best: Option<(f64, [f64; 7])> = None;
        let mut step = TAU / SWEEP as f64;
        if !stretches.is_empty() {
            best = best_at(reference[6]);
        }
        for (from, to) in stretches {
            let count = ((to - from) / step).ceil().max(1.0);
            for index in 0..=count as usize {
                let last = from + (to - from) * index as f64 / count;
                if let Some((cost, q)) = best_at(last)
                    && best.is_none_or(|(least, _)| cost < least)
                {
                    best = Some((cost, q));
                }
            }
        }
        let (mut least, mut q) = best?;
        while step > 1e-4 {
            let better = [q[6] - step, q[6] + step]
                .into_iter()
                .filter(|last| *last >= limits[6].lower && *last <= limits[6].upper)
                .filter_map(best_at)
                .find(|(cost, _)| *cost < least);
            match better {
                Some((cost, found)) => (least, q) = (cost, found),
                None => step /= 2.0,
            }
        }
        Some(q.into_iter().collect())
    }
}
