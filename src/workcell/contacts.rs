//! Which bodies of one arm may touch for good (FORMAT "What may touch"), decided once at load.

use std::collections::BTreeSet;
use std::f64::consts::PI;

use rand::Rng as _;

use crate::geometry::{ExactShape, Overlap, PlacedShape, Pose, Shape};
use crate::kinematics::{ArmModel, JointLimits};
use crate::run::Rng;
use crate::workcell::{ArmBody, BodyPair, bodies, body_pair};

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

/// The rigid groups that make the hand: the mount link's group and all groups below any link of it,
/// sorted. The mount link may be a bare frame beside the fingers, on the link that carries both.
pub fn hand_groups(model: &ArmModel) -> Vec<usize> {
    let Some(mount) = model.links.get(model.mount) else { return Vec::new() };
    // All that moves hangs on the root's group: a tool there has below it what its own link carries.
    let is_root = model.links.first().is_some_and(|root| root.group == mount.group);
    let mut below = vec![false; model.links.len()];
    let mut groups = BTreeSet::from([mount.group]);
    // Parents stand before their children.
    for (index, link) in model.links.iter().enumerate() {
        let is_mount = index == model.mount || (!is_root && link.group == mount.group);
        below[index] = is_mount || link.parent.is_some_and(|parent| below[parent]);
        if below[index] {
            groups.insert(link.group);
        }
    }
    groups.into_iter().collect()
}

/// What random configurations tell of an arm's bodies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overlaps {
    /// The pairs that overlap almost always, sorted.
    pub pairs: Vec<BodyPair>,
    /// The work that it took to find them, in units of about 10 ns; the same at every time.
    pub work: u64,
}

/// It takes more work than it may to find out which bodies overlap almost always.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the collision shapes are too many, too detailed or too close together to find out within reason which of \
     them overlap almost always"
)]
pub struct TooMuchWork;

/// Work that was done, and how much may be, in the units of [`Overlaps::work`].
struct Work {
    done: u64,
    most: u64,
}

impl Work {
    fn is_too_much(&self) -> bool {
        self.done > self.most
    }
}

/// Work of a look at two bounding balls, of which all other work is counted in multiples.
const BALLS: u64 = 1;
/// Work of a test of two shapes, and what each corner of a hull adds.
const TEST: (u64, u64) = (50, 2);
/// Work of measuring how deep two shapes are in each other, and what each corner of a hull adds.
const DEPTH: (u64, u64) = (1000, 40);

/// A shape of a body.
struct Part {
    /// The link that carries it.
    link: usize,
    shape: ExactShape,
    /// Corners, if it is a hull.
    corners: u64,
}

impl Part {
    fn new(link: usize, placed: &PlacedShape) -> Self {
        let corners = match &placed.shape {
            Shape::Convex(hull) => hull.vertices().len() as u64,
            _ => 0,
        };
        Self { link, shape: ExactShape::new(placed), corners }
    }

    /// Whether it overlaps `other`, a touch being none, with the links at `poses`. What that takes is
    /// added to `work`.
    fn overlaps(&self, other: &Self, poses: &[Pose], work: &mut Work) -> bool {
        let (body, other_body) = (&poses[self.link], &poses[other.link]);
        work.done += BALLS;
        if self.shape.ball_distance(body, &other.shape, other_body) > 0.0 {
            return false;
        }
        let of = |(plain, per_corner): (u64, u64)| plain + per_corner * (self.corners + other.corners);
        work.done += of(TEST);
        match self.shape.overlap(body, &other.shape, other_body) {
            Overlap::Apart => false,
            Overlap::Plain => {
                work.done += of(TEST);
                true
            }
            Overlap::Slight => {
                work.done += of(DEPTH);
                self.shape.signed_distance(body, &other.shape, other_body, 0.0) < 0.0
            }
        }
    }
}

/// A pair of bodies of which nothing is decided yet.
struct Undecided<'g> {
    pair: BodyPair,
    parts: [&'g [Part]; 2],
    /// In how many configurations it was apart, and in how many not.
    apart: usize,
    together: usize,
    /// The parts that overlapped last: they are likely to do so again.
    last: (usize, usize),
}

