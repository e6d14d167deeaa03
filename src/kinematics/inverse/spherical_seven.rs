//! Closed form for 7R arms with spherical shoulder, revolute elbow and spherical wrist.
//!
//! After Shimizu et al. (2008) and Faria et al. (2018), but on axes in space instead of
//! Denavit-Hartenberg frames, so that link offsets and axis signs of any convention will do: axes 1
//! to 3 meet in the shoulder S, axes 5 to 7 in the wrist W, and the elbow's axis 4 lies anywhere.
//! The distance S-W gives the elbow (two values); the arm may still turn about the line S-W by the
//! arm angle psi; for each psi the shoulder's rotation and the wrist's are split into three angles
//! in two ways each. So a target has eight branches, each a curve over psi.

use std::f64::consts::TAU;

use nalgebra::Matrix3;
use smallvec::SmallVec;

use super::angles::{fit, turn_between};
use super::arctangent::atan2_each;
use super::euler::{AxisTriple, Side};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::JointLimits;
use crate::kinematics::chain::Chain;
use crate::kinematics::sine::sin_cos;

/// Axes count as meeting when they pass each other within this distance (m).
const MEETING_TOLERANCE: f64 = 1e-7;

/// The structure of such an arm; everything in the root frame at zero.
#[derive(Debug, Clone)]
pub(super) struct SphericalSeven {
    shoulder: AxisTriple,
    wrist: AxisTriple,
    shoulder_centre: Vec3,
    /// The wrist centre in the mount frame.
    wrist_in_mount: Vec3,
    /// The mount frame's orientation, inverted.
    mount_inverse: Matrix3<f64>,
    elbow_axis: nalgebra::Unit<Vec3>,
    /// From the shoulder to a point of the elbow's axis, and on to the wrist.
    upper: Vec3,
    lower: Vec3,
    /// |S-W|^2 = `square` + 2 `swing` cos(q4 - `phase`).
    square: f64,
    swing: f64,
    phase: f64,
}

/// One of the eight branches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Branch {
    /// Index of the elbow solution in [`Aim::elbows`].
    pub elbow: usize,
    pub shoulder: Side,
    pub wrist: Side,
}

/// What a target asks for, whichever way the elbow bends.
struct Bearing {
    /// The rotation that all joints make together.
    goal: Matrix3<f64>,
    /// From the shoulder to the wrist, of unit length.
    direction: Vec3,
    /// The elbow's two values (rad).
    elbows: [f64; 2],
}

/// A target made ready: all that does not depend on psi.
#[derive(Debug, Clone)]
pub(super) struct Aim {
    pub elbows: [ElbowAim; 2],
}

/// The target with the elbow at one of its two values: the rotations that shoulder and wrist have
/// to make, as constant + cos psi * even + sin psi * odd.
#[derive(Debug, Clone)]
pub(super) struct ElbowAim {
    pub q4: f64,
    shoulder: Swing,
    wrist: Swing,
}

/// A matrix that depends on psi.
#[derive(Debug, Clone)]
struct Swing {
    constant: Matrix3<f64>,
    even: Matrix3<f64>,
    odd: Matrix3<f64>,
}

/// Between which cosines of their middle angles shoulder and wrist can be within the limits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Middles {
    shoulder: [f64; 2],
    wrist: [f64; 2],
}

/// A stretch of psi over which one branch stays within the limits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    pub from: f64,
    pub to: f64,
    pub branch: Branch,
}

