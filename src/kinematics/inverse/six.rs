//! Closed forms for 6R arms whose second and third axes are parallel: with a spherical wrist
//! (axes 4 to 6 meet in one point), or with a third parallel axis (4) and a wrist whose axes 5 and 6
//! meet, as the UR arms have it. Up to eight solutions each.
//!
//! On axes in space: joints 2 and 3 (and 4) leave the component along their common direction
//! as it is, which gives joint 1 alone; the rest splits into turns about single axes.

use nalgebra::Matrix3;
use smallvec::SmallVec;

use super::angles::{fit_all, neutral, weighted_square};
use super::euler::AxisTriple;
use super::spherical_seven::common_point;
use super::subproblems::{Component, Turn, turn_onto, turns_to_component};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::chain::Chain;
use crate::kinematics::{Config, JointLimits};
use crate::run::Rng;

/// Axes count as parallel when the sine between them is below this.
const PARALLEL: f64 = 1e-9;

/// Below this sine between axis 6 and the common direction the fifth angle is found from the sixth.
const NEAR_SINGULAR: f64 = 1e-6;

/// All solutions of one target.
pub(super) type Solutions = SmallVec<[[f64; 6]; 8]>;

/// The structure of such an arm; everything in the root frame at zero.
#[derive(Debug, Clone)]
pub(super) struct SixAxes {
    axes: [Vec3; 6],
    /// A point on each axis.
    points: [Vec3; 6],
    /// The mount frame.
    mount: Pose,
    elbow: Elbow,
    wrist: Wrist,
}

/// Joints 2 and 3, which bring a point of the wrist where it should be.
#[derive(Debug, Clone)]
struct Elbow {
    /// From axis 2 to axis 3, and from there to the point.
    upper: Vec3,
    lower: Vec3,
    /// The sum of their squares.
    squares: f64,
    /// How far the lower part reaches along the upper.
    component: Component,
}

#[derive(Debug, Clone)]
enum Wrist {
    /// Axes 4 to 6 meet in `centre`.
    Spherical { centre: Vec3, triple: AxisTriple },
    /// Axis 4 is parallel to 2 and 3; 5 and 6 meet.
    Parallel(ParallelWrist),
}

#[derive(Debug, Clone)]
struct ParallelWrist {
    /// Where axes 5 and 6 meet.
    meeting: Vec3,
    /// 1 where axis 3 points as axis 2 does, -1 where it points the other way.
    sign3: f64,
    /// The same for axis 4.
    sign4: f64,
    /// Axis 6 turned about axis 5, along the common direction.
    last: Component,
    /// A direction across the common one.
    side: Vec3,
}

impl SixAxes {
    /// The structure of `chain`, if it is such an arm.
    pub fn detect(chain: &Chain) -> Option<Self> {
        if chain.dof != 6 || !chain.is_plain_revolute() {
            return None;
        }
        let lines = chain.axes_at_zero();
        let parallel = |a: usize, b: usize| lines[a].0.cross(&lines[b].0).norm() < PARALLEL;
        if !parallel(1, 2) || parallel(0, 1) {
            return None;
        }
        let sign = |a: usize| lines[1].0.dot(&lines[a].0).signum();
        let spherical = common_point(&lines[3..6]).and_then(|centre| {
            let triple = AxisTriple::new(&lines[3].0, &lines[4].0, &lines[5].0)?;
            Some(Wrist::Spherical { centre, triple })
        });
        let wrist = match spherical {
            Some(wrist) => wrist,
            None if parallel(1, 3) && !parallel(1, 4) && !parallel(4, 5) => {
                let meeting = common_point(&lines[4..6])?;
                let [common, fifth, sixth] = [1, 4, 5].map(|axis| lines[axis].0.normalize());
                Wrist::Parallel(ParallelWrist {
                    meeting,
                    sign3: sign(2),
                    sign4: sign(3),
                    last: Component::new(&fifth, &sixth, &common),
                    side: common.cross(&least_aligned(&common)),
                })
            }
            None => return None,
        };
        let axes: [Vec3; 6] = std::array::from_fn(|index| lines[index].0.normalize());
        let points: [Vec3; 6] = std::array::from_fn(|index| lines[index].1);
        let bent = match &wrist {
            Wrist::Spherical { centre, .. } => *centre,
            Wrist::Parallel(_) => points[3],
        };
        let (upper, lower) = (points[2] - points[1], bent - points[2]);
        let elbow = Elbow {
            upper,
            lower,
            squares: upper.norm_squared() + lower.norm_squared(),
            component: Component::new(&axes[2], &lower, &upper),
        };
        Some(Self { axes, points, mount: chain.mount_pose(&[0.0; 6]), elbow, wrist })
    }

    /// Whether the wrist's axes meet in one point.
    pub fn has_spherical_wrist(&self) -> bool {
        matches!(self.wrist, Wrist::Spherical { .. })
    }