impl Undecided<'_> {
    /// Whether the bodies overlap with the links at `poses`; means nothing once `work` is too much.
    fn overlaps(&mut self, poses: &[Pose], work: &mut Work) -> bool {
        let [ours, theirs] = self.parts;
        let last = self.last;
        if ours[last.0].overlaps(&theirs[last.1], poses, work) {
            return true;
        }
        for (i, one) in ours.iter().enumerate() {
            for (j, other) in theirs.iter().enumerate() {
                if work.is_too_much() {
                    return false;
                }
                if (i, j) != last && one.overlaps(other, poses, work) {
                    self.last = (i, j);
                    return true;
                }
            }
        }
        false
    }
}

/// Pairs of bodies that overlap in more than 95 % of 1,000 configurations drawn from `rng` uniformly within `limits` (a
/// full turn for continuous joints); those that are rigidly joined, that one movable joint joins, and the `known` ones are
/// left out. `tool` are the tool's shapes.
///
/// # Errors
/// [`TooMuchWork`] when it takes more than `most_work`, in the units of [`Overlaps::work`].
pub fn almost_always_overlapping(
    model: &ArmModel,
    tool: &[PlacedShape],
    limits: &[JointLimits],
    known: &BTreeSet<BodyPair>,
    most_work: u64,
    rng: &mut Rng,
) -> Result<Overlaps, TooMuchWork> {
    let joined: BTreeSet<GroupPair> = neighbours(model).into_iter().collect();
    let all: Vec<(ArmBody, usize, Vec<Part>)> = bodies(model, tool)
        .map(|(body, link, shapes)| {
            (body, model.links[link].group, shapes.iter().map(|shape| Part::new(link, shape)).collect())
        })
        .collect();
    let mut open: Vec<Undecided<'_>> = Vec::new();
    for (index, (a, group, ours)) in all.iter().enumerate() {
        for (b, other, theirs) in &all[index + 1..] {
            let pair = body_pair(*a, *b);
            if group != other && !joined.contains(&group_pair(*group, *other)) && !known.contains(&pair) {
                let parts = [ours.as_slice(), theirs.as_slice()];
                open.push(Undecided { pair, parts, apart: 0, together: 0, last: (0, 0) });
            }
        }
    }
    // A pair is decided as soon as it was apart so often that it cannot be almost always in contact,
    // or in contact so often that it is, whatever is still to come.
    let enough_together = (SAMPLES as f64 * ALMOST_ALWAYS) as usize + 1;
    let enough_apart = SAMPLES + 1 - enough_together;
    let mut found = Vec::new();
    let mut work = Work { done: 0, most: most_work };
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
        open.retain_mut(|undecided| {
            if work.is_too_much() {
                return true;
            }
            if undecided.overlaps(&poses, &mut work) {
                undecided.together += 1;
            } else {
                undecided.apart += 1;
            }
            if undecided.together == enough_together {
                found.push(undecided.pair);
            }
            undecided.together < enough_together && undecided.apart < enough_apart
        });
        if work.is_too_much() {
            return Err(TooMuchWork);
        }
    }
    found.sort_unstable();
    Ok(Overlaps { pairs: found, work: work.done })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::kinematics::{Link, LinkMotion, NoMeshes, library};
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

    /// The usual hand: the tool's frame is a link of its own, beside the fingers.
    const BESIDE: &str = r#"<robot name="r"><link name="base"/><link name="upper"/><link name="camera"/>
        <link name="hand"/><link name="left"/><link name="tip"/><link name="right"/><link name="hand_tcp"/>
        <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
            <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="s" type="revolute"><parent link="upper"/><child link="camera"/><axis xyz="0 0 1"/>
            <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="b" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="1 0 0"/>
            <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="l" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/>
            <limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
        <joint name="t" type="revolute"><parent link="left"/><child link="tip"/><axis xyz="1 0 0"/>
            <limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
        <joint name="r" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
            <mimic joint="l"/><limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
        <joint name="tcp" type="fixed"><parent link="hand"/><child link="hand_tcp"/><origin xyz="0 0 0.1"/></joint>
        </robot>"#;

    #[test]
    fn fingers_beside_the_mount_link_belong_to_the_hand() {
        for mount in ["hand_tcp", "hand"] {
            let model = load(BESIDE, mount);
            let mut hand = ["hand", "left", "tip", "right"].map(|link| group(&model, link));
            hand.sort_unstable();
            assert_eq!(group(&model, "hand_tcp"), group(&model, "hand"));
            assert_eq!(hand_groups(&model), hand, "{mount}");
            // The joints before the hand alone are the arm's: a finger's is held.
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            assert_eq!(names, ["a", "b"]);
        }
        // On a finger, the other one is no part of the hand.
        let model = load(BESIDE, "left");
        let mut hand = ["left", "tip"].map(|link| group(&model, link));
        hand.sort_unstable();
        assert_eq!(hand_groups(&model), hand);
        // A bracket on the base does not make a hand of the arm that stands there, too.
        let mut model = load(BESIDE, "hand");
        model.links.push(Link {
            name: "bracket".to_owned(),
            parent: Some(0),
            origin: Pose::identity(),
            motion: LinkMotion::Held,
            group: 0,
            shapes: Vec::new(),
        });
        model.mount = model.links.len() - 1;
        assert_eq!(hand_groups(&model), [0]);
    }

    #[test]
    fn pairs_in_constant_overlap_are_found_and_others_are_not() {
        let model = load(FINGERS, "hand");
        let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
        let run = |known: &BTreeSet<_>, tool: &[PlacedShape]| {
            let mut rng = Seed(1).stream("test");
            almost_always_overlapping(&model, tool, &limits, known, u64::MAX, &mut rng).unwrap().pairs
        };
        // The ball around the upper link holds base and wrist, which are joined to it by one joint; base and wrist stay
        // 0.2 m apart.
        assert_eq!(run(&BTreeSet::new(), &[]), vec![]);
        // A tool that reaches back to the base: the wrist that carries it does not.
        let shape = crate::geometry::Shape::Sphere { radius: 0.6 };
        let tool = [PlacedShape { shape, pose: Pose::identity() }];
        let found = run(&BTreeSet::new(), &tool);
        let base = ArmBody::Link(model.link_index("base").unwrap());
        assert_eq!(found, vec![(base, ArmBody::Tool)]);
        assert!(run(&found.into_iter().collect(), &tool).is_empty());
    }

    #[test]
    fn the_library_arm_needs_no_exemption_beyond_its_srdf() {
        let robot = library("iiwa14").unwrap();
        let model = load(robot.urdf, "flange");
        let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
        let disabled = crate::kinematics::disabled_link_pairs(robot.srdf, &model).unwrap();
        let known = disabled.into_iter().map(|(a, b)| (ArmBody::Link(a), ArmBody::Link(b))).collect();
        let extra = overlapping(&model, &limits, &known, u64::MAX).unwrap();
        assert!(extra.pairs.is_empty(), "{extra:?}");
        // Next to nothing beside what a document may ask for.
        assert!(extra.work < 1_000_000, "{extra:?}");
    }

    fn overlapping(
        model: &ArmModel,
        limits: &[JointLimits],
        known: &BTreeSet<BodyPair>,
        most_work: u64,
    ) -> Result<Overlaps, TooMuchWork> {
        let mut rng = Seed(0).stream("test");
        almost_always_overlapping(model, &[], limits, known, most_work, &mut rng)
    }

    /// The rule as FORMAT has it: every pair in each of the configurations.
    fn by_the_letter(model: &ArmModel, limits: &[JointLimits]) -> Vec<BodyPair> {
        let mut rng = Seed(0).stream("test");
        let mut counts: BTreeMap<BodyPair, usize> = BTreeMap::new();
        let joined = neighbours(model);
        let bodies: Vec<Vec<ExactShape>> =
            model.links.iter().map(|link| link.shapes.iter().map(ExactShape::new).collect()).collect();
        let mut poses = Vec::new();
        for _ in 0..SAMPLES {
            let draw = |limit: &JointLimits| limit.lower + (limit.upper - limit.lower) * rng.random::<f64>();
            let q: Vec<f64> = limits.iter().map(draw).collect();
            model.link_poses(&q, &mut poses);
            let overlap = |i: usize, j: usize| {
                let mut pairs = bodies[i].iter().flat_map(|a| bodies[j].iter().map(move |b| (a, b)));
                pairs.any(|(a, b)| a.gap(&poses[i], b, &poses[j], 0.0) < 0.0)
            };
            for (i, one) in model.links.iter().enumerate() {
                for (j, other) in model.links.iter().enumerate().skip(i + 1) {
                    let groups = group_pair(one.group, other.group);
                    if one.group != other.group && !joined.contains(&groups) && overlap(i, j) {
                        *counts.entry((ArmBody::Link(i), ArmBody::Link(j))).or_default() += 1;
                    }
                }
            }
        }
        let often = |count: &usize| *count as f64 > SAMPLES as f64 * ALMOST_ALWAYS;
        counts.into_iter().filter(|(_, count)| often(count)).map(|(pair, _)| pair).collect()
    }

    #[test]
    fn the_short_way_finds_what_the_long_one_does() {
        // Turned through so much that the wrist's tip is in the base's ball in about 19 of 20 configurations.
        let swinging = |width: f64| {
            format!(
                r#"<robot name="r"><link name="base"><collision><geometry><sphere radius="0.3"/></geometry>
                </collision></link><link name="upper"/><link name="tip"><collision><origin xyz="0.5 0 0"/>
                <geometry><sphere radius="0.3"/></geometry></collision></link>
                <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0.5 0 0"/>
                    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
                <joint name="b" type="revolute"><parent link="upper"/><child link="tip"/><origin rpy="0 0 3.14159"/>
                    <axis xyz="0 1 0"/><limit lower="-{width}" upper="{width}" velocity="1" effort="1"/></joint>
                </robot>"#
            )
        };
        let mut answers = BTreeSet::new();
        let mut models = vec![load(FINGERS, "side"), load(library("panda_type").unwrap().urdf, "flange")];
        models.extend([0.2, 0.9, 1.0, 1.1, 1.2, 1.5].map(|width| load(&swinging(width), "tip")));
        for model in models {
            let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
            let found = overlapping(&model, &limits, &BTreeSet::new(), u64::MAX).unwrap().pairs;
            assert_eq!(found, by_the_letter(&model, &limits));
            answers.insert(found.len());
        }
        assert!(answers.contains(&0) && answers.len() > 1, "{answers:?}");
    }

    /// `count` cubes of 10 cm in one place, each turning on the one before.
    fn clump(count: usize) -> ArmModel {
        let link = |index: usize| {
            format!(
                r#"<link name="l{index}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>"#
            )
        };
        let joint = |index: usize| {
            format!(
                r#"<joint name="j{index}" type="revolute"><parent link="l{}"/><child link="l{index}"/><axis xyz="0 0 1"/>
                <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>"#,
                index - 1
            )
        };
        let links: String = (0..count).map(link).collect();
        let joints: String = (1..count).map(joint).collect();
        load(&format!("<robot name=\"r\">{links}{joints}</robot>"), &format!("l{}", count - 1))
    }

    #[test]
    fn a_clump_is_found_or_refused_always_alike() {
        let model = clump(8);
        let limits: Vec<_> = model.joints.iter().map(|joint| joint.limits).collect();
        let known = BTreeSet::new();
        let found = overlapping(&model, &limits, &known, u64::MAX).unwrap();
        assert_eq!(found.pairs.len(), 8 * 7 / 2 - 7);
        assert_eq!(overlapping(&model, &limits, &known, u64::MAX), Ok(found.clone()));
        assert_eq!(overlapping(&model, &limits, &known, found.work), Ok(found.clone()));
        assert_eq!(overlapping(&model, &limits, &known, found.work - 1), Err(TooMuchWork));
        // Work grows with the pairs, and stops at what it may be.
        assert_eq!(overlapping(&clump(100), &[limits[0]; 99], &BTreeSet::new(), 100_000), Err(TooMuchWork));
    }
}
