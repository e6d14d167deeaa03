//! The mode graph: arms and placements as nodes, picks, places and handoffs as edges.

use crate::geometry::{Pose, Vec3};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::reach::RestAction;
use super::witness::Witness;

/// Which of the two graphs it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GraphKind {
    /// The inner approximation that guides: sampled reach, packed capacities.
    Guidance,
    /// The outer one that bounds: edges are left out only by proof, capacities are upper bounds.
    Optimistic,
}

/// One exact placement where an object starts or must end.
#[derive(Debug, Clone, PartialEq)]
pub struct Slot {
    /// The object's frame in the world.
    pub pose: Pose,
    /// The surface under it.
    pub surface: SurfaceId,
    /// The class of the objects that start or end here.
    pub class: usize,
    /// Who starts here.
    pub start_of: Option<ObjectId>,
    /// Who must end here.
    pub goal_of: Option<ObjectId>,
}

/// A buffer placement inside a region. It overlaps no slot and no other spot of its class, with
/// room for the fingers between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Spot {
    /// Object poses (world) here: the first is the one whose reach was checked; the others turn
    /// the object about the surface's normal or stand it on another side of it, within the same
    /// footprint.
    pub poses: Vec<Pose>,
}

/// Neighbouring placements on one surface that the same arms reach, for one class of objects.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// The surface.
    pub surface: SurfaceId,
    /// The class of objects.
    pub class: usize,
    /// The arms that can pick and place here, ascending.
    pub arms: Vec<ArmId>,
    /// Where objects can be put aside.
    pub spots: Vec<Spot>,
    /// Whether spots were looked for only until there were enough on the surface; else no room for
    /// another one was found.
    pub more_may_fit: bool,
    /// Slots that are part of the region rather than nodes of their own: nothing conflicts with
    /// them, and no object has to move between two of them.
    pub merged: Vec<Slot>,
}

/// What a node stands for.
#[derive(Debug, Clone, PartialEq)]
pub enum Place {
    /// An arm: an object there is held.
    Arm(ArmId),
    /// An exact placement.
    Slot(Slot),
    /// A placement region.
    Region(Region),
    /// Anywhere else on a surface; in the optimistic graph only.
    Surface(SurfaceId),
}

/// A node.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeNode {
    /// What it stands for.
    pub place: Place,
    /// How many objects may be there at once.
    pub capacity: usize,
    /// Its centre in the world (m): an arm's base, the mean of a region's placements.
    pub centre: Vec3,
}

/// A pick, place or handoff of objects of one class.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeEdge {
    /// The node where the object is before.
    pub from: usize,
    /// The node where it is afterwards.
    pub to: usize,
    /// The class of the objects that can take it.
    pub class: usize,
    /// Distance between the two nodes' centres (m).
    pub weight: f64,
    /// A case of it: of handoffs in the guidance graph, and of picks and places for which
    /// [`super::find_witnesses`] found one.
    pub witness: Option<Witness>,
}

/// Placements that share room.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeConflict {
    /// The nodes, ascending.
    pub nodes: Vec<usize>,
    /// How many objects may be on them together.
    pub capacity: usize,
}

/// Where an object must end, in nodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModeGoal {
    /// On any one of these.
    Nodes(Vec<usize>),
    /// In nobody's hand.
    AnyPlacement,
}

/// An object on the graph.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeObject {
    /// Its node at the start.
    pub start: usize,
    /// Where it must end.
    pub goal: ModeGoal,
    /// Its class.
    pub class: usize,
    /// The poses (world) that meet a goal pose: the one given, then what the object's symmetry
    /// makes of it (a selection where that is infinitely many). Empty without a goal pose.
    pub goal_poses: Vec<Pose>,
}

/// A carry on which no grasps were found to fit together: `object` cannot be taken from its start by
/// the first of the `carriers` (one, or two that hand over) and be put down at its goal pose by the
/// last, unless it is taken up anew on the way.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct BarredCarry {
    /// The object.
    pub object: ObjectId,
    /// The arms, first to last.
    pub carriers: Vec<ArmId>,
}

/// A part of an object's way that something may be in the way of.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum BlockedPart {
    /// Its pick from its start, or its place at its goal, by an arm.
    Contact(RestAction, ArmId),
    /// That action in any hold in which it can be carried straight from start to goal by these arms,
    /// first to last.
    Carry(RestAction, Vec<ArmId>),
}

