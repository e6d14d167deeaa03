//! An instance compiled for the solvers: adjacency per class, limited resources, distances to
//! goals. Built once per instance, used from any state of it.

use super::instance::{Goal, Instance, InstanceError, ModeState, NodeId, NodeKind};
use super::solution::{Move, Solution};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Distance of a node from which there is no path.
pub(super) const FAR: u16 = u16::MAX;

/// A range of 16-bit lists one after another.
#[derive(Debug, Clone, Default)]
pub(super) struct Lists {
    ends: Vec<u32>,
    items: Vec<u16>,
}

impl Lists {
    fn push(&mut self, items: impl IntoIterator<Item = u16>) {
        self.items.extend(items);
        self.ends.push(self.items.len() as u32);
    }

    fn range(&self, index: usize) -> Range<usize> {
        let start = if index == 0 { 0 } else { self.ends[index - 1] as usize };
        start..self.ends[index] as usize
    }

    /// The list at `index`.
    pub(super) fn get(&self, index: usize) -> &[u16] {
        &self.items[self.range(index)]
    }
}

/// The edges that one class of objects may take.
#[derive(Debug, Clone, Default)]
pub(super) struct ClassGraph {
    successors: Lists,
    predecessors: Lists,
    weights: Vec<u32>,
    /// The same weights as they were given; not kept in part of a graph.
    given: Vec<f64>,
}

impl ClassGraph {
    /// Nodes that one edge leads to from `node`, ascending.
    pub(super) fn successors(&self, node: usize) -> &[u16] {
        self.successors.get(node)
    }

    /// Nodes from which one edge leads to `node`, ascending.
    pub(super) fn predecessors(&self, node: usize) -> &[u16] {
        self.predecessors.get(node)
    }

    /// The place of the edge from `from` to `to` in all lists of edges, if there is one.
    fn edge(&self, from: usize, to: usize) -> Option<usize> {
        let range = self.successors.range(from);
        let place = self.successors.items.get(range.clone())?.binary_search(&(to as u16)).ok()?;
        Some(range.start + place)
    }

    /// The scaled weight of the edge from `from` to `to`; 0 without one.
    pub(super) fn weight_to(&self, from: usize, to: usize) -> u32 {
        self.edge(from, to).map_or(0, |edge| self.weights[edge])
    }

    /// Scaled weights of the edges to [`Self::successors`], at least 1.
    pub(super) fn weights(&self, node: usize) -> &[u32] {
        &self.weights[self.successors.range(node)]
    }
}

/// Objects of one kind share class and goal, and are interchangeable. One that a [`super::Clash`] names is of a
/// kind of its own.
#[derive(Debug, Clone)]
pub(super) struct Kind {
    /// Index into [`Network::graphs`].
    pub(super) graph: usize,
    /// Whether a node meets the goal.
    pub(super) is_goal: Vec<bool>,
    /// The nodes that meet the goal, ascending.
    pub(super) goals: Vec<u16>,
    /// Fewest edges from each node to the goal for an object that is alone.
    pub(super) to_goal: Vec<u16>,
    /// The class's edges without those into slots that are no goal, but for one stand-in among all
    /// slots with the same neighbours.
    pub(super) lean: ClassGraph,
    /// The same with two stand-ins: for an object that begins on the one the other stands for the rest.
    pub(super) relaxed: ClassGraph,
    /// The two.
    pub(super) stands_in: Vec<bool>,
}

/// A compiled [`Instance`]. See the module's documentation.
#[derive(Debug, Clone)]
pub struct Network {
    instance: Instance,
    pub(super) is_arm: Vec<bool>,
    /// The nodes of every arm.
    pub(super) arms: Vec<Vec<u16>>,
    /// Of an arm node the index into [`Network::arms`]; else `usize::MAX`.
    pub(super) arm_number: Vec<usize>,
    pub(super) graphs: Vec<ClassGraph>,
    pub(super) kinds: Vec<Kind>,
    /// The kind of every object.
    pub(super) kind_of: Vec<usize>,
    /// Capacities of the nodes and conflict sets that can be overfilled at all.
    pub(super) capacities: Vec<u16>,
    /// Which of them each node draws on, and which nodes draw on each.
    pub(super) resources: Lists,
    pub(super) users: Lists,
    /// By node, what taking an edge from there draws on in the step.
    crossings: Vec<Vec<Crossing>>,
}

/// What taking an edge draws on.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Crossing {
    to: u16,
    resource: u16,
    /// The only kind that draws on it.
    kind: Option<u16>,
}

/// Largest scaled weight of one edge.
const WEIGHT_SCALE: f64 = 4096.0;

