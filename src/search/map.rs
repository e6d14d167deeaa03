//! The mode graph with its compiled network, as the search reads it.

use std::sync::Arc;

use crate::geometry::Pose;
use crate::guidance::{InstanceError, Move, Network, NodeId, instance_of};
use crate::mode_graph::{ModeGraph, Place};
use crate::problem::Problem;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// A mode graph and the network of guidance that was made from it.
#[derive(Debug)]
pub struct Map {
    graph: ModeGraph,
    network: Arc<Network>,
    /// The node of the graph that each node of the network stands for.
    stands_for: Vec<usize>,
}

impl Map {
    /// Compiles `graph`.
    ///
    /// # Errors
    /// When the graph makes no sense as an instance of guidance.
    pub fn new(graph: ModeGraph) -> Result<Self, InstanceError> {
        let (instance, stands_for) = instance_of(&graph);
        Ok(Self { network: Arc::new(Network::new(instance)?), graph, stands_for })
    }

    /// The graph.
    pub fn graph(&self) -> &ModeGraph {
        &self.graph
    }

    /// The network.
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }

    /// The node of the graph that `node` stands for.
    fn in_graph(&self, node: NodeId) -> usize {
        self.stands_for.get(node.0).copied().unwrap_or(usize::MAX)
    }

    /// The arm that `node` stands for, if it does.
    pub(super) fn arm(&self, node: NodeId) -> Option<ArmId> {
        self.graph.arm_of(self.in_graph(node))
    }

    /// Whether two nodes stand for the same node of the graph.
    pub(super) fn is_same(&self, one: NodeId, other: NodeId) -> bool {
        self.in_graph(one) == self.in_graph(other)
    }

    /// Whether `action` hands an object from arm to arm.
    pub(super) fn is_handoff(&self, action: &Move) -> bool {
        self.arm(action.from).is_some() && self.arm(action.to).is_some()
    }

    /// Whether `node` is a region, where objects may stand in many places.
    pub(super) fn is_region(&self, node: NodeId) -> bool {
        matches!(self.graph.nodes.get(self.in_graph(node)).map(|n| &n.place), Some(Place::Region(_)))
    }

    /// Where `object` may be put down at `node`.
    pub(super) fn placements(&self, object: usize, node: NodeId) -> Vec<(Pose, SurfaceId)> {
        self.graph
            .placements(ObjectId(object), self.in_graph(node))
            .into_iter()
            .map(|placement| (placement.pose, placement.surface))
            .collect()
    }

    /// The regions where `arm` can put `object` aside.
    pub(super) fn regions_of(&self, object: usize, arm: ArmId) -> Vec<NodeId> {
        let Some(class) = self.graph.objects.get(object).map(|o| o.class) else { return Vec::new() };
        let from = self.graph.arm_node(arm);
        let is_region =
            |node: usize| matches!(self.graph.nodes.get(node).map(|n| &n.place), Some(Place::Region(_)));
        self.graph
            .edges
            .iter()
            .filter(|edge| edge.from == from && edge.class == class && is_region(edge.to))
            .map(|edge| NodeId(edge.to))
            .collect()
    }

    /// A name of the node for people.
    pub(super) fn name(&self, node: NodeId, problem: &Problem) -> String {
        self.graph.node_name(problem, self.in_graph(node))
    }
}
