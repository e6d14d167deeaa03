//! The search over the tensor product of the arms' roadmaps (dRRT: Solovey et al. 2016; with the
//! informed steering, rewiring and branch-and-bound of dRRT*: Shome et al. 2019).

use std::collections::BTreeMap;

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, JointMotion, Resting, StraightMotion, Taking};
use crate::kinematics::{Config, JointLimits};
use crate::problem::Problem;
use crate::run::{Control, Rng};
use crate::trajectory::{Curve, CurveTable, time_path};
use crate::workcell::ArmId;

use super::roadmap::Roadmap;
use super::schedule::find_conflict;
use super::task::{ArmGoal, ArmTask, StepTask};
use super::timed::{ArmMotion, CurveMotion, StepMotion, Window};

/// Vertices that the tree may have.
const GREATEST_TREE: usize = 1500;

/// How often the direct connection to the goal is tried: once in so many extensions.
const CONNECT_EVERY: usize = 8;

/// Extensions after the first path in which a shorter one is looked for: as many as before, at least and at
/// most so many.
const FEWEST_MORE: usize = 40;
const MOST_MORE: usize = 300;

/// In what order arms go along their lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    Together,
    Ascending,
    Descending,
}

const ORDERS: [Order; 3] = [Order::Together, Order::Ascending, Order::Descending];

/// Composite waypoints.
type CompositePath = Vec<Vec<Config>>;

/// Plans a step with all arms as one composite robot: leave, travel through the tensor product,
/// approach.
pub(super) fn plan(
    problem: &Problem,
    world: &CollisionWorld,
    roadmaps: &mut [Roadmap],
    task: &StepTask,
    control: &Control,
    rng: &mut Rng,
) -> Option<StepMotion> {
    let resting = world.resting_atoms(&task.scene);
    let from: Vec<Config> = task
        .arms
        .iter()
        .map(|arm| arm.departure.as_ref().and_then(|d| d.line.waypoints.last()).unwrap_or(&arm.start).clone())
        .collect();
    let to: Vec<Option<Config>> = task
        .arms
        .iter()
        .map(|arm| match &arm.goal {
            ArmGoal::Contact { approach: Some(line), .. } => line.waypoints.last().cloned(),
            ArmGoal::Contact { q, .. } => Some(q.clone()),
            _ => None,
        })
        .collect();
    let mut search = Composite { world, roadmaps, task, resting: &resting };
    let path = search.grow_tree(&from, &to, control, rng)?;
    // The order makes a difference only among several.
    let orders = |several: bool| if several { &ORDERS[..] } else { &ORDERS[..1] };
    let leaving = task.arms.iter().filter(|arm| arm.departure.is_some()).count();
    let approaches = |arm: &&ArmTask| matches!(arm.goal, ArmGoal::Contact { approach: Some(_), .. });
    let entering = task.arms.iter().filter(approaches).count();
    let mut orders = orders(leaving > 1)
        .iter()
        .flat_map(|&leave| orders(entering > 1).iter().map(move |&enter| (leave, enter)));
    orders.find_map(|order| {
        if control.should_stop() {
            return None;
        }
        assemble(problem, world, task, &resting, &path, order)
    })
}

/// A vertex of the composite tree.
struct Node {
    q: Vec<Config>,
    /// Roadmap vertex by arm, where the arm stands on one.
    at: Vec<Option<usize>>,
    parent: usize,
    /// Least time (s) from the start, edge by edge, at the joints' greatest speeds.
    cost: f64,
}

struct Composite<'a> {
    world: &'a CollisionWorld,
    roadmaps: &'a mut [Roadmap],
    task: &'a StepTask,
    resting: &'a Resting,
}