impl Network {
    /// Compiles `instance`.
    ///
    /// # Errors
    ///
    /// When the instance makes no sense; see [`Instance::validate`].
    pub fn new(instance: Instance) -> Result<Self, InstanceError> {
        instance.validate()?;
        let count = instance.nodes.len();
        let is_arm: Vec<bool> = (0..count).map(|node| instance.is_arm(NodeId(node))).collect();
        let (arms, arm_number) = arms(&instance, &is_arm);
        let heaviest = instance.edges.iter().map(|edge| edge.weight).fold(0.0, f64::max);
        let weight_unit = if heaviest > 0.0 { heaviest / WEIGHT_SCALE } else { 1.0 };

        let mut class_graph: BTreeMap<usize, usize> = BTreeMap::new();
        let mut graphs = Vec::new();
        let mut kind_index: BTreeMap<(usize, &Goal, Option<usize>), usize> = BTreeMap::new();
        let mut kinds = Vec::new();
        let mut kind_of = Vec::with_capacity(instance.objects.len());
        let closed = closed_nodes(&instance);
        let clashing = instance.clashes.iter().flat_map(|clash| &clash.actions);
        let named: BTreeSet<usize> = clashing.filter_map(|action| action.object).collect();
        for (index, object) in instance.objects.iter().enumerate() {
            let graph = *class_graph.entry(object.class).or_insert_with(|| {
                graphs.push(class_edges(&instance, object.class, &closed, weight_unit));
                graphs.len() - 1
            });
            let alone = named.contains(&index).then_some(index);
            let kind = *kind_index.entry((object.class, &object.goal, alone)).or_insert_with(|| {
                let is_goal: Vec<bool> = (0..count)
                    .map(|node| match &object.goal {
                        Goal::Nodes(nodes) => nodes.contains(&NodeId(node)),
                        Goal::AnyPlacement => !is_arm[node],
                    })
                    .collect();
                let goals: Vec<u16> =
                    (0..count).filter(|&node| is_goal[node]).map(|node| node as u16).collect();
                let to_goal = distances(&goals, count, |node| graphs[graph].predecessors(node));
                let (lean, _) = lean_graph(&instance, &graphs[graph], &is_goal, 1);
                let (relaxed, stands_in) = lean_graph(&instance, &graphs[graph], &is_goal, 2);
                kinds.push(Kind { graph, is_goal, goals, to_goal, lean, relaxed, stands_in });
                kinds.len() - 1
            });
            kind_of.push(kind);
        }
        let Limited { capacities, resources, users, crossings } = limited_resources(&instance, &kind_of);
        Ok(Self {
            is_arm,
            arms,
            arm_number,
            graphs,
            kinds,
            kind_of,
            capacities,
            resources,
            users,
            crossings,
            instance,
        })
    }

    /// The instance.
    pub fn instance(&self) -> &Instance {
        &self.instance
    }

    /// The next node on the lightest of the shortest ways of `object` from `at` to its goal, whatever
    /// the others do; `None` at the goal, or where there is no way.
    pub fn next_on_shortest_way(&self, object: usize, at: NodeId) -> Option<NodeId> {
        super::baselines::next_on_shortest(self, object, at.0).map(NodeId)
    }

    /// Number of nodes.
    pub(super) fn node_count(&self) -> usize {
        self.is_arm.len()
    }

    /// Number of objects.
    pub(super) fn object_count(&self) -> usize {
        self.kind_of.len()
    }

    /// The kind of object `object`.
    pub(super) fn kind(&self, object: usize) -> &Kind {
        &self.kinds[self.kind_of[object]]
    }

    /// The edges that object `object` may take.
    pub(super) fn graph(&self, object: usize) -> &ClassGraph {
        &self.graphs[self.kind(object).graph]
    }

    /// Fewest edges from `node` to the goal of `object`, if it were alone.
    pub(super) fn to_goal(&self, object: usize, node: usize) -> u16 {
        self.kind(object).to_goal[node]
    }

    /// Whether any edge from `node` draws on more than its ends do.
    pub(super) fn has_crossings(&self, node: usize) -> bool {
        !self.crossings[node].is_empty()
    }

    /// The resources beyond those of `to` that objects of `kind` (`usize::MAX` for one that is not known) draw
    /// on in the step in which they take the edge from `from` to `to`.
    pub(super) fn crossing(&self, kind: usize, from: usize, to: usize) -> impl Iterator<Item = u16> + Clone {
        let means = move |crossing: &&Crossing| {
            usize::from(crossing.to) == to && crossing.kind.is_none_or(|only| usize::from(only) == kind)
        };
        self.crossings[from].iter().filter(means).map(|crossing| crossing.resource)
    }

