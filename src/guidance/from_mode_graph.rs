//! Mode graphs as instances: node for node, with the same numbers, and further nodes for hands that
//! hold an object as they took it at its start.
//!
//! That a carry is barred, or that something is in its way, is no matter of single edges. So each object
//! that has such carries gets nodes of its own for the arms concerned, which say where it came from: a
//! *first* hand, that picked it at its start and cannot place it at the goal, or cannot hand it on to
//! every arm, and a *second* hand, that got it from such a one and cannot place it at the goal. A carry
//! that is possible while nothing is in its way has hands that can do nothing else. All nodes of one arm
//! share its capacity. Once the object was put down or went on to a third arm, the plain nodes stand
//! for it again.

use std::collections::BTreeMap;

use super::instance::{
    Block, Clash, Clashing, ConflictSet, Edge, Goal, Instance, Node, NodeId, NodeKind, Object,
};
use crate::mode_graph::{Blockage, BlockedPart, CarryEnd, ModeEdge, ModeGoal, ModeGraph, Place, RestAction};

/// What the ends of guarded carries are on the instance, by object, end, and arms by number.
type Carries = BTreeMap<(usize, RestAction, Vec<usize>), Clashing>;

fn key(end: &CarryEnd) -> (usize, RestAction, Vec<usize>) {
    (end.object.0, end.action, end.carriers.iter().map(|arm| arm.0).collect())
}

/// The instance of a mode graph, and which node of the graph each of its nodes stands for: node `n` of
/// the graph is `NodeId(n)`, nodes beyond are hands. Object `o` is object `o`.
pub fn instance_of(graph: &ModeGraph) -> (Instance, Vec<usize>) {
    let mut instance = plain(graph);
    let mut stands_for: Vec<usize> = (0..graph.nodes.len()).collect();
    let mut hands: BTreeMap<usize, Vec<NodeId>> = BTreeMap::new();
    let mut carries = Carries::new();
    for object in 0..graph.objects.len() {
        if let Some(refined) = Refined::new(graph, object) {
            refined.enter(graph, &mut instance, &mut stands_for, &mut hands, &mut carries);
        }
    }
    for ends in &graph.crowdings {
        let actions: Option<Vec<Clashing>> = ends.iter().map(|end| carries.get(&key(end)).copied()).collect();
        instance.clashes.extend(actions.map(|actions| Clash { actions }));
    }
    for blockage in &graph.blockages {
        block_contact(graph, blockage, &mut instance, &stands_for);
    }
    for (arm, mut nodes) in hands {
        nodes.push(NodeId(arm));
        nodes.sort_unstable();
        instance.conflicts.push(ConflictSet { nodes, capacity: 1 });
    }
    (instance, stands_for)
}

impl From<&ModeGraph> for Instance {
    /// See [`instance_of`].
    fn from(graph: &ModeGraph) -> Self {
        instance_of(graph).0
    }
}

fn count(capacity: usize) -> u32 {
    u32::try_from(capacity).unwrap_or(u32::MAX)
}

/// The instance without regard to barred carries.
fn plain(graph: &ModeGraph) -> Instance {
    let ids = |nodes: &[usize]| nodes.iter().map(|&node| NodeId(node)).collect();
    let node = |node: &crate::mode_graph::ModeNode| Node {
        kind: match node.place {
            Place::Arm(_) => NodeKind::Arm,
            Place::Slot(_) => NodeKind::Slot,
            Place::Region(_) | Place::Surface(_) => NodeKind::Region,
        },
        capacity: count(node.capacity),
    };
    let conflicts = graph
        .conflicts
        .iter()
        .map(|conflict| ConflictSet { nodes: ids(&conflict.nodes), capacity: count(conflict.capacity) });
    let objects = graph.objects.iter().map(|object| Object {
        start: NodeId(object.start),
        goal: match &object.goal {
            ModeGoal::Nodes(goal) => Goal::Nodes(ids(goal)),
            ModeGoal::AnyPlacement => Goal::AnyPlacement,
        },
        class: object.class,
    });
    Instance {
        nodes: graph.nodes.iter().map(node).collect(),
        edges: graph.edges.iter().map(|edge| as_edge(edge, edge.from, edge.to, edge.class)).collect(),
        conflicts: conflicts.collect(),
        blocks: Vec::new(),
        clashes: Vec::new(),
        objects: objects.collect(),
    }
}

