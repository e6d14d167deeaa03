//! Every body of the problem, and which pairs are looked at.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::chain::Chain;
use super::custody::Custody;
use super::gap::{Frame, Part};
use super::straight::{Touch, Window};
use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::problem::{ContactPartner, Problem};
use crate::workcell::{ArmBody, ArmId, ObjectId, ObstacleId};

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
    /// Which parts are which of an arm's bodies; empty for all else.
    of_arm: Vec<(ArmBody, Range<usize>)>,
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
    /// Where only some of their parts must not touch each other: which, by [`Scene::parts_of`].
    some: Option<usize>,
}

impl Pair {
    /// Two bodies of which no parts may touch.
    fn new(a: usize, b: usize, common: usize, counted: bool) -> Self {
        Self { a, b, common, counted, some: None }
    }
}

/// Two of a kind in order.
fn ordered<T: Ord>(a: T, b: T) -> (T, T) {
    if b < a { (b, a) } else { (a, b) }
}

/// What arms may touch for good, objects left out.
struct Exempt {
    /// Per arm, groups that one movable joint joins.
    joined: BTreeSet<(usize, (usize, usize))>,
    /// Bodies of arms.
    bodies: BTreeSet<((ArmId, ArmBody), (ArmId, ArmBody))>,
    /// The arms of which any are, two by two, an arm with itself included.
    arms: BTreeSet<(usize, usize)>,
    /// Bodies of arms, and obstacles.
    obstacles: BTreeSet<(ArmId, ArmBody, ObstacleId)>,
    /// The arms and obstacles of which any are.
    beside: BTreeSet<(usize, usize)>,
}

impl Exempt {
    fn new(problem: &Problem) -> Self {
        let cell = &problem.workcell;
        let arms = || cell.arms.iter().enumerate();
        let joined = arms().flat_map(|(index, arm)| {
            arm.exempt_groups.iter().map(move |&(one, two)| (index, ordered(one, two)))
        });
        let own = arms().flat_map(|(index, arm)| {
            let id = ArmId(index);
            arm.exempt_bodies.iter().map(move |&(one, two)| ordered((id, one), (id, two)))
        });
        let of_two = cell.allowed_arm_arm.iter().map(|&(one, two)| ordered(one, two));
        Self {
            joined: joined.collect(),
            bodies: own.chain(of_two).collect(),
            arms: arms()
                .filter(|(_, arm)| !arm.exempt_bodies.is_empty())
                .map(|(index, _)| (index, index))
                .chain(cell.allowed_arm_arm.iter().map(|((one, _), (two, _))| ordered(one.0, two.0)))
                .collect(),
            obstacles: cell.allowed_arm_obstacle.iter().copied().collect(),
            beside: cell.allowed_arm_obstacle.iter().map(|(arm, _, obstacle)| (arm.0, obstacle.0)).collect(),
        }
    }
}

/// Parts of two bodies, by their numbers.
pub(super) type Runs = (Range<usize>, Range<usize>);

/// Which parts of two bodies must not touch each other.
enum Checked {
    All,
    None,
    /// All of these runs of the first and of the second.
    Some(Vec<Runs>),
}

/// All bodies: arms first, then obstacles, then objects.
#[derive(Debug)]
pub(super) struct Scene<'p> {
    problem: &'p Problem,
    pub bodies: Vec<Body>,
    first_object: usize,
    /// Pairs that do not depend on the objects.
    pub standing: Vec<Pair>,
    /// For pairs of which some parts may touch: those that must not.
    some: Vec<Vec<Runs>>,
    /// By object, and by body of an arm some of whose parts it may touch for good: the place in `some`, or nothing where it
    /// may touch all of them.
    allowed: BTreeMap<(usize, usize), Option<usize>>,
}

