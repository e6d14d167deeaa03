//! The search over the tensor product of the arms' roadmaps (dRRT: Solovey et al. 2016; with the
//! informed steering, rewiring and branch-and-bound of dRRT*: Shome et al. 2019).

use std::collections::{BTreeMap, BTreeSet};

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, JointMotion, Resting, StraightMotion, Taking};
use crate::kinematics::{Config, JointLimits};
use crate::problem::Problem;
use crate::run::{Control, Rng};
use crate::trajectory::{Curve, CurveTable, time_path};
use crate::workcell::ArmId;

use super::legs::ROUNDINGS;
use super::roadmap::{KnownEdges, Roadmap, Situation};
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
    timing_s: &mut f64,
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
    let situations: Vec<Situation> =
        task.arms.iter().map(|arm| Situation::new(arm.held.as_ref(), &resting, &[])).collect();
    let known = roadmaps.iter_mut().zip(&situations).map(|(roadmap, at)| roadmap.recall(at)).collect();
    let mut search = Composite { world, roadmaps, task, resting: &resting, known, meeting: BTreeSet::new() };
    let path = search.grow_tree(&from, &to, control, rng);
    let known = std::mem::take(&mut search.known);
    for ((roadmap, at), known) in roadmaps.iter_mut().zip(situations).zip(known) {
        roadmap.remember(at, known);
    }
    let path = path?;
    // The order makes a difference only among several.
    let orders = |several: bool| if several { &ORDERS[..] } else { &ORDERS[..1] };
    let leaving = task.arms.iter().filter(|arm| arm.departure.is_some()).count();
    let approaches = |arm: &&ArmTask| matches!(arm.goal, ArmGoal::Contact { approach: Some(_), .. });
    let entering = task.arms.iter().filter(approaches).count();
    let mut orders = orders(leaving > 1)
        .iter()
        .flat_map(|&leave| orders(entering > 1).iter().map(move |&enter| (leave, enter)));
    let began_s = control.deadline.elapsed_s();
    let stops =
        |order| assemble(problem, world, task, &resting, &path, order, 0.0).map(|motion| (order, motion));
    let found = orders.find_map(|order| if control.should_stop() { None } else { stops(order) });
    // Corners are rounded as far as that is free.
    let motion = found.map(|(order, motion)| {
        let mut rounded = ROUNDINGS.iter().filter(|rounding| **rounding > 0.0).filter_map(|&rounding| {
            if control.should_stop() {
                return None;
            }
            assemble(problem, world, task, &resting, &path, order, rounding)
        });
        rounded.next().unwrap_or(motion)
    });
    *timing_s += control.deadline.elapsed_s() - began_s;
    motion
}

