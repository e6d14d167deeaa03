//! The instance of multi-object path finding on a mode graph: nodes with capacities, actions as
//! directed edges, objects with starts and goals.

use thiserror::Error;

/// Index of a node in [`Instance::nodes`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub usize);

/// Where every object is: one node per object, in the order of [`Instance::objects`].
pub type ModeState = Vec<NodeId>;

/// What a node stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeKind {
    /// An arm: an object there is held.
    Arm,
    /// A placement region: objects there stand anywhere in it.
    Region,
    /// One exact placement.
    Slot,
}

/// A node of the mode graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node {
    /// What it stands for.
    pub kind: NodeKind,
    /// How many objects may be there at once; at most 1 for an arm.
    pub capacity: u32,
}

/// An action: `from` a placement to an arm it is a pick, from an arm to a placement a place, from
/// arm to arm a handoff.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Where the object is before.
    pub from: NodeId,
    /// Where it is afterwards.
    pub to: NodeId,
    /// Cost of the action (m): finite and not negative.
    pub weight: f64,
    /// The only class of objects that may take the edge; `None` for all.
    pub class: Option<usize>,
}

/// Nodes that share room: at no time may more than `capacity` objects be on them together,
/// counting what is there before a step and what enters during it.
///
/// A set of arm nodes with capacity 1 says that they are one arm, in states that differ by what it
/// can do with the object it holds. An arm node is in one such set at most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConflictSet {
    /// The nodes: placements alone, or arms alone.
    pub nodes: Vec<NodeId>,
    /// How many objects they hold together; 1 for two slots that overlap.
    pub capacity: u32,
}

/// An action that cannot be done while anything is at some placement, before the step or after it:
/// what stands there is in the way of the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Block {
    /// The action's edge.
    pub from: NodeId,
    /// The action's edge.
    pub to: NodeId,
    /// Where nothing may be: a slot of capacity 1, and no end of the edge.
    pub at: NodeId,
}

/// Actions of which one at most can be taken in a step: their arms would touch.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Clash {
    /// The actions.
    pub actions: Vec<Clashing>,
}

/// An action of a [`Clash`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Clashing {
    /// The action's edge.
    pub from: NodeId,
    /// The action's edge.
    pub to: NodeId,
    /// The only object of which it is meant; `None` for all.
    pub object: Option<usize>,
}

impl Clashing {
    /// Whether it means the action that takes `object` from `from` to `to`.
    pub fn means(&self, object: usize, from: NodeId, to: NodeId) -> bool {
        (self.from, self.to) == (from, to) && self.object.is_none_or(|only| only == object)
    }
}

impl From<(NodeId, NodeId)> for Clashing {
    /// The edge, from where to where, whoever takes it.
    fn from((from, to): (NodeId, NodeId)) -> Self {
        Self { from, to, object: None }
    }
}

/// Where an object must end.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Goal {
    /// On any one of these nodes.
    Nodes(Vec<NodeId>),
    /// In nobody's hand.
    AnyPlacement,
}

/// An object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Object {
    /// Where it is at first.
    pub start: NodeId,
    /// Where it must end.
    pub goal: Goal,
    /// Objects of one class may take the same edges.
    pub class: usize,
}

/// An instance.
///
/// # Rules of a step
///
/// In a step every object stays where it is or takes one edge. An arm takes part in at most one
/// action (a handoff is one action of both its arms) and holds at most one object. Wherever an
/// object enters, what was there before the step and all that enters may not exceed the capacity
/// of the node, nor of any [`ConflictSet`] around it; and no action may be taken that a [`Block`]
/// forbids while something is where it says, nor two that are in one [`Clash`]. Nothing is asked of a node that nothing
/// enters, so a start may be fuller than a capacity that was computed with a margin.
///
/// A plan ends when all goals are met at once. Of two plans the one with fewer steps is better;
/// among equals the one with the smaller sum of edge weights.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Instance {
    /// The nodes.
    pub nodes: Vec<Node>,
    /// The actions. Parallel edges are allowed; the lighter counts.
    pub edges: Vec<Edge>,
    /// Placements that share room.
    pub conflicts: Vec<ConflictSet>,
    /// What stands in the way of what.
    pub blocks: Vec<Block>,
    /// Which actions keep each other from being taken at once.
    pub clashes: Vec<Clash>,
    /// The objects.
    pub objects: Vec<Object>,
}