    /// Sum of the scaled weights along a route.
    pub(super) fn route_weight(&self, object: usize, route: &[u16]) -> u64 {
        let graph = self.graph(object);
        route
            .windows(2)
            .filter(|ends| ends[0] != ends[1])
            .map(|ends| u64::from(graph.weight_to(ends[0] as usize, ends[1] as usize)))
            .sum()
    }

    /// The plan that takes `steps` from `start`, with its weight; whether it keeps the rules is for
    /// [`super::check`] to say.
    pub fn solution(&self, start: ModeState, steps: Vec<Vec<Move>>) -> Solution {
        let weight = self.weight_of_steps(&steps);
        Solution { start, steps, weight }
    }

    /// Sum of the true weights of the edges taken in `steps`.
    pub(super) fn weight_of_steps(&self, steps: &[Vec<Move>]) -> f64 {
        steps.iter().flatten().map(|step| self.weight_of(step.object, step.from.0, step.to.0)).sum()
    }

    /// The true weight of the edge from `from` to `to` for `object`.
    pub(super) fn weight_of(&self, object: usize, from: usize, to: usize) -> f64 {
        let graph = self.graph(object);
        graph.edge(from, to).and_then(|edge| graph.given.get(edge).copied()).unwrap_or(0.0)
    }
}

/// The nodes of every arm, by their least, and the arm of every node.
fn arms(instance: &Instance, is_arm: &[bool]) -> (Vec<Vec<u16>>, Vec<usize>) {
    let count = is_arm.len();
    let (mut arms, mut number) = (Vec::new(), vec![usize::MAX; count]);
    for node in (0..count).filter(|&node| is_arm[node]) {
        if number[node] != usize::MAX {
            continue;
        }
        let set = instance.conflicts.iter().find(|set| set.nodes.contains(&NodeId(node)));
        let mut nodes: Vec<u16> =
            set.map_or(vec![node as u16], |set| set.nodes.iter().map(|node| node.0 as u16).collect());
        nodes.sort_unstable();
        nodes.dedup();
        nodes.iter().for_each(|&node| number[node as usize] = arms.len());
        arms.push(nodes);
    }
    (arms, number)
}

/// Nodes that nothing can ever enter.
fn closed_nodes(instance: &Instance) -> Vec<bool> {
    let mut closed: Vec<bool> = instance.nodes.iter().map(|node| node.capacity == 0).collect();
    for set in instance.conflicts.iter().filter(|set| set.capacity == 0) {
        for node in &set.nodes {
            closed[node.0] = true;
        }
    }
    closed
}

fn class_edges(instance: &Instance, class: usize, closed: &[bool], unit: f64) -> ClassGraph {
    let count = instance.nodes.len();
    let mut out: Vec<BTreeMap<u16, f64>> = vec![BTreeMap::new(); count];
    let mut back: Vec<Vec<u16>> = vec![Vec::new(); count];
    for edge in &instance.edges {
        if edge.class.is_some_and(|only| only != class) || closed[edge.to.0] {
            continue;
        }
        let entry = out[edge.from.0].entry(edge.to.0 as u16).or_insert_with(|| {
            back[edge.to.0].push(edge.from.0 as u16);
            edge.weight
        });
        *entry = edge.weight.min(*entry);
    }
    let mut graph = ClassGraph::default();
    for (out, mut back) in out.into_iter().zip(back) {
        graph.weights.extend(out.values().map(|weight| 1 + (weight / unit).round() as u32));
        graph.given.extend(out.values());
        graph.successors.push(out.into_keys());
        back.sort_unstable();
        graph.predecessors.push(back);
    }
    graph
}

/// The edges of a kind that lead to arms, regions, goals, and up to `most` slots of each neighbourhood, with those
/// slots.
fn lean_graph(
    instance: &Instance,
    graph: &ClassGraph,
    is_goal: &[bool],
    most: u32,
) -> (ClassGraph, Vec<bool>) {
    let count = is_goal.len();
    let mut keep = vec![true; count];
    let mut stands_in = vec![false; count];
    let mut seen: BTreeMap<_, u32> = BTreeMap::new();
    for node in 0..count {
        if instance.nodes[node].kind == NodeKind::Slot && !is_goal[node] {
            let alike = seen.entry((graph.predecessors(node), graph.successors(node))).or_default();
            *alike += 1;
            keep[node] = *alike <= most;
            stands_in[node] = keep[node];
        }
    }
    let mut lean = ClassGraph::default();
    for node in 0..count {
        let edges = graph.successors(node).iter().zip(graph.weights(node));
        let kept = edges.filter(|&(&next, _)| keep[next as usize]);
        lean.weights.extend(kept.clone().map(|(_, &weight)| weight));
        lean.successors.push(kept.map(|(&next, _)| next));
    }
    (lean, stands_in)
}