/// Along an edge of an arm's roadmap, by its number, to one of its vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Passage {
    edge: usize,
    to: usize,
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
    /// By arm, what is known of the edges of its roadmap with what it holds, among what is at rest.
    known: Vec<KnownEdges>,
    /// Pairs of arms with a passage of each one on which they do not keep apart.
    meeting: BTreeSet<[(usize, Passage); 2]>,
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
            let (next, by) = self.steer(&tree[near], &sample, rng);
            if next.q == tree[near].q {
                continue;
            }
            let cost = tree[near].cost + self.time(&tree[near].q, &next.q);
            let same = known.get(&next.at).copied();
            let is_vain = same.is_some_and(|same| cost >= tree[same].cost)
                || best.as_ref().is_some_and(|(least, _)| cost >= *least);
            if is_vain || !self.edge_free(&tree[near].q, &next.q, &by) {
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

    /// For each arm the roadmap neighbour that lies most in the direction of the sample, or a rest; and by arm the
    /// passage that leads there, if it is one.
    fn steer(&mut self, node: &Node, sample: &[Config], rng: &mut Rng) -> (Node, Vec<Option<Passage>>) {
        let count = node.q.len();
        let mut q = Vec::with_capacity(count);
        let mut at = Vec::with_capacity(count);
        let mut by = vec![None; count];
        for (arm, wanted) in sample.iter().enumerate() {
            if rng.random_bool(0.15) {
                q.push(node.q[arm].clone());
                at.push(node.at[arm]);
                continue;
            }
            let roadmap = &self.roadmaps[arm];
            let blocked =
                |edge: usize| roadmap.known_blocked(edge) || self.known[arm].blocked.contains(&edge);
            let neighbours: Vec<(Option<usize>, usize)> = match node.at[arm] {
                Some(vertex) => roadmap
                    .neighbours(vertex)
                    .filter(|&(edge, _)| !blocked(edge))
                    .map(|(edge, next)| (Some(edge), next))
                    .collect(),
                None => roadmap.nearest(&node.q[arm], 8).into_iter().map(|next| (None, next)).collect(),
            };
            let best = neighbours.into_iter().max_by(|&(_, a), &(_, b)| {
                let towards = |v: usize| cosine(&node.q[arm], &roadmap.vertices()[v], wanted);
                towards(a).total_cmp(&towards(b)).then(b.cmp(&a))
            });
            match best {
                Some((edge, vertex)) => {
                    q.push(roadmap.vertices()[vertex].clone());
                    at.push(Some(vertex));
                    by[arm] = edge.map(|edge| Passage { edge, to: vertex });
                }
                None => {
                    q.push(node.q[arm].clone());
                    at.push(node.at[arm]);
                }
            }
        }
        (Node { q, at, parent: 0, cost: 0.0 }, by)
    }

    /// Joins `from` to the goal: all arms at once, or one after the other in two orders.
    fn connect(
        &mut self,
        from: &[Config],
        goal: &[Config],
        to: &[Option<Config>],
    ) -> Option<Vec<Vec<Config>>> {
        let none = vec![None; from.len()];
        if self.edge_free(from, goal, &none) {
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
                if !self.edge_free(&at, &next, &none) {
                    return None;
                }
                path.push(next.clone());
                at = next;
            }
            Some(path)
        })
    }

    /// Whether the straight composite edge is certified free; `by` tells by arm the passage of its roadmap, where it
    /// is one.
    fn edge_free(&mut self, from: &[Config], to: &[Config], by: &[Option<Passage>]) -> bool {
        let on = |arm: usize| by[arm].map(|passage| (arm, passage));
        let edges: Vec<(usize, Passage)> = (0..by.len()).filter_map(on).collect();
        let mut pairs = edges.iter().enumerate().flat_map(|(n, a)| edges[n + 1..].iter().map(|b| [*a, *b]));
        if pairs.any(|pair| self.meeting.contains(&pair)) {
            return false;
        }
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
        for (i, motion) in motions.iter().enumerate() {
            let check =
                || self.world.static_free(ArmId(i), motion, arms[i].held.as_ref(), self.resting, none);
            let free = match by[i] {
                _ if from[i] == to[i] => true,
                Some(passage) => self.known[i].is_free(passage.edge, check),
                None => check(),
            };
            if !free {
                return false;
            }
        }
        match self.world.conflict_among(&takings, (0.0, 1.0)) {
            None => true,
            Some((a, b)) => {
                if let (Some(one), Some(two)) = (on(a), on(b)) {
                    self.meeting.insert([one, two]);
                }
                false
            }
        }
    }

    fn shortcut(&mut self, mut path: Vec<Vec<Config>>, rng: &mut Rng) -> Vec<Vec<Config>> {
        let none = vec![None; self.task.arms.len()];
        for _ in 0..3 * path.len() {
            if path.len() < 3 {
                break;
            }
            let i = rng.random_range(0..path.len() - 2);
            let j = rng.random_range(i + 2..path.len());
            if self.edge_free(&path[i], &path[j], &none) {
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
/// in the first order, approaches in the second. Corners of the path are rounded by `rounding` (rad or m) at most.
fn assemble(
    problem: &Problem,
    world: &CollisionWorld,
    task: &StepTask,
    resting: &Resting,
    path: &[Vec<Config>],
    (leave, enter): (Order, Order),
    rounding: f64,
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
    let travel = time_path(&flat, &vec![rounding; flat.len()], &limits).ok()?;
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
    use crate::collision::Scene;
    use crate::geometry::pose_from_parts;
    use crate::motion::first_roadmaps;
    use crate::run::Seed;
    use crate::scenario::{Family, generate};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
    use crate::workcell::ObjectId;

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

    /// A passage with the vertex where it begins.
    type From = (usize, Passage);

    #[test]
    fn what_is_remembered_of_composite_edges_is_what_is_so() {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let control = Control::with_budget(std::time::Duration::from_secs(600));
        let (mut roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
        let idle = |home: &Config| ArmTask {
            start: home.clone(),
            held: None,
            departure: None,
            wait_for: None,
            dwell: 0.0,
            goal: ArmGoal::Toward(home.clone()),
        };
        let pose = pose_from_parts([0.5, 0.0, 0.9], [0.0, 0.0, 0.0, 1.0]);
        let task = StepTask {
            arms: problem.workcell.arms.iter().map(|arm| idle(&arm.home)).collect(),
            scene: Scene { resting: vec![(ObjectId(0), pose)] },
        };
        let resting = world.resting_atoms(&task.scene);
        let vertices: Vec<Vec<Config>> = roadmaps.iter().map(|roadmap| roadmap.vertices().to_vec()).collect();
        let mut rng = Seed(4).stream("composite");
        let mut draw = |roadmap: &Roadmap| -> Vec<From> {
            let all = (0..roadmap.vertices().len()).flat_map(|from| {
                roadmap.neighbours(from).map(move |(edge, to)| (from, Passage { edge, to }))
            });
            let all: Vec<From> = all.collect();
            (0..12).map(|_| all[rng.random_range(0..all.len())]).collect()
        };
        let (ours, theirs) = (draw(&roadmaps[0]), draw(&roadmaps[1]));
        // Every pair of passages, one of them backwards, too, and again.
        let mut cases: Vec<[From; 2]> = Vec::new();
        for _ in 0..2 {
            for &(from, passage) in &ours {
                for &other in &theirs {
                    let backwards = (passage.to, Passage { to: from, ..passage });
                    cases.extend([[(from, passage), other], [backwards, other]]);
                }
            }
        }
        let mut free = |cases: &[[From; 2]]| -> Vec<bool> {
            let mut search = Composite {
                world: &world,
                roadmaps: &mut roadmaps,
                task: &task,
                resting: &resting,
                known: vec![KnownEdges::default(); 2],
                meeting: BTreeSet::new(),
            };
            let mut is_free = |[ours, theirs]: &[From; 2]| {
                let from = [vertices[0][ours.0].clone(), vertices[1][theirs.0].clone()];
                let to = [vertices[0][ours.1.to].clone(), vertices[1][theirs.1.to].clone()];
                search.edge_free(&from, &to, &[Some(ours.1), Some(theirs.1)])
            };
            cases.iter().map(&mut is_free).collect()
        };
        let together = free(&cases);
        let each: Vec<bool> = cases.iter().map(|case| free(std::slice::from_ref(case))[0]).collect();
        assert_eq!(together, each);
        assert!(together.contains(&true) && together.contains(&false));
    }
}