impl Composite<'_> {
    /// Grows the tree until it meets the goal, and on for a while; the shortest path found.
    fn grow_tree(
        &mut self,
        from: &[Config],
        to: &[Option<Config>],
        control: &Control,
        rng: &mut Rng,
    ) -> Option<CompositePath> {
        let count = from.len();
        let mut tree = vec![Node { q: from.to_vec(), at: vec![None; count], parent: 0, cost: 0.0 }];
        // An arm that stands on no vertex has not moved, so that these tell composite vertices apart.
        let mut known: BTreeMap<Vec<Option<usize>>, usize> = BTreeMap::new();
        known.insert(vec![None; count], 0);
        let mut best: Option<(f64, CompositePath)> = None;
        let mut last = GREATEST_TREE;
        for extension in 0..GREATEST_TREE {
            if extension >= last || control.should_stop() {
                break;
            }
            // Towards the goal half of the time, towards anywhere otherwise.
            let greedy = rng.random_bool(0.5);
            let sample: Vec<Config> = (0..count)
                .map(|arm| match &to[arm] {
                    Some(goal) if greedy => goal.clone(),
                    _ => {
                        let vertices = self.roadmaps[arm].vertices();
                        match vertices.len() {
                            0 => from[arm].clone(),
                            n => vertices[rng.random_range(0..n)].clone(),
                        }
                    }
                })
                .collect();
            let near = (0..tree.len())
                .min_by(|&a, &b| self.gap(&tree[a].q, &sample).total_cmp(&self.gap(&tree[b].q, &sample)))?;
            let next = self.steer(&tree[near], &sample, rng);
            if next.q == tree[near].q {
                continue;
            }
            let cost = tree[near].cost + self.time(&tree[near].q, &next.q);
            let same = known.get(&next.at).copied();
            let is_vain = same.is_some_and(|same| cost >= tree[same].cost)
                || best.as_ref().is_some_and(|(least, _)| cost >= *least);
            if is_vain || !self.edge_free(&tree[near].q, &next.q) {
                continue;
            }
            let newest = match same {
                Some(same) => {
                    reconnect(&mut tree, same, near, cost);
                    same
                }
                None => {
                    known.insert(next.at.clone(), tree.len());
                    tree.push(Node { parent: near, cost, ..next });
                    tree.len() - 1
                }
            };
            if greedy || extension % CONNECT_EVERY == 0 {
                let goal: Vec<Config> = (0..count)
                    .map(|arm| to[arm].clone().unwrap_or_else(|| tree[newest].q[arm].clone()))
                    .collect();
                if let Some(mut tail) = self.connect(&tree[newest].q, &goal, to) {
                    let mut path = way_to(&tree, newest);
                    path.append(&mut tail);
                    let cost = path.windows(2).map(|pair| self.time(&pair[0], &pair[1])).sum();
                    if best.is_none() {
                        last = extension + 1 + extension.clamp(FEWEST_MORE, MOST_MORE);
                    }
                    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, path));
                    }
                }
            }
        }
        best.map(|(_, path)| self.shortcut(path, rng))
    }

    /// Least time (s) of a composite edge: that of the slowest arm.
    fn time(&self, from: &[Config], to: &[Config]) -> f64 {
        let times =
            from.iter().zip(to).zip(self.roadmaps.iter()).map(|((a, b), roadmap)| roadmap.distance(a, b));
        times.fold(0.0, f64::max)
    }

    fn gap(&self, a: &[Config], b: &[Config]) -> f64 {
        a.iter().zip(b).zip(self.roadmaps.iter()).map(|((x, y), roadmap)| roadmap.distance(x, y)).sum()
    }

    /// For each arm the roadmap neighbour that lies most in the direction of the sample, or a rest.
    fn steer(&mut self, node: &Node, sample: &[Config], rng: &mut Rng) -> Node {
        let count = node.q.len();
        let mut q = Vec::with_capacity(count);
        let mut at = Vec::with_capacity(count);
        for (arm, wanted) in sample.iter().enumerate() {
            if rng.random_bool(0.15) {
                q.push(node.q[arm].clone());
                at.push(node.at[arm]);
                continue;
            }
            let roadmap = &self.roadmaps[arm];
            let neighbours: Vec<usize> = match node.at[arm] {
                Some(vertex) => roadmap
                    .neighbours(vertex)
                    .filter(|&(edge, _)| !roadmap.known_blocked(edge))
                    .map(|(_, next)| next)
                    .collect(),
                None => roadmap.nearest(&node.q[arm], 8),
            };
            let best = neighbours.into_iter().max_by(|&a, &b| {
                let towards = |v: usize| cosine(&node.q[arm], &roadmap.vertices()[v], wanted);
                towards(a).total_cmp(&towards(b)).then(b.cmp(&a))
            });
            match best {
                Some(vertex) => {
                    q.push(roadmap.vertices()[vertex].clone());
                    at.push(Some(vertex));
                }
                None => {
                    q.push(node.q[arm].clone());
                    at.push(node.at[arm]);
                }
            }
        }
        Node { q, at, parent: 0, cost: 0.0 }
    }

    /// Joins `from` to the goal: all arms at once, or one after the other in two orders.
    fn connect(&self, from: &[Config], goal: &[Config], to: &[Option<Config>]) -> Option<Vec<Vec<Config>>> {
        if self.edge_free(from, goal) {
            return Some(vec![goal.to_vec()]);
        }
        let movers: Vec<usize> = (0..from.len()).filter(|&arm| to[arm].is_some()).collect();
        let forwards = movers.clone();
        let backwards: Vec<usize> = movers.into_iter().rev().collect();
        [forwards, backwards].into_iter().find_map(|order| {
            let mut at = from.to_vec();
            let mut path = Vec::new();
            for arm in order {
                let mut next = at.clone();
                next[arm] = goal[arm].clone();
                if !self.edge_free(&at, &next) {
                    return None;
                }
                path.push(next.clone());
                at = next;
            }
            Some(path)
        })
    }

    /// Whether the straight composite edge is certified free.
    fn edge_free(&self, from: &[Config], to: &[Config]) -> bool {
        let none = Exemption::default();
        let motions: Vec<StraightMotion> =
            from.iter().zip(to).map(|(a, b)| StraightMotion::new(a, b)).collect();
        let arms = &self.task.arms;
        let takings: Vec<Taking<'_>> = motions
            .iter()
            .zip(arms)
            .enumerate()
            .map(|(i, (motion, arm))| (ArmId(i), motion as &dyn JointMotion, arm.held.as_ref(), none))
            .collect();
        (0..arms.len()).all(|i| {
            from[i] == to[i]
                || self.world.static_free(ArmId(i), &motions[i], arms[i].held.as_ref(), self.resting, none)
        }) && self.world.conflict_among(&takings, (0.0, 1.0)).is_none()
    }

    fn shortcut(&self, mut path: Vec<Vec<Config>>, rng: &mut Rng) -> Vec<Vec<Config>> {
        for _ in 0..3 * path.len() {
            if path.len() < 3 {
                break;
            }
            let i = rng.random_range(0..path.len() - 2);
            let j = rng.random_range(i + 2..path.len());
            if self.edge_free(&path[i], &path[j]) {
                path.drain(i + 1..j);
            }
        }
        path
    }
}

