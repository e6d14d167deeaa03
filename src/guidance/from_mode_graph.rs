//! Mode graphs as instances: node for node, with the same numbers, and further nodes for hands that
//! hold an object as they took it at its start.
//!
//! A [`BarredCarry`] is no matter of single edges. So each object that has some gets nodes of its own
//! for the arms concerned, which say where it came from: a *first* hand, that picked it at its start
//! and cannot place it at the goal, or cannot hand it on to every arm, and a *second* hand, that got
//! it from such a one and cannot place it at the goal. All nodes of one arm share its capacity. Once
//! the object was put down or went on to a third arm, the plain nodes stand for it again.

use std::collections::BTreeMap;

use super::instance::{ConflictSet, Edge, Goal, Instance, Node, NodeId, NodeKind, Object};
use crate::mode_graph::{BarredCarry, ModeEdge, ModeGoal, ModeGraph, Place};

/// The instance of a mode graph, and which node of the graph each of its nodes stands for: node `n` of
/// the graph is `NodeId(n)`, nodes beyond are hands. Object `o` is object `o`.
pub fn instance_of(graph: &ModeGraph) -> (Instance, Vec<usize>) {
    let mut instance = plain(graph);
    let mut stands_for: Vec<usize> = (0..graph.nodes.len()).collect();
    let mut hands: BTreeMap<usize, Vec<NodeId>> = BTreeMap::new();
    for barred in graph.barred.chunk_by(|a, b| a.object == b.object) {
        let Some(refined) = Refined::new(graph, barred) else { continue };
        refined.enter(graph, &mut instance, &mut stands_for, &mut hands);
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
    let conflicts = graph.conflicts.iter().map(|conflict| ConflictSet {
        nodes: ids(&conflict.nodes),
        capacity: count(conflict.capacity),
    });
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
        objects: objects.collect(),
    }
}

fn as_edge(edge: &ModeEdge, from: usize, to: usize, class: usize) -> Edge {
    Edge { from: NodeId(from), to: NodeId(to), weight: edge.weight, class: Some(class) }
}

/// An object with barred carries.
struct Refined<'a> {
    object: usize,
    class: usize,
    start: usize,
    goal: usize,
    barred: &'a [BarredCarry],
}

impl<'a> Refined<'a> {
    /// `None` where start or goal are no nodes of their own.
    fn new(graph: &ModeGraph, barred: &'a [BarredCarry]) -> Option<Self> {
        let id = barred.first()?.object;
        let object = graph.objects.get(id.0)?;
        let ModeGoal::Nodes(goals) = &object.goal else { return None };
        let &[goal] = goals.as_slice() else { return None };
        let is_own = |node: usize, of: fn(&crate::mode_graph::Slot) -> Option<crate::workcell::ObjectId>| {
            matches!(&graph.nodes.get(node)?.place, Place::Slot(slot) if of(slot) == Some(id)).then_some(())
        };
        is_own(goal, |slot| slot.goal_of)?;
        if graph.arm_of(object.start).is_none() {
            is_own(object.start, |slot| slot.start_of)?;
        }
        Some(Self { object: id.0, class: object.class, start: object.start, goal, barred })
    }

    fn is_barred(&self, carriers: &[usize]) -> bool {
        self.barred.iter().any(|carry| carry.carriers.iter().map(|arm| arm.0).eq(carriers.iter().copied()))
    }

    /// Gives the object a class of its own, with edges by way of hands.
    fn enter(
        &self,
        graph: &ModeGraph,
        instance: &mut Instance,
        stands_for: &mut Vec<usize>,
        hands: &mut BTreeMap<usize, Vec<NodeId>>,
    ) {
        let class = 1 + instance.objects.iter().map(|object| object.class).max().unwrap_or(0);
        let mut add = |arm: usize| {
            let node = instance.nodes.len();
            instance.nodes.push(Node { kind: NodeKind::Arm, capacity: 1 });
            stands_for.push(arm);
            hands.entry(arm).or_default().push(NodeId(node));
            node
        };
        // By arm, the hand that holds the object as it was taken at its start, and the one that got it
        // from such a one.
        let (mut first, mut second) = (BTreeMap::new(), BTreeMap::new());
        for carry in self.barred {
            if let Some(arm) = carry.carriers.first() {
                first.entry(arm.0).or_insert_with(|| add(arm.0));
            }
            if let Some(arm) = carry.carriers.get(1) {
                second.entry(arm.0).or_insert_with(|| add(arm.0));
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
                if edge.to == self.goal && self.is_barred(&[arm]) {
                    continue;
                }
                let to = match second.get(&edge.to) {
                    Some(&receiver) if self.is_barred(&[arm, edge.to]) => receiver,
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
        if let Some(object) = instance.objects.get_mut(self.object) {
            object.class = class;
            if let Some(&hand) = first.get(&self.start) {
                object.start = NodeId(hand);
            }
        }
    }
}