impl<'p> Scene<'p> {
    /// The bodies of `problem`, whose arms are `chains`.
    pub(super) fn new<'c>(problem: &'p Problem, chain: impl Fn(usize) -> &'c Chain) -> Self {
        let cell = &problem.workcell;
        let mut bodies = Vec::new();
        for (index, arm) in cell.arms.iter().enumerate() {
            let chain = chain(index);
            let mut parts: Vec<Vec<(Part, String)>> = vec![Vec::new(); chain.len()];
            let mut of_arm: Vec<Vec<(ArmBody, Range<usize>)>> = vec![Vec::new(); chain.len()];
            let mut add = |link: usize, shapes: &[PlacedShape], body: ArmBody, name: String| {
                let (node, frame) = chain.link(link);
                let first = parts[node].len();
                parts[node].extend(shapes.iter().map(|shape| (Part::placed(shape, &frame), name.clone())));
                if !shapes.is_empty() {
                    of_arm[node].push((body, first..parts[node].len()));
                }
            };
            for (link_index, link) in arm.model.links.iter().enumerate() {
                let name = format!("{}/{}", arm.id, link.name);
                add(link_index, &link.shapes, ArmBody::Link(link_index), name);
            }
            add(arm.model.mount, &arm.tool.shapes, ArmBody::Tool, format!("{}/@tool", arm.id));
            for (node, (parts, of_arm)) in parts.into_iter().zip(of_arm).enumerate() {
                if !parts.is_empty() {
                    bodies.push(Body { of_arm, ..Body::new(Owner::Arm { arm: index, node }, parts) });
                }
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
        let exempt = Exempt::new(problem);
        let named: BTreeSet<usize> =
            problem.allowed_object_contacts.iter().map(|(object, _)| object.0).collect();
        let (standing, some, allowed) = (Vec::new(), Vec::new(), BTreeMap::new());
        let mut scene = Self { problem, bodies, first_object, standing, some, allowed };
        for a in 0..first_obstacle {
            for b in a + 1..first_object {
                if let Some((pair, checked)) = scene.standing_pair(a, b, &exempt, &chain) {
                    match checked {
                        Checked::All => scene.standing.push(pair),
                        Checked::None => {}
                        Checked::Some(list) => {
                            let some = Some(scene.some.len());
                            scene.some.push(list);
                            scene.standing.push(Pair { some, ..pair });
                        }
                    }
                }
            }
            for &object in &named {
                scene.allow_object(object, a);
            }
        }
        scene
    }

    /// Notes what of an arm's body an object may touch for good.
    fn allow_object(&mut self, object: usize, body: usize) {
        let Owner::Arm { arm, .. } = self.bodies[body].owner else { return };
        let may_touch =
            |part: ArmBody| self.problem.may_touch(ObjectId(object), ContactPartner::Arm(ArmId(arm), part));
        let checked = self.checked(body, self.first_object + object, |part, _| !part.is_some_and(may_touch));
        match checked {
            Checked::All => {}
            Checked::None => {
                self.allowed.insert((object, body), None);
            }
            Checked::Some(list) => {
                self.allowed.insert((object, body), Some(self.some.len()));
                self.some.push(list);
            }
        }
    }

    /// Which parts of two bodies are checked against each other, by what `is_checked` says of the arms' bodies.
    fn checked(
        &self,
        a: usize,
        b: usize,
        is_checked: impl Fn(Option<ArmBody>, Option<ArmBody>) -> bool,
    ) -> Checked {
        let runs = |body: usize| -> Vec<(Option<ArmBody>, Range<usize>)> {
            let body = &self.bodies[body];
            match body.of_arm.as_slice() {
                [] => vec![(None, 0..body.parts.len())],
                of_arm => of_arm.iter().map(|(part, run)| (Some(*part), run.clone())).collect(),
            }
        };
        let (ours, theirs) = (runs(a), runs(b));
        let both = ours.iter().flat_map(|one| theirs.iter().map(move |other| (one, other)));
        let (open, exempt): (Vec<_>, Vec<_>) =
            both.partition(|((one, _), (other, _))| is_checked(*one, *other));
        match (open.is_empty(), exempt.is_empty()) {
            (_, true) => Checked::All,
            (true, false) => Checked::None,
            (false, false) => Checked::Some(
                open.into_iter().map(|((_, one), (_, other))| (one.clone(), other.clone())).collect(),
            ),
        }
    }

    /// The same of bodies of two arms, or of one.
    fn checked_arms(&self, a: usize, b: usize, (one, other): (usize, usize), exempt: &Exempt) -> Checked {
        if !exempt.arms.contains(&ordered(one, other)) {
            return Checked::All;
        }
        self.checked(a, b, |x, y| {
            let pair = x.zip(y).map(|(x, y)| ((ArmId(one), x), (ArmId(other), y)));
            !pair.is_some_and(|(x, y)| exempt.bodies.contains(&ordered(x, y)))
        })
    }

    /// Which parts of the pair's bodies must not touch each other, where these are not all.
    pub(super) fn parts_of(&self, pair: &Pair) -> Option<&[Runs]> {
        pair.some.map(|some| self.some[some].as_slice())
    }

    /// The frame of an obstacle or of the world.
    pub(super) fn obstacle_pose(&self, obstacle: usize) -> &Pose {
        &self.problem.workcell.obstacles[obstacle].pose
    }

    /// The bodies of objects.
    pub(super) fn objects(&self) -> std::ops::Range<usize> {
        self.first_object..self.bodies.len()
    }

    /// A pair of arm against arm or obstacle, and which of their parts are not exempt for good.
    fn standing_pair<'c>(
        &self,
        a: usize,
        b: usize,
        exempt: &Exempt,
        chain: &impl Fn(usize) -> &'c Chain,
    ) -> Option<(Pair, Checked)> {
        let Owner::Arm { arm, node } = self.bodies[a].owner else { return None };
        match self.bodies[b].owner {
            Owner::Arm { arm: other, node: other_node } if other == arm => {
                let groups = ordered(chain(arm).group(node), chain(arm).group(other_node));
                if groups.0 == groups.1 || exempt.joined.contains(&(arm, groups)) {
                    return None;
                }
                let checked = self.checked_arms(a, b, (arm, other), exempt);
                Some((Pair::new(a, b, chain(arm).common(node, other_node), false), checked))
            }
            Owner::Arm { arm: other, .. } => {
                let checked = self.checked_arms(a, b, (arm, other), exempt);
                Some((Pair::new(a, b, 0, true), checked))
            }
            Owner::Obstacle(obstacle) => {
                let checked = match exempt.beside.contains(&(arm, obstacle)) {
                    false => Checked::All,
                    true => self.checked(a, b, |x, _| {
                        !x.is_some_and(|x| exempt.obstacles.contains(&(ArmId(arm), x, ObstacleId(obstacle))))
                    }),
                };
                Some((Pair::new(a, b, 0, true), checked))
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
                        let some = match self.allowed.get(&(object, a)) {
                            None => None,
                            Some(None) => continue,
                            Some(some) => *some,
                        };
                        if in_hand && (held == Some(arm) || open(Touch::Hand(ArmId(arm)))) {
                            continue;
                        }
                        let own = held == Some(arm);
                        let common = if own { chain(arm).common(node, chain(arm).mount()) } else { 0 };
                        out.push(Pair { some, ..Pair::new(a, b, common, !own) });
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
                            out.push(Pair::new(a, b, 0, held.is_some()));
                        }
                    }
                    Owner::Object(other) => {
                        if may_touch(ContactPartner::Object(ObjectId(other))) {
                            continue;
                        }
                        let held_too = matches!(custody[other], Custody::Held { .. });
                        out.push(Pair::new(a, b, 0, held.is_some() || held_too));
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
        Self { owner, parts, names, of_arm: Vec::new(), centre, radius: radius * (1.0 + 1e-12) }
    }
}
