//! Which bodies of one arm may touch for good (FORMAT "What may touch"), decided once at load.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

use rand::Rng as _;

use crate::geometry::{ExactShape, PlacedShape, Pose};
use crate::kinematics::{ArmModel, JointLimits};
use crate::run::Rng;

/// How many random configurations decide whether a pair overlaps almost always.
pub const SAMPLES: usize = 1000;

/// A pair that overlaps in more than this share of the configurations is exempt.
pub const ALMOST_ALWAYS: f64 = 0.95;

/// A pair of rigid groups, lower index first.
pub type GroupPair = (usize, usize);

/// The pair of two groups in either order.
pub fn group_pair(a: usize, b: usize) -> GroupPair {
    (a.min(b), a.max(b))
}

/// Pairs of rigid groups that one movable joint joins, sorted, each once.
pub fn neighbours(model: &ArmModel) -> Vec<GroupPair> {
    let mut pairs = BTreeSet::new();
    for link in &model.links {
        if let Some(parent) = link.parent.and_then(|parent| model.links.get(parent))
            && parent.group != link.group
        {
            pairs.insert(group_pair(parent.group, link.group));
        }
    }
    pairs.into_iter().collect()
}

/// The rigid groups that make the hand: the mount link's group and all groups below the mount
/// link, sorted.
pub fn hand_groups(model: &ArmModel) -> Vec<usize> {
    let Some(mount) = model.links.get(model.mount) else { return Vec::new() };
    let mut below = vec![false; model.links.len()];
    let mut groups = BTreeSet::from([mount.group]);
    // Parents stand before their children.
    for (index, link) in model.links.iter().enumerate() {
        below[index] = index == model.mount || link.parent.is_some_and(|parent| below[parent]);
        if below[index] {
            groups.insert(link.group);
        }
    }
    groups.into_iter().collect()
}

/// Pairs of rigid groups, `known` left out, that overlap in more than 95 % of 1,000 configurations
/// drawn from `rng` uniformly within `limits` (a full turn for continuous joints); sorted. The
/// tool's shapes belong to the mount link's group.
pub fn almost_always_overlapping(
    model: &ArmModel,
    tool: &[PlacedShape],
    limits: &[JointLimits],
    known: &BTreeSet<GroupPair>,
    rng: &mut Rng,
) -> Vec<GroupPair> {
    // Shapes by group, each with the link that carries it.
    let mut groups: BTreeMap<usize, Vec<(usize, ExactShape)>> = BTreeMap::new();
    for (index, link) in model.links.iter().enumerate() {
        let carried = if index == model.mount { tool } else { &[] };
        for placed in link.shapes.iter().chain(carried) {
            groups.entry(link.group).or_default().push((index, ExactShape::new(placed)));
        }
    }
    // A pair is out as soon as it was apart so often that it cannot be almost always in contact.
    let may_be_apart = SAMPLES - (SAMPLES as f64 * ALMOST_ALWAYS) as usize;
    let mut open: Vec<(GroupPair, usize)> = Vec::new();
    for a in groups.keys() {
        for b in groups.keys().filter(|b| *b > a) {
            if !known.contains(&(*a, *b)) {
                open.push(((*a, *b), 0));
            }
        }
    }
    let mut poses = Vec::new();
    for _ in 0..SAMPLES {
        if open.is_empty() {
            break;
        }
        let q: Vec<f64> = limits
            .iter()
            .map(|limit| {
                let low = if limit.lower.is_finite() { limit.lower } else { -PI };
                let high = if limit.upper.is_finite() { limit.upper } else { PI };
                low + (high - low).max(0.0) * rng.random::<f64>()
            })
            .collect();
        model.link_poses(&q, &mut poses);
        open.retain_mut(|(pair, apart)| {
            if !groups_overlap(&groups, *pair, &poses) {
                *apart += 1;
            }
            *apart < may_be_apart
        });
    }
    open.into_iter().map(|(pair, _)| pair).collect()
}

