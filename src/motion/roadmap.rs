//! One arm's roadmap: free configurations and straight edges between neighbours (PRM*, Karaman
//! and Frazzoli 2011), validated lazily against the static workcell and remembered.

mod memo;
mod stored;

use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use rand::Rng as _;
use smallvec::SmallVec;

use crate::collision::{CollisionWorld, Exemption, Scene, StraightMotion};
use crate::kinematics::{Config, JointLimits};
use crate::run::{Control, Rng};
use crate::workcell::{Arm, ArmId};

use memo::EdgeMemo;
pub(super) use memo::{KnownEdges, Situation};

/// Configurations that are drawn and checked at a time.
const BATCH: usize = 8;

/// Vertices beyond which a roadmap does not grow: it takes up some tens of megabytes then.
const MOST_VERTICES: usize = 20_000;

/// Share of the draws that may lie outside a turn about home, where limited joints can turn so far.
const WINDING: f64 = 0.1;

/// Vertices that lie side by side in [`Roadmap::paced`].
const PACED: usize = 8;

/// So many more of the nearest in single precision are looked at exactly.
const SURPLUS: usize = 2;

/// What is known of an edge against the static workcell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Validity {
    Unknown,
    Free,
    Blocked,
}

/// An edge as seen from one of its ends: all that a search along it looks at, side by side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    /// Number of the edge, and the vertex at its other end.
    pub(super) edge: u32,
    pub(super) next: u32,
    /// Its length in [`Roadmap::distance`] (s).
    pub(super) length: f64,
}

/// What anybody found out about the edges that a roadmap had when it was shared. It saves checks
/// and decides nothing: a roadmap learns from it only what it asks.
#[derive(Debug, Default)]
struct SharedChecks(Vec<AtomicU8>);

impl SharedChecks {
    fn get(&self, edge: usize) -> Option<bool> {
        match self.0.get(edge)?.load(Ordering::Relaxed) {
            1 => Some(false),
            2 => Some(true),
            _ => None,
        }
    }

    fn set(&self, edge: usize, free: bool) {
        if let Some(known) = self.0.get(edge) {
            known.store(1 + u8::from(free), Ordering::Relaxed);
        }
    }
}

/// A roadmap of one arm. Grows by [`Roadmap::grow`]; edges join each vertex to its nearest
/// `e (1 + 1/d) ln n` neighbours, the PRM* rule on which asymptotic optimality rests.
///
/// Clones share what there is until one of them grows.
#[derive(Debug, Clone)]
pub struct Roadmap {
    arm: ArmId,
    /// Inverse of the joints' greatest speeds (s/rad).
    pace: Config,
    vertices: Arc<Vec<Config>>,
    /// The vertices times `pace`, eight of them side by side for each joint, to look for neighbours.
    paced: Arc<Vec<[f32; PACED]>>,
    /// The vertices at both ends, by edge.
    edges: Arc<Vec<[usize; 2]>>,
    /// By vertex, where its edges lead.
    incident: Arc<Vec<Vec<Link>>>,
    /// By edge.
    validity: Vec<Validity>,
    shared: Arc<SharedChecks>,
    memo: EdgeMemo,
}

impl Roadmap {
    /// An empty roadmap for `arm`.
    pub fn new(id: ArmId, arm: &Arm) -> Self {
        let pace = arm.limits.iter().map(|limit| 1.0 / limit.velocity).collect();
        Self {
            arm: id,
            pace,
            vertices: Arc::default(),
            paced: Arc::default(),
            edges: Arc::default(),
            incident: Arc::default(),
            validity: Vec::new(),
            shared: Arc::default(),
            memo: EdgeMemo::default(),
        }
    }

    /// Lets all clones made from now on share the checks of the edges that there are.
    pub fn share_checks(&mut self) {
        self.shared = Arc::new(SharedChecks(self.edges.iter().map(|_| AtomicU8::new(0)).collect()));
    }

    /// Whose roadmap it is.
    pub fn arm(&self) -> ArmId {
        self.arm
    }

    /// The configurations.
    #[inline]
    pub fn vertices(&self) -> &[Config] {
        &self.vertices
    }

    /// The edges at `vertex`: edge number and the vertex at its other end.
    #[inline]
    pub fn neighbours(&self, vertex: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.links(vertex).iter().map(|link| (link.edge as usize, link.next as usize))
    }