impl SphericalSeven {
    /// The structure of `chain`, if it is such an arm.
    pub fn detect(chain: &Chain) -> Option<Self> {
        if chain.dof != 7 || !chain.is_plain_revolute() {
            return None;
        }
        let axes = chain.axes_at_zero();
        let shoulder_centre = common_point(&axes[0..3])?;
        let wrist_centre = common_point(&axes[4..7])?;
        let shoulder = AxisTriple::new(&axes[0].0, &axes[1].0, &axes[2].0)?;
        let wrist = AxisTriple::new(&axes[4].0, &axes[5].0, &axes[6].0)?;
        let (elbow_axis, elbow) = axes[3];
        let (upper, lower) = (elbow - shoulder_centre, wrist_centre - elbow);
        let along = upper.dot(&elbow_axis) * lower.dot(&elbow_axis);
        let even = upper.dot(&lower) - along;
        let odd = upper.dot(&elbow_axis.cross(&lower));
        let swing = even.hypot(odd);
        if swing < 1e-6 {
            return None;
        }
        let mount = chain.mount_pose(&[0.0; 7]);
        Some(Self {
            shoulder,
            wrist,
            shoulder_centre,
            wrist_in_mount: (mount.inverse() * nalgebra::Point3::from(wrist_centre)).coords,
            mount_inverse: mount.rotation.to_rotation_matrix().matrix().transpose(),
            elbow_axis: nalgebra::Unit::new_normalize(elbow_axis),
            upper,
            lower,
            square: upper.norm_squared() + lower.norm_squared() + 2.0 * along,
            swing,
            phase: odd.atan2(even),
        })
    }

    /// Makes `target` (mount frame in the root frame) ready. `reference` fixes where psi is 0: the
    /// arm then stands as at `reference`, turned by the least rotation that brings the wrist where
    /// it has to be. `None` when the wrist cannot get there.
    pub fn aim(&self, target: &Pose, reference: Option<&[f64]>) -> Option<Aim> {
        let Bearing { goal, direction, elbows } = self.bearing(target)?;
        let before = reference.map(|q| self.shoulder_rotation(q));
        Some(Aim { elbows: elbows.map(|q4| self.aim_elbow(q4, &goal, &direction, before.as_ref())) })
    }

    /// One elbow of [`Self::aim`], and the angle (rad) of the least rotation that it speaks of.
    pub fn aim_one(&self, target: &Pose, reference: &[f64; 7], elbow: usize) -> Option<(ElbowAim, f64)> {
        let Bearing { goal, direction, elbows } = self.bearing(target)?;
        let (q4, before) = (elbows[elbow], self.shoulder_rotation(reference));
        let start = before * (self.upper + turn_about(&self.elbow_axis, q4) * self.lower);
        let turn = start.cross(&direction).norm().atan2(start.dot(&direction));
        Some((self.aim_elbow(q4, &goal, &direction, Some(&before)), turn))
    }

    /// Whether the wrist cannot get to the target, or the elbow cannot bend as that takes.
    pub fn is_beyond(&self, limits: &[JointLimits], target: &Pose) -> bool {
        self.bearing(target).is_none_or(|bearing| {
            bearing.elbows.iter().all(|&q4| fit(q4, &limits[3], limits[3].lower).is_none())
        })
    }

    /// The angles at psi = 0 as [`Self::aim`] has it, with the elbow as near to that of `reference` as it can be;
    /// and the elbow's index. `None` when the wrist cannot get there.
    pub fn continued(&self, target: &Pose, reference: &[f64; 7]) -> Option<(usize, ElbowAngles)> {
        let Bearing { goal, direction, elbows } = self.bearing(target)?;
        let elbow = nearest_elbow(elbows, reference[3]);
        let q4 = elbows[elbow];
        let (bent, carried) = self.carry(q4, &direction, Some(&self.shoulder_rotation(reference)));
        let shoulder = self.shoulder.frame.transpose() * (carried * self.shoulder.end);
        let wrist = (carried * bent * self.wrist.frame).transpose() * (goal * self.wrist.end);
        let angles = ElbowAngles {
            q4,
            shoulder: self.shoulder.angles(&shoulder, reference[0]),
            wrist: self.wrist.angles(&wrist, reference[4]),
        };
        Some((elbow, angles))
    }