fn groups_overlap(
    groups: &BTreeMap<usize, Vec<(usize, ExactShape)>>,
    (a, b): GroupPair,
    poses: &[Pose],
) -> bool {
    let (Some(a), Some(b)) = (groups.get(&a), groups.get(&b)) else { return false };
    a.iter().any(|(link_a, shape_a)| {
        b.iter().any(|(link_b, shape_b)| {
            shape_a.signed_distance(&poses[*link_a], shape_b, &poses[*link_b], 0.0) < 0.0
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{NoMeshes, library};
    use crate::run::Seed;

    const FINGERS: &str = r#"<robot name="r">
        <link name="base"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
        <link name="upper"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
        <link name="cover"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>
        <link name="wrist"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
        <link name="hand"/><link name="finger"/><link name="side"/>
        <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
            <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="s" type="revolute"><parent link="upper"/><child link="side"/><axis xyz="0 0 1"/>
            <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="c" type="fixed"><parent link="upper"/><child link="cover"/></joint>
        <joint name="b" type="continuous"><parent link="upper"/><child link="wrist"/><origin xyz="0.2 0 0.1"/>
            <axis xyz="1 0 0"/><limit velocity="1" effort="1"/></joint>
        <joint name="h" type="fixed"><parent link="wrist"/><child link="hand"/></joint>
        <joint name="f" type="prismatic"><parent link="hand"/><child link="finger"/><axis xyz="0 1 0"/>
            <limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
        </robot>"#;

    fn load(urdf: &str, mount: &str) -> ArmModel {
        ArmModel::from_urdf("r", urdf, mount, &BTreeMap::new(), &NoMeshes).unwrap().0
    }

    fn group(model: &ArmModel, link: &str) -> usize {
        model.links[model.link_index(link).unwrap()].group
    }

    #[test]
    fn hand_and_neighbours_follow_the_tree() {
        let model = load(FINGERS, "hand");
        let (base, upper, wrist) = (group(&model, "base"), group(&model, "upper"), group(&model, "wrist"));
        let (finger, side) = (group(&model, "finger"), group(&model, "side"));
        assert_eq!(group(&model, "cover"), upper);
        let expected: BTreeSet<_> = [
            group_pair(base, upper),
            group_pair(upper, side),
            group_pair(upper, wrist),
            group_pair(wrist, finger),
        ]
        .into();
        assert_eq!(neighbours(&model), expected.into_iter().collect::<Vec<_>>());
        let mut hand = vec![wrist, finger];
        hand.sort_unstable();
        assert_eq!(hand_groups(&model), hand);
    }

    #[test]
    fn pairs_in_constant_overlap_are_found_and_others_are_not() {
        let model = load(FINGERS, "hand");
        let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
        let run = |known: &BTreeSet<_>, tool: &[PlacedShape]| {
            almost_always_overlapping(&model, tool, &limits, known, &mut Seed(1).stream("test"))
        };
        let all = run(&BTreeSet::new(), &[]);
        // The ball around the upper link holds base and wrist; base and wrist stay 0.2 m apart.
        let (base, upper, wrist) = (group(&model, "base"), group(&model, "upper"), group(&model, "wrist"));
        assert_eq!(all, vec![group_pair(base, upper), group_pair(upper, wrist)]);
        assert!(run(&all.iter().copied().collect(), &[]).is_empty());
        // A tool that reaches back to the base.
        let shape = crate::geometry::Shape::Sphere { radius: 0.6 };
        let tool = [PlacedShape { shape, pose: Pose::identity() }];
        assert!(run(&BTreeSet::new(), &tool).contains(&group_pair(base, wrist)));
    }

    #[test]
    fn the_library_arm_needs_no_exemption_beyond_its_srdf() {
        let robot = library("iiwa14").unwrap();
        let model = load(robot.urdf, "flange");
        let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
        let mut known: BTreeSet<_> = neighbours(&model).into_iter().collect();
        known.extend(crate::kinematics::disabled_group_pairs(robot.srdf, &model).unwrap());
        let extra = almost_always_overlapping(&model, &[], &limits, &known, &mut Seed(0).stream("test"));
        assert!(extra.is_empty(), "{extra:?}");
    }
}