    /// All solutions for `target`, angles within a turn or two about 0; where an angle is not
    /// determined it stays at `hold`.
    pub fn solutions(&self, target: &Pose, hold: &[f64; 6]) -> Solutions {
        // The motion of the last body against zero.
        let goal = target * self.mount.inverse();
        let rotation = *goal.rotation.to_rotation_matrix().matrix();
        let motion = |point: &Vec3| rotation * point + goal.translation.vector;
        let mut out = Solutions::new();
        let common = self.axes[1];
        let fixed = match &self.wrist {
            Wrist::Spherical { centre, .. } => centre,
            Wrist::Parallel(wrist) => &wrist.meeting,
        };
        let moved = motion(fixed);
        let from_first = moved - self.points[0];
        let component = common.dot(&(fixed - self.points[0]));
        // Joint 1 turns the point back; then its component along the common axis is as at zero.
        for back in turns_to_component(&self.axes[0], &from_first, &common, component, -hold[0]) {
            let unturn = back.about(&self.axes[0]);
            let first = back.back().angle();
            let turned_back = unturn * from_first + self.points[0];
            match &self.wrist {
                Wrist::Spherical { triple, .. } => {
                    for [second, third] in self.bend(&turned_back, hold).into_iter().flatten() {
                        let before =
                            unturn.transpose() * second.about(&self.axes[1]) * third.about(&self.axes[2]);
                        let m = (before * triple.frame).transpose() * rotation * triple.end;
                        let (second, third) = (second.angle(), third.angle());
                        for [d, e, f] in triple.angles(&m, hold[3]) {
                            out.push([first, second, third, d, e, f]);
                        }
                    }
                }
                Wrist::Parallel(wrist) => {
                    let rest = unturn * rotation;
                    let shift = unturn * (goal.translation.vector - self.points[0]) + self.points[0];
                    self.parallel_wrist(wrist, first, &rest, &shift, hold, &mut out);
                }
            }
        }
        out
    }

    /// Joints 2 to 6 of a UR-like arm, given that they have to make the motion x -> `rest` x +
    /// `shift`.
    fn parallel_wrist(
        &self,
        ParallelWrist { meeting, sign3, sign4, last: sixth_axis, side }: &ParallelWrist,
        first: f64,
        rest: &Matrix3<f64>,
        shift: &Vec3,
        hold: &[f64; 6],
        out: &mut Solutions,
    ) {
        let common = self.axes[1];
        let last = self.axes[5];
        let component = common.dot(&(rest * last));
        let from = rest.transpose() * common;
        let wrist = &self.points[3];
        let moved = rest * meeting + shift;
        let fifths = sixth_axis.turns(component, hold[4]);
        for (fifth, sense) in fifths.into_iter().zip([1.0, -1.0]) {
            let mut to = fifth.back().apply(&self.axes[4], &common);
            if last.cross(&to).norm_squared() < NEAR_SINGULAR * NEAR_SINGULAR {
                // Axis 6 is all but parallel to the common direction, where a cosine does not tell
                // the fifth angle well; which way it tilts is still clear.
                let tilted = Turn::by(fifth.angle() + sense * NEAR_SINGULAR);
                to = tilted.back().apply(&self.axes[4], &common);
            }
            let sixth = turn_onto(&last, &from, &to).unwrap_or_else(|| Turn::by(hold[5]));
            let fifth = turn_onto(&self.axes[4], &sixth.apply(&last, &from), &common).unwrap_or(fifth);
            // What joints 2 to 4 have to do to a direction.
            let (fifth_back, sixth_back) = (fifth.back(), sixth.back());
            let planar = |v: &Vec3| rest * sixth_back.apply(&last, &fifth_back.apply(&self.axes[4], v));
            let Some(total) = turn_onto(&common, side, &planar(side)) else { continue };
            let goal = planar(&(wrist - meeting)) + moved;
            let bends = self.bend(&goal, hold);
            if bends == [None, None] {
                continue;
            }
            let [fifth, sixth, total, _] = Turn::angles([fifth, sixth, total, total]);
            for [second, third] in bends.into_iter().flatten() {
                let [second, third] = Turn::angles([second, third]);
                let fourth = sign4 * (total - second - sign3 * third);
                out.push([first, second, third, fourth, fifth, sixth]);
            }
        }
    }

    /// Turns of joints 2 and 3 that bring the wrist's point to `goal`, at most two ways.
    fn bend(&self, goal: &Vec3, hold: &[f64; 6]) -> [Option<[Turn; 2]>; 2] {
        let Elbow { upper, lower, squares, component } = &self.elbow;
        let way = goal - self.points[1];
        let product = (way.norm_squared() - squares) / 2.0;
        let mut bends = [None; 2];
        for (third, bend) in component.turns(product, hold[2]).into_iter().zip(&mut bends) {
            let bent = upper + third.apply(&self.axes[2], lower);
            let second = turn_onto(&self.axes[1], &bent, &way).unwrap_or_else(|| Turn::by(hold[1]));
            *bend = Some([second, third]);
        }
        bends
    }

    /// Up to `max` solutions within `limits`, in random order.
    pub fn spread(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        max: usize,
        rng: &mut Rng,
        out: &mut Vec<Config>,
    ) {
        use rand::Rng as _;
        let near: [f64; 6] = std::array::from_fn(|joint| neutral(&limits[joint]));
        let mut found = self.within(limits, target, &near);
        while out.len() < max && !found.is_empty() {
            let q = found.swap_remove(rng.random_range(0..found.len()));
            if !out.iter().any(|other| other.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-7)) {
                out.push(q.into_iter().collect());
            }
        }
    }

    /// The solution of least weighted square distance to `reference`.
    pub fn closest(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        reference: &[f64; 6],
        weights: &[f64],
    ) -> Option<Config> {
        let cost = |q: &[f64; 6]| weighted_square(q, reference, weights);
        let found = self.within(limits, target, reference);
        let best = found.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        Some(best.into_iter().collect())
    }

    /// The solutions within `limits`, each joint turned as near to `near` as whole turns allow.
    fn within(&self, limits: &[JointLimits], target: &Pose, near: &[f64; 6]) -> Solutions {
        let mut found = self.solutions(target, near);
        found.retain(|q| fit_all(q, limits, near));
        found
    }
}

/// The coordinate axis least aligned with `direction`.
fn least_aligned(direction: &Vec3) -> Vec3 {
    let size = direction.abs();
    match size.imin() {
        0 => Vec3::x(),
        1 => Vec3::y(),
        _ => Vec3::z(),
    }
}