/// What cannot be done while anything stands in a slot.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Blockage {
    /// The object that cannot be moved.
    pub object: ObjectId,
    /// What cannot be done with it.
    pub part: BlockedPart,
    /// The node of the slot.
    pub at: usize,
}

/// A pick from an object's start, or a place at its goal, by the way of a straight carry.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct CarryEnd {
    /// The object.
    pub object: ObjectId,
    /// Which end of the carry.
    pub action: RestAction,
    /// The arms (one, or two that hand over) that carry it straight from start to goal, first to last.
    pub carriers: Vec<ArmId>,
}

/// The mode graph of a problem. Nodes are numbered; the first ones are the arms, in order.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeGraph {
    /// Inner or outer approximation.
    pub kind: GraphKind,
    /// The nodes.
    pub nodes: Vec<ModeNode>,
    /// The edges, sorted by (from, to, class).
    pub edges: Vec<ModeEdge>,
    /// Placements that exclude each other beyond the nodes' own capacities.
    pub conflicts: Vec<NodeConflict>,
    /// The objects, in the problem's order.
    pub objects: Vec<ModeObject>,
    /// Ways that look open edge by edge but are not, sorted. None on the optimistic graph.
    pub barred: Vec<BarredCarry>,
    /// What stands in the way of what, sorted. None on the optimistic graph.
    pub blockages: Vec<Blockage>,
    /// Actions of which no two contacts were found that leave both arms room, in any holds that suit their
    /// carries: not to be done in one step. Looked for where a plan has both in one (`planner`); none at first.
    pub crowdings: Vec<[CarryEnd; 2]>,
    /// Whether the build came to its end; `false` when it was stopped and regions, spots or
    /// handoffs may be missing.
    pub complete: bool,
}

/// Where an object can be put.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// The object's frame in the world.
    pub pose: Pose,
    /// The surface under it.
    pub surface: SurfaceId,
}

impl ModeGraph {
    /// The node of an arm.
    pub fn arm_node(&self, arm: ArmId) -> usize {
        arm.0
    }

    /// The arm that a node stands for, if it does.
    pub fn arm_of(&self, node: usize) -> Option<ArmId> {
        match self.nodes.get(node)?.place {
            Place::Arm(arm) => Some(arm),
            _ => None,
        }
    }

    /// The surface of a placement node.
    pub fn surface_of(&self, node: usize) -> Option<SurfaceId> {
        match &self.nodes.get(node)?.place {
            Place::Arm(_) => None,
            Place::Slot(slot) => Some(slot.surface),
            Place::Region(region) => Some(region.surface),
            Place::Surface(surface) => Some(*surface),
        }
    }

    /// The handoff edge for objects of `class`.
    pub fn handoff(&self, giver: ArmId, receiver: ArmId, class: usize) -> Option<&ModeEdge> {
        let (from, to) = (self.arm_node(giver), self.arm_node(receiver));
        self.edges.iter().find(|edge| edge.from == from && edge.to == to && edge.class == class)
    }

    /// The poses at which `object` may be put down at `node`, the preferred ones first: its goal
    /// poses alone where that is its goal; else the slot, or the region's spots. Whether other
    /// objects leave room there is for the caller to check. Empty for arms and on the optimistic
    /// graph's surfaces.
    pub fn placements(&self, object: ObjectId, node: usize) -> Vec<Placement> {
        let (Some(found), Some(this)) = (self.nodes.get(node), self.objects.get(object.0)) else {
            return Vec::new();
        };
        let at_goal =
            |surface| this.goal_poses.iter().map(move |&pose| Placement { pose, surface }).collect();
        match &found.place {
            Place::Arm(_) | Place::Surface(_) => Vec::new(),
            Place::Slot(slot) if slot.goal_of == Some(object) => at_goal(slot.surface),
            Place::Slot(slot) => vec![Placement { pose: slot.pose, surface: slot.surface }],
            Place::Region(region) => {
                if region.merged.iter().any(|slot| slot.goal_of == Some(object)) {
                    return at_goal(region.surface);
                }
                let own = region.merged.iter().filter(|slot| slot.start_of == Some(object));
                let spots = region.spots.iter().flat_map(|spot| &spot.poses);
                own.map(|slot| slot.pose)
                    .chain(spots.copied())
                    .map(|pose| Placement { pose, surface: region.surface })
                    .collect()
            }
        }
    }
}
