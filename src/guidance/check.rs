//! The independent checker of plans on the mode graph. It shares no code with the solvers: it
//! replays a plan by the rules as [`Instance`] states them.

use super::instance::{Block, Instance, InstanceError, NodeId};
use super::solution::Solution;
use thiserror::Error;

/// The first rule that a plan breaks. Steps count from 1.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Violation {
    /// The instance or the plan's start makes no sense.
    #[error(transparent)]
    Malformed(#[from] InstanceError),
    /// A step without a move.
    #[error("step {0} moves nothing")]
    EmptyStep(usize),
    /// A move of an object that is not there.
    #[error("step {step} moves object {object}, which does not exist")]
    NoSuchObject {
        /// The step.
        step: usize,
        /// The object.
        object: usize,
    },
    /// An object moves twice in one step, or moves are out of order.
    #[error("step {step} lists object {object} twice or out of order")]
    OutOfOrder {
        /// The step.
        step: usize,
        /// The object.
        object: usize,
    },
    /// A move starts where the object is not.
    #[error("step {step} moves object {object} from a node where it is not")]
    NotThere {
        /// The step.
        step: usize,
        /// The object.
        object: usize,
    },
    /// No edge for this object's class.
    #[error("step {step} moves object {object} along an edge that does not exist")]
    NoSuchEdge {
        /// The step.
        step: usize,
        /// The object.
        object: usize,
    },
    /// An arm takes part in two actions.
    #[error("step {step} uses arm node {node} twice")]
    ArmTwice {
        /// The step.
        step: usize,
        /// The arm.
        node: usize,
    },
    /// A node is entered beyond its capacity.
    #[error("step {step} fills node {node} beyond its capacity")]
    OverCapacity {
        /// The step.
        step: usize,
        /// The node.
        node: usize,
    },
    /// A conflict set is entered beyond its capacity.
    #[error("step {step} fills conflict set {set} beyond its capacity")]
    OverConflict {
        /// The step.
        step: usize,
        /// The set.
        set: usize,
    },
    /// An action that something blocks.
    #[error("step {step} moves object {object} past what stands at node {at}")]
    Blocked {
        /// The step.
        step: usize,
        /// The object.
        object: usize,
        /// Where it stands.
        at: usize,
    },
    /// Two actions at once that clash.
    #[error("step {step} takes more than one of the actions of clash {clash}")]
    Clashing {
        /// The step.
        step: usize,
        /// The clash.
        clash: usize,
    },
    /// Goals are not met in the end.
    #[error("object {0} does not end at its goal")]
    GoalMissed(usize),
    /// The weight given is not the sum of the edges'.
    #[error("the plan claims weight {claimed}, its edges sum to {actual}")]
    WrongWeight {
        /// What the plan says.
        claimed: f64,
        /// What its edges sum to.
        actual: f64,
    },
}

/// Replays `solution` on `instance` from the solution's own start.
///
/// # Errors
///
/// The first rule broken.
pub fn check(instance: &Instance, solution: &Solution) -> Result<(), Violation> {
    instance.validate()?;
    instance.validate_state(&solution.start)?;
    let mut state = solution.start.clone();
    let mut weight = 0.0;
    for (index, moves) in solution.steps.iter().enumerate() {
        let step = index + 1;
        if moves.is_empty() {
            return Err(Violation::EmptyStep(step));
        }
        let mut actions = vec![0_usize; instance.nodes.len()];
        let mut entering: Vec<Vec<usize>> = vec![Vec::new(); instance.nodes.len()];
        let mut last = None;
        for action in moves {
            let object = action.object;
            let Some(&here) = state.get(object) else {
                return Err(Violation::NoSuchObject { step, object });
            };
            if last.is_some_and(|last| last >= object) {
                return Err(Violation::OutOfOrder { step, object });
            }
            last = Some(object);
            if here != action.from {
                return Err(Violation::NotThere { step, object });
            }
            weight += lightest_edge(instance, object, action.from, action.to)
                .ok_or(Violation::NoSuchEdge { step, object })?;
            for node in [action.from, action.to] {
                if instance.is_arm(node) {
                    actions[node.0] += 1;
                    if actions[node.0] > 1 {
                        return Err(Violation::ArmTwice { step, node: node.0 });
                    }
                }
            }
            entering[action.to.0].push(object);
        }
        let before = |node: NodeId| state.iter().filter(|&&at| at == node).count();
        for (node, data) in instance.nodes.iter().enumerate() {
            let enters = entering[node].len();
            if enters > 0 && before(NodeId(node)) + enters > data.capacity as usize {
                return Err(Violation::OverCapacity { step, node });
            }
        }
        for (set, data) in instance.conflicts.iter().enumerate() {
            let mut nodes = data.nodes.clone();
            nodes.sort_unstable();
            nodes.dedup();
            let enters: usize = nodes.iter().map(|node| entering[node.0].len()).sum();
            let held: usize = nodes.iter().map(|&node| before(node)).sum();
            if enters > 0 && held + enters > data.capacity as usize {
                return Err(Violation::OverConflict { step, set });
            }
        }
        for (clash, data) in instance.clashes.iter().enumerate() {
            let means = |action: &&super::solution::Move| {
                data.actions.iter().any(|one| one.means(action.object, action.from, action.to))
            };
            let taken = moves.iter().filter(means);
            if taken.count() > 1 {
                return Err(Violation::Clashing { step, clash });
            }
        }
        let mut after = state.clone();
        for action in moves {
            after[action.object] = action.to;
        }
        for action in moves {
            let on_edge = |block: &&Block| (block.from, block.to) == (action.from, action.to);
            let is_taken = |block: &&Block| state.contains(&block.at) || after.contains(&block.at);
            if let Some(block) = instance.blocks.iter().filter(on_edge).find(is_taken) {
                return Err(Violation::Blocked { step, object: action.object, at: block.at.0 });
            }
        }
        state = after;
    }
    for (object, &node) in state.iter().enumerate() {
        if !instance.meets_goal(object, node) {
            return Err(Violation::GoalMissed(object));
        }
    }
    if (weight - solution.weight).abs() > 1e-6 * (1.0 + weight) {
        return Err(Violation::WrongWeight { claimed: solution.weight, actual: weight });
    }
    Ok(())
}

fn lightest_edge(instance: &Instance, object: usize, from: NodeId, to: NodeId) -> Option<f64> {
    let class = instance.objects[object].class;
    instance
        .edges
        .iter()
        .filter(|edge| edge.from == from && edge.to == to && edge.class.is_none_or(|only| only == class))
        .map(|edge| edge.weight)
        .min_by(f64::total_cmp)
}