    /// The vertices at the two ends of an edge.
    #[cfg(test)]
    pub(super) fn edge_ends(&self, edge: usize) -> [usize; 2] {
        self.edges[edge]
    }

    /// The edges of a vertex.
    #[inline]
    pub(super) fn links(&self, vertex: usize) -> &[Link] {
        self.incident.get(vertex).map_or(&[], Vec::as_slice)
    }

    /// Distance between two configurations (s): Euclidean, each joint in units of its greatest
    /// speed.
    #[inline]
    pub fn distance(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.pace).map(|((x, y), pace)| ((x - y) * pace).powi(2)).sum::<f64>().sqrt()
    }

    /// The `count` vertices nearest to `q`, nearest first.
    pub fn nearest(&self, q: &[f64], count: usize) -> Vec<usize> {
        self.nearest_with_distance(q, count).into_iter().map(|(_, vertex)| vertex).collect()
    }

    fn nearest_with_distance(&self, q: &[f64], count: usize) -> Vec<(f64, usize)> {
        let total = self.vertices.len();
        let count = count.min(total);
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        // Single precision tells which are worth a closer look.
        let mut near: Vec<(f32, usize)> = Vec::with_capacity(total.next_multiple_of(PACED));
        let joints = self.pace.len();
        let target: SmallVec<[f32; 8]> =
            q.iter().zip(&self.pace).map(|(x, pace)| (x * pace) as f32).collect();
        for (block, values) in self.paced.chunks_exact(joints.max(1)).enumerate() {
            let mut squares = [0.0_f32; PACED];
            for (at, values) in target.iter().zip(values) {
                for (square, value) in squares.iter_mut().zip(values) {
                    *square += (at - value) * (at - value);
                }
            }
            near.extend(squares.iter().enumerate().map(|(n, square)| (*square, PACED * block + n)));
        }
        near.truncate(total);
        let some = count + SURPLUS;
        if some < near.len() {
            near.select_nth_unstable_by(some, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            near.truncate(some);
        }
        let mut exact: Vec<(f64, usize)> =
            near.iter().map(|&(_, vertex)| (self.distance(q, &self.vertices[vertex]), vertex)).collect();
        exact.sort_unstable_by(by_distance);
        exact.truncate(count);
        exact
    }

    /// How many neighbours a vertex is joined to.
    pub fn degree(&self) -> usize {
        let d = self.pace.len().max(1) as f64;
        let n = self.vertices.len().max(2) as f64;
        ((std::f64::consts::E * (1.0 + 1.0 / d) * n.ln()).ceil() as usize).max(4)
    }

    /// Adds `count` free configurations, half of them uniform within the limits and half around
    /// `home`, unless `control` stops it. Joints that can turn farther than once stay mostly within a turn.
    pub fn grow(
        &mut self,
        world: &CollisionWorld,
        arm: &Arm,
        count: usize,
        control: &Control,
        rng: &mut Rng,
    ) {
        let empty = Scene::default();
        let mut tries = 0;
        let target = (self.vertices.len() + count).min(MOST_VERTICES);
        if self.vertices.is_empty() {
            self.insert(arm.home.clone());
        }
        let mut drawn: Vec<Config> = Vec::with_capacity(BATCH);
        while self.vertices.len() < target && tries < 20 * count {
            if tries % (8 * BATCH) == 0 && control.should_stop() {
                break;
            }
            drawn.clear();
            drawn.extend((0..BATCH).map(|_| draw(arm, rng)));
            tries += BATCH;
            let free = {
                let slices: SmallVec<[&[f64]; BATCH]> = drawn.iter().map(|q| &q[..]).collect();
                world.configs_free(self.arm, &slices, None, &empty, Exemption::default())
            };
            for (q, free) in drawn.drain(..).zip(free) {
                if free && self.vertices.len() < target {
                    self.insert(q);
                }
            }
        }
    }

    /// Adds what lies between the ends of a free path, and the edges along it, for later searches.
    pub(super) fn learn(&mut self, path: &[Config]) {
        let inner = path.get(1..path.len().saturating_sub(1)).unwrap_or_default();
        for (n, q) in inner.iter().enumerate() {
            let vertex = self.vertices.len();
            self.insert(q.clone());
            if n > 0 && !self.neighbours(vertex).any(|(_, other)| other + 1 == vertex) {
                self.join(vertex - 1, vertex, self.distance(&inner[n - 1], q));
            }
        }
    }

    fn join(&mut self, one: usize, other: usize, length: f64) {
        let (edges, incident) = (Arc::make_mut(&mut self.edges), Arc::make_mut(&mut self.incident));
        let link = |next: usize| Link { edge: edges.len() as u32, next: next as u32, length };
        let (there, back) = (link(other), link(one));
        incident[one].push(there);
        incident[other].push(back);
        edges.push([one, other]);
        self.validity.push(Validity::Unknown);
    }

    fn insert(&mut self, q: Config) {
        let near = self.nearest_with_distance(&q, self.degree());
        let vertex = self.vertices.len();
        Arc::make_mut(&mut self.incident).push(Vec::with_capacity(near.len()));
        for (length, other) in near {
            self.join(other, vertex, length);
        }
        self.push_paced(vertex, &q);
        Arc::make_mut(&mut self.vertices).push(q);
    }

    /// Lays the next vertex, `q`, beside those before it in [`Self::paced`].
    fn push_paced(&mut self, vertex: usize, q: &Config) {
        let (joints, slot) = (self.pace.len(), vertex % PACED);
        let paced = Arc::make_mut(&mut self.paced);
        if slot == 0 {
            paced.resize(paced.len() + joints, [0.0; PACED]);
        }
        let first = paced.len() - joints;
        for ((values, x), pace) in paced[first..].iter_mut().zip(q).zip(&self.pace) {
            values[slot] = (x * pace) as f32;
        }
    }

    /// Whether the edge is free of the static workcell, the arm's hand empty; checked at most once.
    pub fn edge_free(&mut self, world: &CollisionWorld, edge: usize) -> bool {
        if self.validity[edge] == Validity::Unknown {
            let free = self.shared.get(edge).unwrap_or_else(|| self.check(world, edge));
            self.validity[edge] = if free { Validity::Free } else { Validity::Blocked };
        }
        self.validity[edge] == Validity::Free
    }

    fn check(&self, world: &CollisionWorld, edge: usize) -> bool {
        let [a, b] = self.edges[edge];
        let motion = StraightMotion::new(&self.vertices[a], &self.vertices[b]);
        let resting = world.resting_atoms(&Scene::default());
        let free = world.static_free(self.arm, &motion, None, &resting, Exemption::default());
        self.shared.set(edge, free);
        free
    }

    /// Takes out what is known of edges in a situation; to be given back by [`Self::remember`].
    pub(super) fn recall(&mut self, situation: &Situation) -> KnownEdges {
        self.memo.take(situation)
    }

    /// Remembers what is known of edges in a situation.
    pub(super) fn remember(&mut self, situation: Situation, known: KnownEdges) {
        self.memo.give_back(situation, known);
    }

    /// Whether the edge is known to be blocked by the static workcell.
    #[inline]
    pub fn known_blocked(&self, edge: usize) -> bool {
        self.validity[edge] == Validity::Blocked
    }
}

