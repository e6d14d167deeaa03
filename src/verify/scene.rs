//! Every body of the problem, and which pairs are looked at.

use super::chain::Chain;
use super::custody::Custody;
use super::gap::{Frame, Part};
use super::straight::{Touch, Window};
use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::problem::{ContactPartner, Problem};
use crate::workcell::{ArmId, ObjectId, ObstacleId};

/// What a body belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Owner {
    /// A rigid group of an arm, by its node in the arm's chain.
    Arm {
        arm: usize,
        node: usize,
    },
    Obstacle(usize),
    Object(usize),
}

/// A rigid union of convex parts.
#[derive(Debug, Clone)]
pub(super) struct Body {
    pub owner: Owner,
    pub parts: Vec<Part>,
    /// By part: the link or tool, obstacle or object that it comes from.
    pub names: Vec<String>,
    /// A ball around all parts, in the body's frame.
    pub centre: Vec3,
    pub radius: f64,
}

/// Two bodies that must not touch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub a: usize,
    pub b: usize,
    /// The moving nodes that both share on the way from one arm's root; 0 for different arms.
    pub common: usize,
    /// Whether the pair counts for the least clearance.
    pub counted: bool,
}

/// All bodies: arms first, then obstacles, then objects.
#[derive(Debug)]
pub(super) struct Scene<'p> {
    problem: &'p Problem,
    pub bodies: Vec<Body>,
    first_object: usize,
    /// Pairs that do not depend on the objects.
    pub standing: Vec<Pair>,
}