    /// `None` when the wrist cannot get to the target.
    #[inline]
    fn bearing(&self, target: &Pose) -> Option<Bearing> {
        let rotation = target.rotation.to_rotation_matrix();
        let goal = rotation.matrix() * self.mount_inverse;
        let wrist = rotation.matrix() * self.wrist_in_mount + target.translation.vector;
        let line = wrist - self.shoulder_centre;
        let square = line.norm_squared();
        let cosine = (square - self.square) / (2.0 * self.swing);
        if cosine.is_nan() || cosine.abs() > 1.0 + 1e-12 || square < 1e-12 {
            return None;
        }
        let bend = cosine.clamp(-1.0, 1.0).acos();
        let direction = line / square.sqrt();
        Some(Bearing { goal, direction, elbows: [self.phase + bend, self.phase - bend] })
    }

    fn aim_elbow(
        &self,
        q4: f64,
        goal: &Matrix3<f64>,
        direction: &Vec3,
        before: Option<&Matrix3<f64>>,
    ) -> ElbowAim {
        let (bent, carried) = self.carry(q4, direction, before);
        let shoulder =
            Swing::new(&self.shoulder.frame.transpose(), direction, &(carried * self.shoulder.end), 1.0);
        let left = (carried * bent * self.wrist.frame).transpose();
        let wrist = Swing::new(&left, direction, &(goal * self.wrist.end), -1.0);
        ElbowAim { q4, shoulder, wrist }
    }

    /// The rotation of the elbow at `q4`; and that of the shoulder which brings the wrist in `direction` by the least
    /// turn from where it was `before`.
    #[inline]
    fn carry(
        &self,
        q4: f64,
        direction: &Vec3,
        before: Option<&Matrix3<f64>>,
    ) -> (Matrix3<f64>, Matrix3<f64>) {
        let bent = turn_about(&self.elbow_axis, q4);
        let unturned = self.upper + bent * self.lower;
        let start = before.map_or(unturned, |rotation| rotation * unturned);
        let mut carried = least_rotation(&start, direction);
        if let Some(rotation) = before {
            carried *= rotation;
        }
        (bent, carried)
    }

    /// The rotation that joints 1 to 3 make at `q`.
    #[inline]
    fn shoulder_rotation(&self, q: &[f64]) -> Matrix3<f64> {
        // In the triple's frame: turns about z, y, z.
        let [(s1, c1), (s2, c2), (s3, c3)] = [q[0], q[1] + self.shoulder.shift, q[2]].map(sin_cos);
        let turns = Matrix3::new(
            c1 * c2 * c3 - s1 * s3,
            -c1 * c2 * s3 - s1 * c3,
            c1 * s2,
            s1 * c2 * c3 + c1 * s3,
            c1 * c3 - s1 * c2 * s3,
            s1 * s2,
            -s2 * c3,
            s2 * s3,
            c2,
        );
        self.shoulder.frame * turns * self.shoulder.end.transpose()
    }

    /// The branches of one elbow at `psi`, before limits; where angles are not determined
    /// (singular shoulder or wrist), joints 1 and 5 stay at `hold`.
    pub fn angles(&self, aim: &ElbowAim, psi: f64, hold: &[f64; 7]) -> ElbowAngles {
        self.angles_at(aim, sin_cos(psi), hold)
    }

    fn angles_at(&self, aim: &ElbowAim, (sine, cosine): (f64, f64), hold: &[f64; 7]) -> ElbowAngles {
        let shoulder = aim.shoulder.at(cosine, sine);
        let wrist = aim.wrist.at(cosine, sine);
        ElbowAngles {
            q4: aim.q4,
            shoulder: self.shoulder.angles(&shoulder, hold[0]),
            wrist: self.wrist.angles(&wrist, hold[4]),
        }
    }

    /// What `limits` allow of the middle angles.
    pub fn middles(&self, limits: &[JointLimits]) -> Middles {
        Middles {
            shoulder: cosines(&limits[1], self.shoulder.shift),
            wrist: cosines(&limits[5], self.wrist.shift),
        }
    }