/// Breadth-first distances from `sources` along `next`.
pub(super) fn distances<'a>(sources: &[u16], count: usize, next: impl Fn(usize) -> &'a [u16]) -> Vec<u16> {
    let mut distance = vec![FAR; count];
    let mut queue: Vec<u16> = sources.to_vec();
    for &node in sources {
        distance[node as usize] = 0;
    }
    let mut head = 0;
    while head < queue.len() {
        let node = queue[head] as usize;
        head += 1;
        for &other in next(node) {
            if distance[other as usize] == FAR {
                distance[other as usize] = distance[node] + 1;
                queue.push(other);
            }
        }
    }
    distance
}

/// What a network's nodes and edges draw on.
struct Limited {
    capacities: Vec<u16>,
    resources: Lists,
    users: Lists,
    crossings: Vec<Vec<Crossing>>,
}

/// A node or conflict set limits something only if there are more objects than it holds.
fn limited_resources(instance: &Instance, kind_of: &[usize]) -> Limited {
    let objects = instance.objects.len();
    let mut capacities = Vec::new();
    let mut of_node: Vec<Vec<u16>> = vec![Vec::new(); instance.nodes.len()];
    let shared = |node: usize| {
        let sets = &mut instance.conflicts.iter();
        instance.is_arm(NodeId(node)) && sets.any(|set| set.nodes.contains(&NodeId(node)))
    };
    for (node, data) in instance.nodes.iter().enumerate() {
        // The capacity of an arm of several nodes is that of their set.
        if (data.capacity as usize) < objects && !(data.capacity == 1 && shared(node)) {
            of_node[node].push(capacities.len() as u16);
            capacities.push(data.capacity as u16);
        }
    }
    for set in &instance.conflicts {
        let mut nodes = set.nodes.clone();
        nodes.sort_unstable();
        nodes.dedup();
        if (set.capacity as usize) < objects {
            for node in nodes {
                of_node[node.0].push(capacities.len() as u16);
            }
            capacities.push(set.capacity as u16);
        }
    }
    // A block is a resource for one, drawn on by who is at its place and by who takes its edge. Edges
    // of which one at most can be taken in a step share it.
    let starts = |node: NodeId| instance.objects.iter().filter(|object| object.start == node).count();
    let is_single = |node: NodeId| {
        let data = &instance.nodes[node.0];
        data.kind == NodeKind::Slot && data.capacity <= 1 && starts(node) <= 1
    };
    let mut crossings: Vec<Vec<Crossing>> = vec![Vec::new(); instance.nodes.len()];
    let mut blocks: BTreeMap<(NodeId, Option<NodeId>, Option<NodeId>), u16> = BTreeMap::new();
    for block in instance.blocks.iter().filter(|_| objects > 1) {
        let key = match (is_single(block.from), is_single(block.to)) {
            (true, _) => (block.at, Some(block.from), None),
            (false, true) => (block.at, None, Some(block.to)),
            (false, false) => (block.at, Some(block.from), Some(block.to)),
        };
        let resource = *blocks.entry(key).or_insert_with(|| {
            of_node[block.at.0].push(capacities.len() as u16);
            capacities.push(1);
            capacities.len() as u16 - 1
        });
        let crossing = Crossing { to: block.to.0 as u16, resource, kind: None };
        if !crossings[block.from.0].contains(&crossing) {
            crossings[block.from.0].push(crossing);
        }
    }
    // So is a clash, drawn on by who does any of its actions.
    for clash in instance.clashes.iter().filter(|_| objects > 1) {
        let resource = capacities.len() as u16;
        capacities.push(1);
        for action in &clash.actions {
            let kind = action.object.map(|object| kind_of[object] as u16);
            let of_edge = |known: &Crossing| (known.to, known.resource) == (action.to.0 as u16, resource);
            let there = &mut crossings[action.from.0];
            // An action counts once, though it may be meant in two ways.
            if there.iter().any(|known| of_edge(known) && (known.kind.is_none() || known.kind == kind)) {
                continue;
            }
            if kind.is_none() {
                there.retain(|known| !of_edge(known));
            }
            there.push(Crossing { to: action.to.0 as u16, resource, kind });
        }
    }
    let mut of_resource: Vec<Vec<u16>> = vec![Vec::new(); capacities.len()];
    for (node, list) in of_node.iter().enumerate() {
        list.iter().for_each(|&resource| of_resource[resource as usize].push(node as u16));
    }
    let (mut resources, mut users) = (Lists::default(), Lists::default());
    of_node.into_iter().for_each(|list| resources.push(list));
    of_resource.into_iter().for_each(|list| users.push(list));
    Limited { capacities, resources, users, crossings }
}