fn as_edge(edge: &ModeEdge, from: usize, to: usize, class: usize) -> Edge {
    Edge { from: NodeId(from), to: NodeId(to), weight: edge.weight, class: Some(class) }
}

/// Blocks a whole pick or place, whatever comes after or came before it.
fn block_contact(graph: &ModeGraph, blockage: &Blockage, instance: &mut Instance, stands_for: &[usize]) {
    let (BlockedPart::Contact(action, arm), Some(object)) =
        (&blockage.part, graph.objects.get(blockage.object.0))
    else {
        return;
    };
    let rest = match (action, &object.goal) {
        (RestAction::Pick, _) => Some(object.start),
        (RestAction::Place, ModeGoal::Nodes(goals)) => goals.first().copied(),
        (RestAction::Place, ModeGoal::AnyPlacement) => None,
    };
    let is_it = |edge: &&Edge| {
        let (placement, hand) = match action {
            RestAction::Pick => (edge.from, edge.to),
            RestAction::Place => (edge.to, edge.from),
        };
        Some(placement.0) == rest && stands_for.get(hand.0) == Some(&graph.arm_node(*arm))
    };
    let mut ends: Vec<(NodeId, NodeId)> =
        instance.edges.iter().filter(is_it).map(|edge| (edge.from, edge.to)).collect();
    ends.sort_unstable();
    ends.dedup();
    let at = NodeId(blockage.at);
    instance.blocks.extend(ends.into_iter().map(|(from, to)| Block { from, to, at }));
}

/// An object of which some carries are special. One that is back in the region of its start counts as if it
/// stood there still.
struct Refined {
    object: usize,
    class: usize,
    start: usize,
    goal: usize,
    /// Arms by number, first to last.
    barred: Vec<Vec<usize>>,
    /// Carries that something may be in the way of, with what is in the way of their picks and places, and those
    /// that clash with others.
    guarded: BTreeMap<Vec<usize>, Vec<(RestAction, usize)>>,
}

impl Refined {
    /// `None` where nothing is special, or where start or goal are neither slots nor part of a region as the
    /// object's own.
    fn new(graph: &ModeGraph, index: usize) -> Option<Self> {
        let mine = graph.barred.iter().filter(|carry| carry.object.0 == index);
        let barred: Vec<Vec<usize>> =
            mine.map(|carry| carry.carriers.iter().map(|arm| arm.0).collect()).collect();
        let mut guarded: BTreeMap<Vec<usize>, Vec<(RestAction, usize)>> = BTreeMap::new();
        for blockage in graph.blockages.iter().filter(|blockage| blockage.object.0 == index) {
            if let BlockedPart::Carry(action, carriers) = &blockage.part {
                let carriers = carriers.iter().map(|arm| arm.0).collect();
                guarded.entry(carriers).or_default().push((*action, blockage.at));
            }
        }
        for end in graph.crowdings.iter().flatten().filter(|end| end.object.0 == index) {
            guarded.entry(end.carriers.iter().map(|arm| arm.0).collect()).or_default();
        }
        if barred.is_empty() && guarded.is_empty() {
            return None;
        }
        let object = graph.objects.get(index)?;
        let ModeGoal::Nodes(goals) = &object.goal else { return None };
        let &[goal] = goals.as_slice() else { return None };
        let slots = |node: usize| match graph.nodes.get(node).map(|node| &node.place) {
            Some(Place::Slot(slot)) => std::slice::from_ref(slot),
            Some(Place::Region(region)) => &region.merged,
            _ => &[],
        };
        let is_own_goal = slots(goal).iter().any(|slot| slot.goal_of.is_some_and(|own| own.0 == index));
        let is_own_start = graph.arm_of(object.start).is_some()
            || slots(object.start).iter().any(|slot| slot.start_of.is_some_and(|own| own.0 == index));
        (is_own_goal && is_own_start).then_some(Self {
            object: index,
            class: object.class,
            start: object.start,
            goal,
            barred,
            guarded,
        })
    }