    /// [`Self::angles`]; `None` where the middle angles alone, which are cheap, rule out all four branches.
    pub fn angles_if(
        &self,
        aim: &ElbowAim,
        psi: f64,
        hold: &[f64; 7],
        middles: &Middles,
    ) -> Option<ElbowAngles> {
        let (sine, cosine) = sin_cos(psi);
        let may_be = |swing: &Swing, [least, most]: [f64; 2]| {
            (least..=most).contains(&swing.entry((2, 2), cosine, sine))
        };
        let possible = may_be(&aim.shoulder, middles.shoulder) && may_be(&aim.wrist, middles.wrist);
        possible.then(|| self.angles_at(aim, (sine, cosine), hold))
    }

    /// All windows of psi, in (-pi, pi] and a turn on, within which some branch respects `limits`.
    pub fn windows(
        &self,
        aim: &Aim,
        limits: &[JointLimits],
        near: &[f64; 7],
        out: &mut SmallVec<[Window; 32]>,
    ) {
        out.clear();
        for (elbow, of_elbow) in aim.elbows.iter().enumerate() {
            self.elbow_windows((elbow, of_elbow), limits, near, None, out);
        }
    }

    /// Adds the windows of one elbow (with its index), or those of one of its branches that come as near to psi = 0 as
    /// is said (rad). Exact: each bound of a joint is crossed where an expression linear in cos psi and sin psi
    /// vanishes.
    pub fn elbow_windows(
        &self,
        (elbow, aim): (usize, &ElbowAim),
        limits: &[JointLimits],
        near: &[f64; 7],
        only: Option<(Branch, f64)>,
        out: &mut SmallVec<[Window; 32]>,
    ) {
        if fit(aim.q4, &limits[3], near[3]).is_none() {
            return;
        }
        let middles = self.middles(limits);
        let mut cuts: SmallVec<[f64; 32]> = SmallVec::new();
        aim.shoulder.limit_crossings(&limits[0..3], self.shoulder.shift, &mut cuts);
        aim.wrist.limit_crossings(&limits[4..7], self.wrist.shift, &mut cuts);
        cuts.sort_by(f64::total_cmp);
        if cuts.is_empty() {
            cuts.push(-std::f64::consts::PI);
        }
        for (index, &from) in cuts.iter().enumerate() {
            let to = cuts.get(index + 1).copied().unwrap_or(cuts[0] + TAU);
            if to - from < 1e-12 || only.is_some_and(|(_, most)| away_from_zero(from, to) > most) {
                continue;
            }
            let middle = (from + to) / 2.0;
            let Some(angles) = self.angles_if(aim, middle, near, &middles) else { continue };
            for shoulder in Side::BOTH {
                for wrist in Side::BOTH {
                    let branch = Branch { elbow, shoulder, wrist };
                    let is_asked = only.is_none_or(|(only, _)| only == branch);
                    if is_asked && angles.within(branch, limits, near).is_some() {
                        out.push(Window { from, to, branch });
                    }
                }
            }
        }
    }

    /// The branch (without its elbow index) on which `q` is.
    #[inline]
    pub fn sides_of(&self, q: &[f64]) -> (Side, Side) {
        let side = |angle: f64| if sin_cos(angle).0 >= 0.0 { Side::Positive } else { Side::Negative };
        (side(q[1] + self.shoulder.shift), side(q[5] + self.wrist.shift))
    }
}

/// The turn by `angle` (rad) about `axis` (Rodrigues).
#[inline]
fn turn_about(axis: &nalgebra::Unit<Vec3>, angle: f64) -> Matrix3<f64> {
    let (sine, cosine) = sin_cos(angle);
    let (x, y, z) = (axis.x, axis.y, axis.z);
    let (a, b, c) = (x * (1.0 - cosine), y * (1.0 - cosine), z * (1.0 - cosine));
    Matrix3::new(
        a * x + cosine,
        a * y - z * sine,
        a * z + y * sine,
        b * x + z * sine,
        b * y + cosine,
        b * z - x * sine,
        c * x - y * sine,
        c * y + x * sine,
        c * z + cosine,
    )
}