/// A configuration, uniform within the limits or around `home`; of joints that can turn farther than once, mostly
/// within [`one_turn`] about `home`.
pub(super) fn draw(arm: &Arm, rng: &mut Rng) -> Config {
    let around_home = rng.random_bool(0.5);
    let winds = (0..arm.limits.len()).any(|joint| can_wind(arm, joint)) && rng.random_bool(WINDING);
    let joints = arm.limits.iter().zip(&arm.home).enumerate();
    let value = |(joint, (limit, home)): (usize, (&JointLimits, &f64))| {
        let is_bounded = limit.lower.is_finite() && limit.upper.is_finite();
        let (lower, upper) = match winds && is_bounded {
            true => (limit.lower, limit.upper),
            false => one_turn(arm, joint, *home),
        };
        if around_home {
            let half = (upper - lower) / 5.0;
            (home + rng.random_range(-half..=half)).clamp(lower, upper)
        } else {
            rng.random_range(lower..=upper)
        }
    };
    joints.map(value).collect()
}

/// Whether a joint of `arm` can turn farther than once, and a turn brings the arm back to where it was.
fn can_wind(arm: &Arm, joint: usize) -> bool {
    let limit = &arm.limits[joint];
    limit.upper - limit.lower > TAU && arm.model.is_periodic(joint)
}

