//! One arm's roadmap: free configurations and straight edges between neighbours (PRM*, Karaman
//! and Frazzoli 2011), validated lazily against the static workcell and remembered.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, Scene, StraightMotion};
use crate::kinematics::Config;
use crate::run::{Control, Rng};
use crate::workcell::{Arm, ArmId};

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
    validity: Validity,
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
#[derive(Debug, Clone)]
pub struct Roadmap {
    arm: ArmId,
    /// Inverse of the joints' greatest speeds (s/rad).
    pace: Config,
    vertices: Vec<Config>,
    edges: Vec<Edge>,
    /// Edge numbers by vertex.
    incident: Vec<Vec<usize>>,
    shared: Arc<SharedChecks>,
}

impl Roadmap {
    /// An empty roadmap for `arm`.
    pub fn new(id: ArmId, arm: &Arm) -> Self {
        let pace = arm.limits.iter().map(|limit| 1.0 / limit.velocity).collect();
        let shared = Arc::default();
        Self { arm: id, pace, vertices: Vec::new(), edges: Vec::new(), incident: Vec::new(), shared }
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
        let mut by_distance: Vec<(f64, usize)> =
            self.vertices.iter().enumerate().map(|(i, v)| (self.distance(q, v), i)).collect();
        let count = count.min(by_distance.len());
        if count < by_distance.len() {
            by_distance.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            by_distance.truncate(count);
        }
        by_distance.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        by_distance.into_iter().map(|(_, i)| i).collect()
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
        while self.vertices.len() < target && tries < 20 * count {
            tries += 1;
            if tries % 64 == 0 && control.should_stop() {
                break;
            }
            let around_home = rng.random_bool(0.5);
            let q: Config = arm
                .limits
                .iter()
                .zip(&arm.home)
                .map(|(limit, home)| {
                    let (lower, upper) = bounded(limit.lower, limit.upper, *home);
                    if around_home {
                        let half = (upper - lower) / 5.0;
                        (home + rng.random_range(-half..=half)).clamp(lower, upper)
                    } else {
                        rng.random_range(lower..=upper)
                    }
                })
                .collect();
            if world.config_free(self.arm, &q, None, &empty, Exemption::default()) {
                self.insert(q);
            }
        }
    }

    fn insert(&mut self, q: Config) {
        let degree = self.degree();
        let near = self.nearest(&q, degree);
        let vertex = self.vertices.len();
        self.incident.push(Vec::new());
        for other in near {
            let length = self.distance(&q, &self.vertices[other]);
            let edge = self.edges.len();
            self.edges.push(Edge { ends: [other, vertex], length, validity: Validity::Unknown });
            self.incident[other].push(edge);
            self.incident[vertex].push(edge);
        }
        self.vertices.push(q);
    }

    /// Whether the edge is free of the static workcell, the arm's hand empty; checked at most once.
    pub fn edge_free(&mut self, world: &CollisionWorld, edge: usize) -> bool {
        if self.edges[edge].validity == Validity::Unknown {
            let free = self.shared.get(edge).unwrap_or_else(|| self.check(world, edge));
            self.edges[edge].validity = if free { Validity::Free } else { Validity::Blocked };
        }
        self.edges[edge].validity == Validity::Free
    }

    fn check(&self, world: &CollisionWorld, edge: usize) -> bool {
        let [a, b] = self.edges[edge].ends;
        let motion = StraightMotion::new(&self.vertices[a], &self.vertices[b]);
        let resting = world.resting_atoms(&Scene::default());
        let free = world.static_free(self.arm, &motion, None, &resting, Exemption::default());
        self.shared.set(edge, free);
        free
    }

    /// Whether the edge is known to be blocked by the static workcell.
    pub fn known_blocked(&self, edge: usize) -> bool {
        self.edges[edge].validity == Validity::Blocked
    }
}

/// Limits to sample within: those of a continuous joint are a turn around home.
fn bounded(lower: f64, upper: f64, home: f64) -> (f64, f64) {
    let lower = if lower.is_finite() { lower } else { home - std::f64::consts::PI };
    let upper = if upper.is_finite() { upper } else { home + std::f64::consts::PI };
    (lower, upper)
}