/// Which of two elbow angles (rad) is nearest to `q4`.
#[inline]
fn nearest_elbow(elbows: [f64; 2], q4: f64) -> usize {
    let [first, second] = elbows.map(|angle| turn_between(angle, q4));
    usize::from(second < first)
}

/// Angles of one elbow at one psi.
#[derive(Debug, Clone)]
pub(super) struct ElbowAngles {
    pub q4: f64,
    shoulder: [[f64; 3]; 2],
    wrist: [[f64; 3]; 2],
}

impl ElbowAngles {
    /// The configuration of `branch`, each joint within its limits and as near to `near` as
    /// whole turns allow.
    #[inline]
    pub fn within(&self, branch: Branch, limits: &[JointLimits], near: &[f64; 7]) -> Option<[f64; 7]> {
        let [a, b, c] = self.shoulder[branch.shoulder as usize];
        let [d, e, f] = self.wrist[branch.wrist as usize];
        let mut q = [a, b, c, self.q4, d, e, f];
        for ((value, limit), near) in q.iter_mut().zip(limits).zip(near) {
            *value = fit(*value, limit, *near)?;
        }
        Some(q)
    }
}

impl Swing {
    /// `left` times a turn by psi (or by -psi) about the unit vector d, times `right`. The turn is
    /// d d^T + cos psi (1 - d d^T) + sin psi [d]x.
    #[inline]
    fn new(left: &Matrix3<f64>, d: &Vec3, right: &Matrix3<f64>, sense: f64) -> Self {
        let constant = (left * d) * (right.transpose() * d).transpose();
        let even = left * right - constant;
        let d = d * sense;
        let crossed = Matrix3::from_columns(&[0, 1, 2].map(|k| d.cross(&right.column(k))));
        Self { constant, even, odd: left * crossed }
    }

    #[inline]
    fn at(&self, cosine: f64, sine: f64) -> Matrix3<f64> {
        self.constant + self.even * cosine + self.odd * sine
    }

    /// One entry of [`Self::at`].
    fn entry(&self, index: (usize, usize), cosine: f64, sine: f64) -> f64 {
        self.constant[index] + self.even[index] * cosine + self.odd[index] * sine
    }

    /// Adds every psi at which one of the three angles is at a limit (and maybe some more).
    fn limit_crossings(&self, limits: &[JointLimits], shift: f64, cuts: &mut SmallVec<[f64; 32]>) {
        let bounded = |joint: usize| {
            let limit = &limits[joint];
            let bounds = [limit.lower, limit.upper];
            bounds.into_iter().filter(move |_| limit.upper - limit.lower < TAU)
        };
        let entry = |row, column| {
            let index = (row, column);
            [self.constant[index], self.even[index], self.odd[index]]
        };
        for bound in bounded(0) {
            let (s, c) = sin_cos(bound);
            vanishing(combine(entry(0, 2), s, entry(1, 2), -c), cuts);
        }
        for bound in bounded(1) {
            let [constant, even, odd] = entry(2, 2);
            vanishing([constant - (bound + shift).cos(), even, odd], cuts);
        }
        for bound in bounded(2) {
            let (s, c) = sin_cos(bound);
            vanishing(combine(entry(2, 0), s, entry(2, 1), c), cuts);
        }
    }
}

