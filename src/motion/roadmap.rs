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

/// Share of the vertices that may lie farther than half a turn from home, where joints can turn so far.
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

/// An undirected edge.
#[derive(Debug, Clone)]
pub struct Edge {
    /// Its vertices.
    pub ends: [usize; 2],
    /// Its length in [`Roadmap::distance`] (s).
    pub length: f64,
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
    edges: Arc<Vec<Edge>>,
    /// Edge numbers by vertex.
    incident: Arc<Vec<Vec<usize>>>,
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
    pub fn vertices(&self) -> &[Config] {
        &self.vertices
    }

    /// The edges at `vertex`: edge number and the vertex at its other end.
    pub fn neighbours(&self, vertex: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.incident.get(vertex).into_iter().flatten().map(move |&edge| {
            let [a, b] = self.edges[edge].ends;
            (edge, if a == vertex { b } else { a })
        })
    }

    /// The edge with number `edge`.
    pub fn edge(&self, edge: usize) -> &Edge {
        &self.edges[edge]
    }

    /// Distance between two configurations (s): Euclidean, each joint in units of its greatest
    /// speed.
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
    /// `home`, unless `control` stops it.
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
        let target = self.vertices.len() + count;
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

    /// Adds what lies between the ends of a free path, for later searches.
    pub(super) fn learn(&mut self, path: &[Config]) {
        let inner = path.get(1..path.len().saturating_sub(1)).unwrap_or_default();
        inner.iter().for_each(|q| self.insert(q.clone()));
    }

    fn insert(&mut self, q: Config) {
        let near = self.nearest_with_distance(&q, self.degree());
        let vertex = self.vertices.len();
        let (edges, incident) = (Arc::make_mut(&mut self.edges), Arc::make_mut(&mut self.incident));
        incident.push(Vec::with_capacity(near.len()));
        for (length, other) in near {
            let edge = edges.len();
            edges.push(Edge { ends: [other, vertex], length });
            self.validity.push(Validity::Unknown);
            incident[other].push(edge);
            incident[vertex].push(edge);
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
        let [a, b] = self.edges[edge].ends;
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
    pub fn known_blocked(&self, edge: usize) -> bool {
        self.validity[edge] == Validity::Blocked
    }
}

/// A configuration, uniform within the limits or around `home`; of joints that can turn farther than once, mostly
/// within the turn around `home`, where contacts are.
pub(super) fn draw(arm: &Arm, rng: &mut Rng) -> Config {
    let around_home = rng.random_bool(0.5);
    let can_wind = |joint: usize| {
        let limit = &arm.limits[joint];
        limit.upper - limit.lower > TAU && arm.model.is_periodic(joint)
    };
    let winds = (0..arm.limits.len()).any(can_wind) && rng.random_bool(WINDING);
    arm.limits
        .iter()
        .zip(&arm.home)
        .enumerate()
        .map(|(joint, (limit, home))| {
            let (lower, upper) = bounded(limit, *home, !winds && can_wind(joint));
            if around_home {
                let half = (upper - lower) / 5.0;
                (home + rng.random_range(-half..=half)).clamp(lower, upper)
            } else {
                rng.random_range(lower..=upper)
            }
        })
        .collect()
}

/// Limits to sample within: those of a joint that is continuous, or is to stay `near` home, are a turn around home.
fn bounded(limit: &JointLimits, home: f64, near: bool) -> (f64, f64) {
    let (lower, upper) = (limit.lower, limit.upper);
    let lower = if near || lower.is_infinite() { lower.max(home - PI) } else { lower };
    let upper = if near || upper.is_infinite() { upper.min(home + PI) } else { upper };
    (lower, upper)
}