    /// Whether the carry is closed to objects that are held in no special way.
    fn is_special(&self, carriers: &[usize]) -> bool {
        self.barred.iter().any(|carry| carry == carriers) || self.guarded.contains_key(carriers)
    }

    /// Gives the object a class of its own, with edges by way of hands.
    fn enter(
        &self,
        graph: &ModeGraph,
        instance: &mut Instance,
        stands_for: &mut Vec<usize>,
        hands: &mut BTreeMap<usize, Vec<NodeId>>,
        carries: &mut Carries,
    ) {
        let class = 1 + instance.objects.iter().map(|object| object.class).max().unwrap_or(0);
        let mut nodes = std::mem::take(&mut instance.nodes);
        let mut add = |arm: usize| {
            let node = nodes.len();
            nodes.push(Node { kind: NodeKind::Arm, capacity: 1 });
            stands_for.push(arm);
            hands.entry(arm).or_default().push(NodeId(node));
            node
        };
        // By arm, the hand that holds the object as it was taken at its start, and the one that got it
        // from such a one.
        let (mut first, mut second) = (BTreeMap::new(), BTreeMap::new());
        for carry in self.barred.iter().chain(self.guarded.keys()) {
            if let Some(&arm) = carry.first() {
                first.entry(arm).or_insert_with(|| add(arm));
            }
            if let Some(&arm) = carry.get(1) {
                second.entry(arm).or_insert_with(|| add(arm));
            }
        }
        let own: Vec<&ModeEdge> = graph.edges.iter().filter(|edge| edge.class == self.class).collect();
        for edge in &own {
            let to = match first.get(&edge.to) {
                Some(&hand) if edge.from == self.start => hand,
                _ => edge.to,
            };
            instance.edges.push(as_edge(edge, edge.from, to, class));
        }
        for (&arm, &hand) in &first {
            for edge in own.iter().filter(|edge| edge.from == arm) {
                if edge.to == self.goal && self.is_special(&[arm]) {
                    continue;
                }
                let to = match second.get(&edge.to) {
                    Some(&receiver) if self.is_special(&[arm, edge.to]) => receiver,
                    _ => edge.to,
                };
                instance.edges.push(as_edge(edge, hand, to, class));
            }
        }
        for (&arm, &hand) in &second {
            for edge in own.iter().filter(|edge| edge.from == arm && edge.to != self.goal) {
                instance.edges.push(as_edge(edge, hand, edge.to, class));
            }
        }
        // A guarded carry has hands of its own, all the way.
        for (carriers, guards) in &self.guarded {
            let own_edge = |from: usize, to: usize| own.iter().find(|e| (e.from, e.to) == (from, to));
            // One that is held from the start on sets out from its first hand.
            let in_hand = usize::from(graph.arm_of(self.start).is_some());
            let mut way = vec![self.start];
            way.extend(carriers.iter().skip(in_hand).copied());
            way.push(self.goal);
            let edges: Option<Vec<_>> = way.windows(2).map(|ends| own_edge(ends[0], ends[1])).collect();
            let Some(edges) = edges else { continue };
            let mut at = vec![first.get(&self.start).copied().unwrap_or(self.start)];
            at.extend(carriers.iter().skip(in_hand).map(|&arm| add(arm)));
            at.push(self.goal);
            for (edge, ends) in edges.iter().zip(at.windows(2)) {
                instance.edges.push(as_edge(edge, ends[0], ends[1], class));
            }
            let edge_of = |action: RestAction| match action {
                RestAction::Pick => (at[0], at[1]),
                RestAction::Place => (at[at.len() - 2], at[at.len() - 1]),
            };
            for action in [RestAction::Pick, RestAction::Place] {
                let (from, to) = edge_of(action);
                let clashing = Clashing { from: NodeId(from), to: NodeId(to), object: Some(self.object) };
                carries.insert((self.object, action, carriers.clone()), clashing);
            }
            for &(action, blocker) in guards {
                let (from, to) = edge_of(action);
                instance.blocks.push(Block { from: NodeId(from), to: NodeId(to), at: NodeId(blocker) });
            }
        }
        instance.nodes = nodes;
        if let Some(object) = instance.objects.get_mut(self.object) {
            object.class = class;
            if let Some(&hand) = first.get(&self.start) {
                object.start = NodeId(hand);
            }
        }
    }
}
