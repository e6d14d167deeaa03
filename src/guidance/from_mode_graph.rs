//! Mode graphs as instances: node for node, with the same numbers.

use super::instance::{ConflictSet, Edge, Goal, Instance, Node, NodeId, NodeKind, Object};
use crate::mode_graph::{ModeGoal, ModeGraph, Place};

impl From<&ModeGraph> for Instance {
    /// Node `n` of the graph is `NodeId(n)`, object `o` is object `o`.
    fn from(graph: &ModeGraph) -> Self {
        let count = |capacity: usize| u32::try_from(capacity).unwrap_or(u32::MAX);
        let nodes = |nodes: &[usize]| nodes.iter().map(|&node| NodeId(node)).collect();
        Self {
            nodes: graph
                .nodes
                .iter()
                .map(|node| Node {
                    kind: match node.place {
                        Place::Arm(_) => NodeKind::Arm,
                        Place::Slot(_) => NodeKind::Slot,
                        Place::Region(_) | Place::Surface(_) => NodeKind::Region,
                    },
                    capacity: count(node.capacity),
                })
                .collect(),
            edges: graph
                .edges
                .iter()
                .map(|edge| Edge {
                    from: NodeId(edge.from),
                    to: NodeId(edge.to),
                    weight: edge.weight,
                    class: Some(edge.class),
                })
                .collect(),
            conflicts: graph
                .conflicts
                .iter()
                .map(|conflict| ConflictSet {
                    nodes: nodes(&conflict.nodes),
                    capacity: count(conflict.capacity),
                })
                .collect(),
            objects: graph
                .objects
                .iter()
                .map(|object| Object {
                    start: NodeId(object.start),
                    goal: match &object.goal {
                        ModeGoal::Nodes(goal) => Goal::Nodes(nodes(goal)),
                        ModeGoal::AnyPlacement => Goal::AnyPlacement,
                    },
                    class: object.class,
                })
                .collect(),
        }
    }
}
