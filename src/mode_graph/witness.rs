//! Witnesses: for every edge of the graph that guides a case of the action, for people and programs
//! that want to see it. The planner does without those of picks and places.

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Control;
use crate::workcell::{ObjectId, SurfaceId};

use super::graph::{GraphKind, ModeGraph, Place};
use super::reach::{HandoffWitness, Hold, Reach, RestAction, RestContact};

/// The proof that an action can be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Witness {
    /// Of a pick or a place.
    Rest(RestWitness),
    /// Of a handoff.
    Handoff(HandoffWitness),
}

impl Witness {
    /// The same case backwards in time.
    pub(super) fn reversed(&self) -> Self {
        match self {
            Self::Rest(rest) => Self::Rest(rest.clone()),
            Self::Handoff(handoff) => Self::Handoff(handoff.reversed()),
        }
    }
}

/// An arm at an object at rest: the proof that it can pick or place it.
#[derive(Debug, Clone, PartialEq)]
pub struct RestWitness {
    /// The arm's joints.
    pub q: Config,
    /// How it holds the object.
    pub hold: Hold,
    /// Where the object rests (world).
    pub pose: Pose,
    /// On what.
    pub surface: SurfaceId,
}

/// Finds a witness for every pick and place of the graph that guides; what is on it already stays. On
/// the optimistic graph there are none.
pub fn find_witnesses(problem: &Problem, graph: &mut ModeGraph, reach: &mut dyn Reach, control: &Control) {
    if graph.kind != GraphKind::Guidance {
        return;
    }
    for index in 0..graph.edges.len() {
        if control.should_stop() {
            return;
        }
        if graph.edges[index].witness.is_none() {
            graph.edges[index].witness = rest_witness(problem, graph, index, reach).map(Witness::Rest);
        }
    }
}

fn rest_witness(
    problem: &Problem,
    graph: &ModeGraph,
    edge: usize,
    reach: &mut dyn Reach,
) -> Option<RestWitness> {
    let edge = graph.edges.get(edge)?;
    let (action, arm, node) = match (graph.arm_of(edge.from), graph.arm_of(edge.to)) {
        (None, Some(arm)) => (RestAction::Pick, arm, edge.from),
        (Some(arm), None) => (RestAction::Place, arm, edge.to),
        _ => return None,
    };
    let owner = match &graph.nodes.get(node)?.place {
        Place::Slot(slot) => slot.goal_of.or(slot.start_of),
        _ => None,
    };
    let member = || problem.objects.iter().position(|object| object.class == edge.class).map(ObjectId);
    let object = owner.or_else(member)?;
    graph.placements(object, node).into_iter().find_map(|at| {
        let contact = RestContact { action, arm, object, pose: at.pose, surface: at.surface };
        let (hold, q) = reach.contact(&contact)?;
        Some(RestWitness { q, hold, pose: at.pose, surface: at.surface })
    })
}