/// The composite waypoints from the root to a node.
fn way_to(tree: &[Node], node: usize) -> CompositePath {
    let mut path = vec![tree[node].q.clone()];
    let mut at = node;
    while at != 0 {
        at = tree[at].parent;
        path.push(tree[at].q.clone());
    }
    path.reverse();
    path
}

/// Gives `node` another parent by which it costs less, and so all that hangs on it. The parent costs less than
/// the node and is thus none of its descendants.
fn reconnect(tree: &mut [Node], node: usize, parent: usize, cost: f64) {
    let gain = tree[node].cost - cost;
    tree[node].parent = parent;
    let mut below = vec![node];
    while let Some(node) = below.pop() {
        tree[node].cost -= gain;
        below.extend((1..tree.len()).filter(|&other| tree[other].parent == node));
    }
}

fn cosine(from: &[f64], to: &[f64], sample: &[f64]) -> f64 {
    let (mut dot, mut a, mut b) = (0.0, 0.0, 0.0);
    for ((f, t), s) in from.iter().zip(to).zip(sample) {
        dot += (t - f) * (s - f);
        a += (t - f) * (t - f);
        b += (s - f) * (s - f);
    }
    if a * b > 0.0 { dot / (a * b).sqrt() } else { -1.0 }
}

/// The arms in the order in which they go.
fn in_order(count: usize, order: Order) -> Vec<usize> {
    let mut arms: Vec<usize> = (0..count).collect();
    if order == Order::Descending {
        arms.reverse();
    }
    arms
}

