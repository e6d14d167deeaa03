//! How far joints can move what hangs on them, and how far the arm reaches: bounds that hold for
//! every configuration within the limits.
//!
//! Both come from a string laid along the chain: choose one point on each revolute axis. A point on
//! an axis is fixed in the link before the axis and in the link after it, so the distance between
//! chosen points on neighbouring axes never changes, and their sum bounds the distance between the
//! ends. Any choice gives a valid bound; the shortest string, found by letting one point after the
//! other slide to where it is shortest, gives the best of this kind.

use super::chain::{Chain, ChainStep, StepKind};
use super::{ArmModel, JointLimits};
use crate::geometry::{Pose, Vec3};

/// Rounds of sliding the points.
const ROUNDS: usize = 40;

/// How far one joint moves the points of one link: a point within `rho` (m) of the link's origin
/// moves at most `|dq| * (constant + per_radius * rho)` when the joint moves by `dq`, wherever the
/// other joints are.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lever {
    /// Motion of the link's origin per unit of the joint (m/rad or m/m).
    pub constant: f64,
    /// Further motion per unit of the joint and metre of `rho`: 1 for a revolute joint, 0 for a
    /// prismatic one; with mimic joints the sum over all that the joint drives.
    pub per_radius: f64,
}

impl Lever {
    /// The bound (m per unit of the joint) for points within `rho` (m) of the link's origin.
    pub fn at(&self, rho: f64) -> f64 {
        self.constant + self.per_radius * rho
    }
}

/// A ball in the root frame that the mount origin never leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Its centre in the root link's frame (m).
    pub centre: Vec3,
    /// Its radius (m); infinite for an unlimited prismatic joint.
    pub radius: f64,
}

impl ArmModel {
    /// How far `joint` moves points of `link` (an index into [`ArmModel::links`]), for every
    /// configuration within `limits` (one per joint). `None` when it does not move that link.
    pub fn lever(&self, limits: &[JointLimits], joint: usize, link: usize) -> Option<Lever> {
        let chain = Chain::new(&self.links, link, self.dof());
        let mut lever = None;
        for (index, step) in chain.steps.iter().enumerate().filter(|(_, step)| step.joint == joint) {
            let sum: &mut Lever = lever.get_or_insert_default();
            match step.kind {
                StepKind::Slide => sum.constant += step.multiplier.abs(),
                StepKind::Turn => {
                    let (_, length) = shortest_string(&chain.steps[index..], &chain.tail, limits, true);
                    sum.constant += step.multiplier.abs() * length;
                    sum.per_radius += step.multiplier.abs();
                }
            }
        }
        lever
    }

    /// An upper bound (m), over all configurations within `limits` (one per joint), on the distance
    /// between the origins of the frame of `joint` and of `link`. `None` when the joint does not
    /// move the link.
    ///
    /// To bound motions take [`ArmModel::lever`], which is tighter and knows mimic joints.
    pub fn origin_distance(&self, limits: &[JointLimits], joint: usize, link: usize) -> Option<f64> {
        let chain = Chain::new(&self.links, link, self.dof());
        let moved = self.joints.get(joint)?.link;
        let steps_before = Chain::new(&self.links, moved, self.dof()).steps.len();
        let index = steps_before.checked_sub(1)?;
        let step = chain.steps.get(index).filter(|step| step.joint == joint && self.is_below(link, moved))?;
        let own = match step.kind {
            StepKind::Turn => 0.0,
            // From the joint frame itself, not from where the slide carries it.
            StepKind::Slide => {
                let (middle, half) = slide_range(step, limits);
                middle.abs() + half
            }
        };
        let (_, length) = shortest_string(&turning(&chain.steps[index..]), &chain.tail, limits, false);
        Some(own + length)
    }

    /// Whether `link` is `ancestor` or hangs on it.
    fn is_below(&self, link: usize, ancestor: usize) -> bool {
        let mut next = Some(link);
        while let Some(at) = next {
            if at == ancestor {
                return true;
            }
            next = self.links[at].parent;
        }
        false
    }

    /// A ball that the mount origin never leaves within `limits` (one per joint): for a spherical
    /// shoulder about its centre.
    pub fn reach_within(&self, limits: &[JointLimits]) -> Reach {
        // Arms of one model have the same limits mostly.
        if let Some((_, reach)) = self.reach.get().filter(|(asked, _)| asked == limits) {
            return *reach;
        }
        let reach = self.work_out_reach(limits);
        self.reach.get_or_init(|| (limits.to_vec(), reach));
        reach
    }