/// Why an instance or a state of it makes no sense.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum InstanceError {
    /// Something names a node that is not there.
    #[error("{what} names node {node}, but there are only {count}")]
    NoSuchNode {
        /// Who names it.
        what: &'static str,
        /// The index.
        node: usize,
        /// How many nodes there are.
        count: usize,
    },
    /// A clash names an object that is not there.
    #[error("a clash names object {object}, but there are only {count}")]
    NoSuchObject {
        /// The index.
        object: usize,
        /// How many objects there are.
        count: usize,
    },
    /// An arm with a capacity over 1.
    #[error("arm node {0} has a capacity over 1")]
    ArmCapacity(usize),
    /// An edge without an arm, from a node to itself, or between two nodes of one arm.
    #[error("edge {0} is no pick, place or handoff")]
    NotAnAction(usize),
    /// A weight that is negative or not finite.
    #[error("edge {0} has a weight that is negative or not finite")]
    BadWeight(usize),
    /// A conflict set that holds an arm and is not a set of the nodes of one arm.
    #[error(
        "conflict set {0} holds an arm, but it is not the only set of the nodes of that arm, with capacity 1"
    )]
    ArmInConflict(usize),
    /// A block whose place is no slot of capacity 1, or an end of its edge.
    #[error("block {0} names no slot of capacity 1 beside its action")]
    BadBlock(usize),
    /// Two objects in one hand.
    #[error("the arm of node {0} holds more than one object")]
    HeldTwice(usize),
    /// A state with more or fewer nodes than there are objects.
    #[error("the state places {placed} objects, the instance has {objects}")]
    StateLength {
        /// Length of the state.
        placed: usize,
        /// Number of objects.
        objects: usize,
    },
    /// More nodes, conflict sets with blocks and clashes, or objects than the solvers index.
    #[error("the instance has more than {0} nodes, conflict sets with blocks and clashes, or objects")]
    TooLarge(usize),
}

/// Nodes and objects are indexed with 16 bits inside the solvers.
const MOST: usize = 30_000;

impl Instance {
    /// The start of every object.
    pub fn start(&self) -> ModeState {
        self.objects.iter().map(|object| object.start).collect()
    }

    /// Whether `node` is an arm.
    pub fn is_arm(&self, node: NodeId) -> bool {
        self.nodes.get(node.0).is_some_and(|node| node.kind == NodeKind::Arm)
    }

    /// Whether `node` satisfies the goal of object `object`.
    pub fn meets_goal(&self, object: usize, node: NodeId) -> bool {
        match self.objects.get(object).map(|object| &object.goal) {
            Some(Goal::Nodes(nodes)) => nodes.contains(&node),
            Some(Goal::AnyPlacement) => !self.is_arm(node),
            None => false,
        }
    }

    /// Whether every goal is met in `state`.
    pub fn is_solved(&self, state: &[NodeId]) -> bool {
        state.len() == self.objects.len()
            && state.iter().enumerate().all(|(object, &node)| self.meets_goal(object, node))
    }