/// Times departures, the composite path and approaches one after the other, and certifies them; departures
/// in the first order, approaches in the second.
fn assemble(
    problem: &Problem,
    world: &CollisionWorld,
    task: &StepTask,
    resting: &Resting,
    path: &[Vec<Config>],
    (leave, enter): (Order, Order),
) -> Option<StepMotion> {
    let models = &problem.workcell.arms;
    let count = task.arms.len();
    let mut curves: Vec<Curve> = task.arms.iter().map(|arm| Curve::rest(&arm.start, 0.0)).collect();
    let mut windows: Vec<Vec<Window>> = vec![Vec::new(); count];
    let dwell = task.arms.iter().map(|arm| arm.dwell).fold(0.0, f64::max);
    let mut clock = dwell;
    let catch_up = |curves: &mut Vec<Curve>, to: f64| {
        let latest = curves.iter().map(Curve::end_time).fold(to, f64::max) + 0.002;
        for curve in curves.iter_mut() {
            curve.wait_until(latest);
        }
        latest
    };
    clock = catch_up(&mut curves, clock);
    for i in in_order(count, leave) {
        let arm = &task.arms[i];
        if let Some(departure) = &arm.departure {
            let line = &departure.line.waypoints;
            let tolerances = vec![0.001; line.len()];
            curves[i].append(&time_path(line, &tolerances, &models[i].limits).ok()?).ok()?;
            windows[i].push(Window { from: 0.0, to: curves[i].end_time(), exemption: departure.exemption });
            if leave != Order::Together {
                clock = catch_up(&mut curves, clock);
            }
        }
    }
    clock = catch_up(&mut curves, clock);
    let limits: Vec<JointLimits> = models.iter().flat_map(|arm| arm.limits.iter().copied()).collect();
    let flat: Vec<Config> = path.iter().map(|q| q.iter().flatten().copied().collect()).collect();
    let travel = time_path(&flat, &vec![0.0; flat.len()], &limits).ok()?;
    let mut offset = 0;
    for (curve, model) in curves.iter_mut().zip(models) {
        let dof = model.limits.len();
        curve.append(&travel.select(offset..offset + dof)).ok()?;
        offset += dof;
    }
    catch_up(&mut curves, clock);
    for i in in_order(count, enter) {
        let arm = &task.arms[i];
        if let ArmGoal::Contact { approach: Some(line), exemption, .. } = &arm.goal {
            let start = curves[i].end_time();
            let inwards = line.inwards();
            let tolerances = vec![0.001; inwards.len()];
            curves[i].append(&time_path(&inwards, &tolerances, &models[i].limits).ok()?).ok()?;
            windows[i].push(Window { from: start, to: f64::INFINITY, exemption: *exemption });
            if enter != Order::Together {
                catch_up(&mut curves, 0.0);
            }
        }
    }
    let duration = catch_up(&mut curves, 0.0);
    let arms: Vec<ArmMotion> = curves
        .into_iter()
        .zip(windows)
        .zip(&task.arms)
        .map(|((curve, mut windows), arm)| {
            for window in &mut windows {
                window.to = window.to.min(duration);
            }
            ArmMotion { curve, windows, held: arm.held }
        })
        .collect();
    let motion = StepMotion { arms, duration };
    let still_free = motion.arms.iter().enumerate().all(|(i, arm)| {
        let table = CurveTable::new(&arm.curve);
        arm.pieces(0.0, duration).into_iter().all(|(from, to, exemption)| {
            let part = CurveMotion { curve: &arm.curve, table: &table, span: (from, to) };
            world.static_free(ArmId(i), &part, arm.held.as_ref(), resting, exemption)
        })
    });
    (still_free && find_conflict(world, &motion).is_none()).then_some(motion)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cheaper_parent_makes_all_that_hangs_on_a_node_cheaper() {
        // 0 -> 1 -> 2 -> 3, and 4 beside 1.
        let node = |parent, cost| Node { q: Vec::new(), at: Vec::new(), parent, cost };
        let mut tree = [node(0, 0.0), node(0, 5.0), node(1, 7.0), node(2, 8.0), node(0, 1.0)];
        reconnect(&mut tree, 2, 4, 3.0);
        let costs: Vec<f64> = tree.iter().map(|node| node.cost).collect();
        assert_eq!(costs, [0.0, 5.0, 3.0, 4.0, 1.0]);
        assert_eq!(tree[2].parent, 4);
        assert_eq!(way_to(&tree, 3).len(), 4);
    }

    #[test]
    fn each_order_has_every_arm_once() {
        assert_eq!(in_order(3, Order::Together), [0, 1, 2]);
        assert_eq!(in_order(3, Order::Descending), [2, 1, 0]);
    }
}