/// The limits of a joint of `arm`; where it [`can_wind`], those of one whole turn within them, about `middle` as far as
/// they allow: there [`crate::kinematics::ArmModel::unwind`] puts it. So, too, of a joint without an end whose turns are
/// told apart by what follows it.
pub(super) fn one_turn(arm: &Arm, joint: usize, middle: f64) -> (f64, f64) {
    let JointLimits { lower, upper, .. } = arm.limits[joint];
    if !can_wind(arm, joint) && lower.is_finite() && upper.is_finite() {
        return (lower, upper);
    }
    let from = (middle - PI).min(upper - TAU).max(lower);
    (from, (from + TAU).min(upper))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::LinkMotion;
    use crate::run::Seed;
    use crate::scenario::{Family, RobotKind, generate_with};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

    fn problem(kind: RobotKind) -> crate::problem::Problem {
        let value = generate_with(Family::Ring, 3, 2, 0, &[kind]).unwrap();
        read_problem_value(&value, &LibraryOnly, &ReadLimits::default()).unwrap().problem
    }

    #[test]
    fn a_joint_that_can_wind_is_sampled_over_a_whole_turn_within_its_limits() {
        let mut arm = problem(RobotKind::UrType).workcell.arms[0].clone();
        for (limits, middle, turn) in [
            ([-TAU, TAU], 1.5 * PI, [0.0, TAU]),
            ([-TAU, TAU], 0.3, [0.3 - PI, 0.3 + PI]),
            ([-TAU, TAU], -6.0, [-TAU, 0.0]),
            ([f64::NEG_INFINITY, f64::INFINITY], 9.0, [9.0 - PI, 9.0 + PI]),
            ([-3.0, 3.0], 1.0, [-3.0, 3.0]),
        ] {
            [arm.limits[0].lower, arm.limits[0].upper] = limits;
            let (lower, upper) = one_turn(&arm, 0, middle);
            assert!(
                (lower - turn[0]).abs() < 1e-12 && (upper - turn[1]).abs() < 1e-12,
                "{limits:?} {middle}"
            );
        }
        [arm.limits[0].lower, arm.limits[0].upper] = [-TAU, TAU];
        arm.home[0] = 1.5 * PI;
        let mut rng = Seed(1).stream("draw");
        let drawn: Vec<f64> = (0..4000).map(|_| draw(&arm, &mut rng)[0]).collect();
        let share = |from: f64, to: f64| {
            drawn.iter().filter(|value| (from..to).contains(*value)).count() as f64 / drawn.len() as f64
        };
        // Nine in ten lie within the turn, where none of its sixths is missing; the others anywhere.
        let outside = share(-TAU, 0.0);
        assert!((0.01..0.1).contains(&outside), "{outside}");
        assert!(
            (0..6).all(|sixth| share(f64::from(sixth) * TAU / 6.0, f64::from(sixth + 1) * TAU / 6.0) > 0.05)
        );
    }

    #[test]
    fn an_endless_joint_that_drives_another_by_half_is_sampled() {
        let mut arm = problem(RobotKind::UrType).workcell.arms[0].clone();
        [arm.limits[0].lower, arm.limits[0].upper] = [f64::NEG_INFINITY, f64::INFINITY];
        for link in &mut std::sync::Arc::make_mut(&mut arm.model).links {
            if let LinkMotion::Revolute { joint: 0, multiplier, .. } = &mut link.motion {
                *multiplier = 0.5;
            }
        }
        assert!(!arm.model.is_periodic(0));
        let mut rng = Seed(1).stream("draw");
        assert!((0..200).all(|_| draw(&arm, &mut rng)[0].abs() <= arm.home[0].abs() + TAU));
    }

    #[test]
    fn a_way_that_was_learnt_is_there() {
        let problem = problem(RobotKind::Iiwa14);
        let world = CollisionWorld::new(&problem);
        let arm = &problem.workcell.arms[0];
        let mut rng = Seed(2).stream("learn");
        let mut roadmap = Roadmap::new(ArmId(0), arm);
        roadmap.grow(&world, arm, 60, &Control::unbounded(), &mut rng);
        let path: Vec<Config> = (0..5).map(|_| draw(arm, &mut rng)).collect();
        let before = roadmap.vertices().len();
        roadmap.learn(&path);
        assert_eq!(roadmap.vertices()[before..], path[1..4]);
        for vertex in before..before + 2 {
            assert_eq!(roadmap.neighbours(vertex).filter(|(_, other)| *other == vertex + 1).count(), 1);
        }
    }
}