    fn work_out_reach(&self, limits: &[JointLimits]) -> Reach {
        let mut start = Pose::identity();
        let mut slack = 0.0;
        for (index, step) in self.chain.steps.iter().enumerate() {
            start *= step.fixed;
            match step.kind {
                StepKind::Slide => {
                    let (middle, half) = slide_range(step, limits);
                    start *= nalgebra::Translation3::from(step.axis.into_inner() * middle);
                    slack += half;
                }
                StepKind::Turn => {
                    let (along, length) =
                        shortest_string(&self.chain.steps[index..], &self.chain.tail, limits, true);
                    let centre = start * nalgebra::Point3::from(step.axis.into_inner() * along);
                    return Reach { centre: centre.coords, radius: slack + length };
                }
            }
        }
        Reach { centre: (start * self.chain.tail).translation.vector, radius: slack }
    }
}

/// A revolute axis of the string, or its end.
struct Knot {
    /// From the frame after the knot before to the joint frame here.
    pose: Pose,
    /// Its axis in that frame; the chosen point is `axis * along`. Zero for the end.
    axis: Vec3,
    along: f64,
}

/// The steps with the first one as a revolute step, whatever it is.
fn turning(steps: &[ChainStep]) -> Vec<ChainStep> {
    let mut steps = steps.to_vec();
    if let Some(first) = steps.first_mut() {
        first.kind = StepKind::Turn;
    }
    steps
}

/// Lays the shortest string from the axis of `steps[0]`, a revolute one, to the origin of the frame
/// `tail` after the last step; from any point of the axis if `free`, else from its joint frame's
/// origin. Returns where along that first axis it starts, and its length.
fn shortest_string(steps: &[ChainStep], tail: &Pose, limits: &[JointLimits], free: bool) -> (f64, f64) {
    let mut knots: Vec<Knot> = Vec::with_capacity(steps.len() + 1);
    let mut pose = Pose::identity();
    let mut slack = 0.0;
    for step in steps {
        if !knots.is_empty() {
            pose *= step.fixed;
        }
        match step.kind {
            StepKind::Turn => {
                knots.push(Knot { pose, axis: step.axis.into_inner(), along: 0.0 });
                pose = Pose::identity();
            }
            StepKind::Slide => {
                let (middle, half) = slide_range(step, limits);
                pose *= nalgebra::Translation3::from(step.axis.into_inner() * middle);
                slack += half;
            }
        }
    }
    knots.push(Knot { pose: pose * tail, axis: Vec3::zeros(), along: 0.0 });

    for _ in 0..ROUNDS {
        for index in (usize::from(!free)..knots.len() - 1).rev() {
            let axis = knots[index].axis;
            // Height along the axis and distance from it.
            let seen = |point: Vec3| (point.dot(&axis), (point - axis * point.dot(&axis)).norm());
            let next = &knots[index + 1];
            let (height_after, off_after) =
                seen((next.pose * nalgebra::Point3::from(next.axis * next.along)).coords);
            let along = if index == 0 {
                height_after
            } else {
                let before = &knots[index - 1];
                let point = nalgebra::Point3::from(before.axis * before.along);
                let (height, off) = seen((knots[index].pose.inverse() * point).coords);
                let share = if off + off_after > 0.0 { off / (off + off_after) } else { 0.5 };
                height + (height_after - height) * share
            };
            knots[index].along = along;
        }
    }
    let length: f64 = knots
        .windows(2)
        .map(|pair| {
            let end = pair[1].pose * nalgebra::Point3::from(pair[1].axis * pair[1].along);
            (end.coords - pair[0].axis * pair[0].along).norm()
        })
        .sum();
    (knots[0].along, length + slack)
}