impl<'p> Scene<'p> {
    /// The bodies of `problem`, whose arms are `chains`.
    pub(super) fn new<'c>(problem: &'p Problem, chain: impl Fn(usize) -> &'c Chain) -> Self {
        let cell = &problem.workcell;
        let mut bodies = Vec::new();
        for (index, arm) in cell.arms.iter().enumerate() {
            let chain = chain(index);
            let mut parts: Vec<Vec<(Part, String)>> = vec![Vec::new(); chain.len()];
            let mut add = |node: usize, frame: &Frame, shape: &PlacedShape, name: String| {
                parts[node].push((Part::placed(shape, frame), name));
            };
            for (link_index, link) in arm.model.links.iter().enumerate() {
                let (node, frame) = chain.link(link_index);
                for shape in &link.shapes {
                    add(node, &frame, shape, format!("{}/{}", arm.id, link.name));
                }
            }
            let (node, frame) = chain.link(arm.model.mount);
            for shape in &arm.tool.shapes {
                add(node, &frame, shape, format!("{}/@tool", arm.id));
            }
            for (node, parts) in parts.into_iter().enumerate().filter(|(_, parts)| !parts.is_empty()) {
                bodies.push(Body::new(Owner::Arm { arm: index, node }, parts));
            }
        }
        let first_obstacle = bodies.len();
        for (index, obstacle) in cell.obstacles.iter().enumerate() {
            bodies.push(Body::of_shapes(Owner::Obstacle(index), &obstacle.shapes, &obstacle.id));
        }
        let first_object = bodies.len();
        for (index, object) in problem.objects.iter().enumerate() {
            bodies.push(Body::of_shapes(Owner::Object(index), &object.shapes, &object.id));
        }
        let mut scene = Self { problem, bodies, first_object, standing: Vec::new() };
        for a in 0..first_obstacle {
            for b in a + 1..first_object {
                scene.standing.extend(scene.standing_pair(a, b, &chain));
            }
        }
        scene
    }

    /// The frame of an obstacle or of the world.
    pub(super) fn obstacle_pose(&self, obstacle: usize) -> &Pose {
        &self.problem.workcell.obstacles[obstacle].pose
    }

    /// The bodies of objects.
    pub(super) fn objects(&self) -> std::ops::Range<usize> {
        self.first_object..self.bodies.len()
    }

    /// A pair of arm against arm or obstacle, unless it is exempt for good.
    fn standing_pair<'c>(&self, a: usize, b: usize, chain: &impl Fn(usize) -> &'c Chain) -> Option<Pair> {
        let cell = &self.problem.workcell;
        let Owner::Arm { arm, node } = self.bodies[a].owner else { return None };
        let group = chain(arm).group(node);
        match self.bodies[b].owner {
            Owner::Arm { arm: other, node: other_node } if other == arm => {
                let other_group = chain(arm).group(other_node);
                let checked = cell.arms[arm].checks_groups(group, other_group);
                let common = chain(arm).common(node, other_node);
                checked.then_some(Pair { a, b, common, counted: false })
            }
            Owner::Arm { arm: other, node: other_node } => {
                let one = (ArmId(arm), group);
                let two = (ArmId(other), chain(other).group(other_node));
                let allowed =
                    cell.allowed_arm_arm.iter().any(|pair| *pair == (one, two) || *pair == (two, one));
                (!allowed).then_some(Pair { a, b, common: 0, counted: true })
            }
            Owner::Obstacle(obstacle) => {
                let allowed = cell.allowed_arm_obstacle.contains(&(ArmId(arm), group, ObstacleId(obstacle)));
                (!allowed).then_some(Pair { a, b, common: 0, counted: true })
            }
            Owner::Object(_) => None,
        }
    }

    /// Appends the pairs of objects against all else while they are where `custody` says and
    /// `windows` are open.
    pub(super) fn object_pairs<'c>(
        &self,
        custody: &[Custody],
        windows: &[Window],
        chain: impl Fn(usize) -> &'c Chain,
        out: &mut Vec<Pair>,
    ) {
        for b in self.objects() {
            let object = b - self.first_object;
            let held = match custody[object] {
                Custody::Held { arm, .. } => Some(arm.0),
                Custody::Resting { .. } => None,
            };
            let may_touch = |partner: ContactPartner| self.problem.may_touch(ObjectId(object), partner);
            let open = |touch: Touch| windows.iter().any(|w| w.object.0 == object && w.touch == touch);
            for a in 0..b {
                match self.bodies[a].owner {
                    Owner::Arm { arm, node } => {
                        let group = chain(arm).group(node);
                        let in_hand = self.problem.workcell.arms[arm].hand_groups.contains(&group);
                        if (in_hand && (held == Some(arm) || open(Touch::Hand(ArmId(arm)))))
                            || may_touch(ContactPartner::ArmGroup(ArmId(arm), group))
                        {
                            continue;
                        }
                        let own = held == Some(arm);
                        let common = if own { chain(arm).common(node, chain(arm).mount()) } else { 0 };
                        out.push(Pair { a, b, common, counted: !own });
                    }
                    Owner::Obstacle(obstacle) => {
                        let carries = match custody[object] {
                            Custody::Resting { surface, .. } => {
                                self.problem.workcell.surfaces[surface.0].carrier
                                    == Some(ObstacleId(obstacle))
                            }
                            Custody::Held { .. } => false,
                        };
                        if !carries
                            && !open(Touch::Carrier(ObstacleId(obstacle)))
                            && !may_touch(ContactPartner::Obstacle(ObstacleId(obstacle)))
                        {
                            out.push(Pair { a, b, common: 0, counted: held.is_some() });
                        }
                    }
                    Owner::Object(other) => {
                        if may_touch(ContactPartner::Object(ObjectId(other))) {
                            continue;
                        }
                        let held_too = matches!(custody[other], Custody::Held { .. });
                        out.push(Pair { a, b, common: 0, counted: held.is_some() || held_too });
                    }
                }
            }
        }
    }
}

impl Body {
    fn of_shapes(owner: Owner, shapes: &[PlacedShape], name: &str) -> Self {
        let frame = Frame::identity();
        Self::new(owner, shapes.iter().map(|shape| (Part::placed(shape, &frame), name.to_owned())).collect())
    }

    fn new(owner: Owner, parts: Vec<(Part, String)>) -> Self {
        let (parts, names): (Vec<Part>, Vec<String>) = parts.into_iter().unzip();
        let low =
            parts.iter().map(|p| p.centre.add_scalar(-p.radius)).reduce(|a, b| a.inf(&b)).unwrap_or_default();
        let high =
            parts.iter().map(|p| p.centre.add_scalar(p.radius)).reduce(|a, b| a.sup(&b)).unwrap_or_default();
        let centre = if let [only] = parts.as_slice() { only.centre } else { (low + high) * 0.5 };
        let radius = parts.iter().map(|p| (p.centre - centre).norm() + p.radius).fold(0.0, f64::max);
        Self { owner, parts, names, centre, radius: radius * (1.0 + 1e-12) }
    }
}
