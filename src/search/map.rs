//! The mode graph with its compiled network, as the search reads it.

use crate::geometry::Pose;
use crate::guidance::{Instance, InstanceError, Network, NodeId};
use crate::mode_graph::{ModeGraph, Place};
use crate::problem::Problem;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// A mode graph and the network of guidance that was made from it.
#[derive(Debug)]
pub struct Map {
    graph: ModeGraph,
    network: Network,
}

impl Map {
    /// Compiles `graph`.
    ///
    /// # Errors
    /// When the graph makes no sense as an instance of guidance.
    pub fn new(graph: ModeGraph) -> Result<Self, InstanceError> {
        let network = Network::new(Instance::from(&graph))?;
        Ok(Self { graph, network })
    }

    /// The graph.
    pub fn graph(&self) -> &ModeGraph {
        &self.graph
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// The arm that `node` stands for, if it does.
    pub(super) fn arm(&self, node: NodeId) -> Option<ArmId> {
        self.graph.arm_of(node.0)
    }

    /// Where `object` may be put down at `node`.
    pub(super) fn placements(&self, object: usize, node: NodeId) -> Vec<(Pose, SurfaceId)> {
        self.graph
            .placements(ObjectId(object), node.0)
            .into_iter()
            .map(|placement| (placement.pose, placement.surface))
            .collect()
    }

    /// A name of the node for people.
    pub(super) fn name(&self, node: NodeId, problem: &Problem) -> String {
        let surface = |id: SurfaceId| problem.workcell.surfaces.get(id.0).map_or("?", |s| s.id.as_str());
        match self.graph.nodes.get(node.0).map(|node| &node.place) {
            Some(Place::Arm(arm)) => {
                problem.workcell.arms.get(arm.0).map_or_else(String::new, |arm| format!("arm {:?}", arm.id))
            }
            Some(Place::Slot(slot)) => format!("a place on {:?}", surface(slot.surface)),
            Some(Place::Region(region)) => format!("a free spot on {:?}", surface(region.surface)),
            Some(Place::Surface(id)) => format!("{:?}", surface(*id)),
            None => "nowhere".to_owned(),
        }
    }
}