/// The middle of what a sliding step's value can be, and how far it can be from there (m).
fn slide_range(step: &ChainStep, limits: &[JointLimits]) -> (f64, f64) {
    let limit = &limits[step.joint];
    if !(limit.upper - limit.lower).is_finite() {
        return (0.0, f64::INFINITY);
    }
    let middle = step.multiplier * (limit.lower + limit.upper) / 2.0 + step.offset;
    (middle, step.multiplier.abs() * (limit.upper - limit.lower) / 2.0)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::kinematics::{NoMeshes, library, library_names};

    /// A rail, a skew arm, a prismatic wrist, and a link that mimics the first turn.
    const MIXED: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <link name="e"/><link name="flange"/>
        <joint name="rail" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 1 0"/>
            <limit lower="-0.5" upper="2" velocity="1"/></joint>
        <joint name="turn" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0.2 -1 0.4"/>
            <origin xyz="0.1 0.2 0.3" rpy="0 0.5 1"/><limit lower="-3" upper="3" velocity="1"/></joint>
        <joint name="out" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
            <origin xyz="0.1 0 0.2"/><limit lower="0.1" upper="0.4" velocity="1"/></joint>
        <joint name="swing" type="revolute"><parent link="d"/><child link="e"/><axis xyz="0 1 1"/>
            <origin xyz="0.3 0 0.1"/><limit lower="-2" upper="1" velocity="1"/></joint>
        <joint name="follow" type="revolute"><parent link="e"/><child link="flange"/><axis xyz="0 0 1"/>
            <origin xyz="0.4 0 0"/><mimic joint="turn" multiplier="-0.5" offset="0.1"/></joint></robot>"#;

    fn load(urdf: &str) -> ArmModel {
        ArmModel::from_urdf("r", urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
    }

    fn models() -> Vec<ArmModel> {
        let mut models: Vec<ArmModel> =
            library_names().map(|name| load(library(name).unwrap().urdf)).collect();
        models.push(load(MIXED));
        models
    }

    fn limits(model: &ArmModel) -> Vec<JointLimits> {
        model.joints.iter().map(|joint| joint.limits).collect()
    }

    fn within(limits: &[JointLimits], parts: &[f64]) -> Vec<f64> {
        limits.iter().zip(parts).map(|(l, part)| l.lower + part * (l.upper - l.lower)).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn no_point_moves_farther_than_its_levers_allow(
            from in prop::collection::vec(0.0..1.0_f64, 8), to in prop::collection::vec(0.0..1.0_f64, 8),
            part in 0.0..1.0_f64, only in 0..8_usize, point in prop::array::uniform3(-0.3..0.3_f64),
        ) {
            for model in models() {
                let limits = limits(&model);
                let q = within(&limits, &from);
                // Some joints move a part of the way to another configuration within the limits.
                let moved: Vec<f64> = q
                    .iter()
                    .zip(within(&limits, &to))
                    .enumerate()
                    .map(|(joint, (a, b))| {
                        if only < model.dof() && joint != only { *a } else { a + part * (b - a) }
                    })
                    .collect();
                let (mut before, mut after) = (Vec::new(), Vec::new());
                model.link_poses(&q, &mut before);
                model.link_poses(&moved, &mut after);
                let point = nalgebra::Point3::from(point);
                for link in 0..model.links.len() {
                    let way = (after[link] * point - before[link] * point).norm();
                    let bound: f64 = (0..model.dof())
                        .filter_map(|joint| {
                            let lever = model.lever(&limits, joint, link)?;
                            Some((moved[joint] - q[joint]).abs() * lever.at(point.coords.norm()))
                        })
                        .sum();
                    prop_assert!(way <= bound + 1e-9, "{} link {link}: {way} > {bound}", model.name);
                }
            }
        }

        #[test]
        fn the_mount_stays_within_reach(parts in prop::collection::vec(0.0..1.0_f64, 8)) {
            for model in models() {
                let limits = limits(&model);
                let reach = model.reach_within(&limits);
                let mount = model.mount_pose(&within(&limits, &parts)).translation.vector;
                prop_assert!((mount - reach.centre).norm() <= reach.radius + 1e-9);
            }
        }
    }

    proptest! {
        #[test]
        fn origins_keep_within_their_distance(parts in prop::collection::vec(0.0..1.0_f64, 8)) {
            for model in models() {
                let mut poses = Vec::new();
                model.link_poses(&within(&limits(&model), &parts), &mut poses);
                for (joint, moved) in model.joints.iter().map(|joint| joint.link).enumerate() {
                    let parent = model.links[moved].parent.map_or(Pose::identity(), |at| poses[at]);
                    let frame = parent * model.links[moved].origin;
                    for (link, pose) in poses.iter().enumerate() {
                        let Some(bound) = model.origin_distance(&limits(&model), joint, link) else {
                            prop_assert!(model.lever(&limits(&model), joint, link).is_none());
                            continue;
                        };
                        let distance = (pose.translation.vector - frame.translation.vector).norm();
                        prop_assert!(distance <= bound + 1e-9, "{} {joint} {link}", model.name);
                    }
                }
            }
        }
    }

    #[test]
    fn bounds_are_tight_for_the_iiwa() {
        let model = load(library("iiwa14").unwrap().urdf);
        let reach = model.reach_within(&limits(&model));
        assert!((reach.centre - Vec3::new(0.0, 0.0, 0.36)).norm() < 1e-6, "{}", reach.centre);
        assert!((reach.radius - 0.946).abs() < 1e-6, "{}", reach.radius);
        let limits = limits(&model);
        let flange = model.link_index("flange").unwrap();
        assert!((model.lever(&limits, 1, flange).unwrap().constant - 0.946).abs() < 1e-6);
        assert!((model.lever(&limits, 3, flange).unwrap().constant - 0.526).abs() < 1e-6);
        assert!(model.lever(&limits, 6, flange).unwrap().constant < 1e-6);
        assert_eq!(model.lever(&limits, 3, 2), None);
    }
}