    /// Checks that the instance makes sense.
    ///
    /// # Errors
    ///
    /// The first fault found, as an [`InstanceError`].
    pub fn validate(&self) -> Result<(), InstanceError> {
        if self.nodes.len() > MOST
            || self.objects.len() > MOST
            || self.conflicts.len() + self.blocks.len() + self.clashes.len() > MOST
        {
            return Err(InstanceError::TooLarge(MOST));
        }
        for (index, node) in self.nodes.iter().enumerate() {
            if node.kind == NodeKind::Arm && node.capacity > 1 {
                return Err(InstanceError::ArmCapacity(index));
            }
        }
        for (index, edge) in self.edges.iter().enumerate() {
            self.require("an edge", edge.from)?;
            self.require("an edge", edge.to)?;
            if edge.from == edge.to || !(self.is_arm(edge.from) || self.is_arm(edge.to)) {
                return Err(InstanceError::NotAnAction(index));
            }
            if !(edge.weight.is_finite() && edge.weight >= 0.0) {
                return Err(InstanceError::BadWeight(index));
            }
        }
        let mut in_set = vec![false; self.nodes.len()];
        for (index, set) in self.conflicts.iter().enumerate() {
            for &node in &set.nodes {
                self.require("a conflict set", node)?;
            }
            let arms: Vec<NodeId> = set.nodes.iter().copied().filter(|&node| self.is_arm(node)).collect();
            let is_one_arm = arms.len() == set.nodes.len() && set.capacity == 1;
            let again = arms.iter().any(|node| std::mem::replace(&mut in_set[node.0], true));
            if !arms.is_empty() && (!is_one_arm || again) {
                return Err(InstanceError::ArmInConflict(index));
            }
            let inside = |node: NodeId| arms.contains(&node);
            if let Some(edge) = self.edges.iter().position(|edge| inside(edge.from) && inside(edge.to)) {
                return Err(InstanceError::NotAnAction(edge));
            }
        }
        for (index, block) in self.blocks.iter().enumerate() {
            for node in [block.from, block.to, block.at] {
                self.require("a block", node)?;
            }
            let at = self.nodes[block.at.0];
            let is_slot = at.kind == NodeKind::Slot && at.capacity <= 1;
            if !is_slot || [block.from, block.to].contains(&block.at) {
                return Err(InstanceError::BadBlock(index));
            }
        }
        for action in self.clashes.iter().flat_map(|clash| &clash.actions) {
            self.require("a clash", action.from)?;
            self.require("a clash", action.to)?;
            if let Some(object) = action.object.filter(|&object| object >= self.objects.len()) {
                return Err(InstanceError::NoSuchObject { object, count: self.objects.len() });
            }
        }
        for object in &self.objects {
            if let Goal::Nodes(nodes) = &object.goal {
                for &node in nodes {
                    self.require("a goal", node)?;
                }
            }
        }
        self.validate_state(&self.start())
    }

    /// Checks that `state` is one of this instance: as many nodes as objects, no arm holding two.
    ///
    /// # Errors
    ///
    /// The first fault found.
    pub fn validate_state(&self, state: &[NodeId]) -> Result<(), InstanceError> {
        if state.len() != self.objects.len() {
            return Err(InstanceError::StateLength { placed: state.len(), objects: self.objects.len() });
        }
        let mut held = vec![false; self.nodes.len()];
        for &node in state {
            self.require("a state", node)?;
            if self.is_arm(node) && std::mem::replace(&mut held[node.0], true) {
                return Err(InstanceError::HeldTwice(node.0));
            }
        }
        for set in &self.conflicts {
            let mut holding = set.nodes.iter().filter(|&&node| self.is_arm(node) && held[node.0]);
            if let (Some(_), Some(node)) = (holding.next(), holding.next()) {
                return Err(InstanceError::HeldTwice(node.0));
            }
        }
        Ok(())
    }

    /// Whether one more object may be put down at `node`, where `count` says how many are at some nodes.
    pub fn has_room(&self, node: NodeId, count: impl Fn(&[NodeId]) -> usize) -> bool {
        let has_room = |nodes: &[NodeId], capacity: u32| count(nodes) < capacity as usize;
        let sets = self.conflicts.iter().filter(|set| set.nodes.contains(&node));
        self.nodes.get(node.0).is_some_and(|at| has_room(&[node], at.capacity))
            && sets.into_iter().all(|set| has_room(&set.nodes, set.capacity))
    }

    fn require(&self, what: &'static str, node: NodeId) -> Result<(), InstanceError> {
        if node.0 < self.nodes.len() {
            Ok(())
        } else {
            Err(InstanceError::NoSuchNode { what, node: node.0, count: self.nodes.len() })
        }
    }
}