/// The least and the greatest cosine (and a little more) of an angle that is `shift` (rad) beyond a joint's value
/// within `limit`.
fn cosines(limit: &JointLimits, shift: f64) -> [f64; 2] {
    let (from, to) = (limit.lower + shift, limit.upper + shift);
    if to - from >= TAU || (to - from).is_nan() {
        return [-2.0, 2.0];
    }
    // Whether an odd or an even multiple of pi lies between.
    let passes = |at: f64| (to - at).div_euclid(TAU) > (from - at).div_euclid(TAU);
    let least = if passes(std::f64::consts::PI) { -1.0 } else { from.cos().min(to.cos()) };
    let most = if passes(0.0) { 1.0 } else { from.cos().max(to.cos()) };
    [least - 1e-8, most + 1e-8]
}

/// How far (rad) psi at least is from 0, or from a turn, between two angles in (-pi, 3 pi], ascending.
fn away_from_zero(from: f64, to: f64) -> f64 {
    let [zero, turn] = [0.0, TAU].map(|turn| 0.0_f64.max(from - turn).min(to - turn).abs());
    zero.min(turn)
}

fn combine(a: [f64; 3], x: f64, b: [f64; 3], y: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] * x + b[i] * y)
}

/// Adds the psi where constant + even cos psi + odd sin psi vanishes.
fn vanishing([constant, even, odd]: [f64; 3], cuts: &mut SmallVec<[f64; 32]>) {
    let size = (even * even + odd * odd).sqrt();
    let rest = (size - constant) * (size + constant);
    if size < 1e-14 || rest < 0.0 {
        return;
    }
    let [phase, half] = atan2_each([odd, rest.sqrt()], [even, -constant]);
    for psi in [phase + half, phase - half] {
        cuts.push((psi + std::f64::consts::PI).rem_euclid(TAU) - std::f64::consts::PI);
    }
}

/// A rotation that turns the direction of `from` into the unit vector `to`, about the axis
/// perpendicular to both.
#[inline]
pub(super) fn least_rotation(from: &Vec3, to: &Vec3) -> Matrix3<f64> {
    let from = from / from.norm();
    let cosine = from.dot(to);
    if cosine < -0.999_999 {
        // Almost opposite: half a turn about any perpendicular axis, then the rest.
        let other = if from.x.abs() < 0.6 { Vec3::x() } else { Vec3::y() };
        let axis = from.cross(&other).normalize();
        let half_turn = 2.0 * axis * axis.transpose() - Matrix3::identity();
        return least_rotation(&(half_turn * from), to) * half_turn;
    }
    let cross = from.cross(to);
    let matrix = cross.cross_matrix();
    Matrix3::identity() + matrix + matrix * matrix / (1.0 + cosine)
}

/// The point in which all of `axes` (direction, point) meet.
pub(super) fn common_point(axes: &[(Vec3, Vec3)]) -> Option<Vec3> {
    let (first, rest) = axes.split_first()?;
    let (direction, origin) = first;
    let meeting = rest.iter().find_map(|(other, point)| {
        let normal = direction.cross(other);
        let square = normal.norm_squared();
        (square > 1e-12).then(|| origin + direction * (point - origin).cross(other).dot(&normal) / square)
    })?;
    let on_all = axes.iter().all(|(axis, point)| axis.cross(&(meeting - point)).norm() < MEETING_TOLERANCE);
    on_all.then_some(meeting)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosines_hold_those_of_all_angles_within() {
        for from in -40..40 {
            for width in 0..70 {
                let (lower, upper) =
                    (0.17 * f64::from(from), 0.17 * f64::from(from) + 0.1 * f64::from(width));
                let limit = JointLimits { lower, upper, velocity: 1.0, acceleration: 1.0 };
                let [least, most] = cosines(&limit, 0.3);
                let found = (0..=400).map(|n| (lower + (upper - lower) * f64::from(n) / 400.0 + 0.3).cos());
                let (low, high) = found.fold((2.0_f64, -2.0_f64), |(a, b), x| (a.min(x), b.max(x)));
                assert!(least <= low && most >= high, "{lower} {upper}");
                assert!(
                    upper - lower >= TAU || (low - least < 1e-2 && most - high < 1e-2),
                    "{lower} {upper}"
                );
            }
        }
    }
}
