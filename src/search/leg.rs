//! Legs: what a guide's plan asks of one object between two places of rest.

use crate::guidance::{Guide, Move, NodeId};
use crate::workcell::ArmId;

use super::map::Map;
use super::tree::{Vertex, Whereabouts};

/// One object's way from where it rests, or is held, to its next place of rest.
#[derive(Debug, Clone)]
pub(super) struct Leg {
    pub(super) object: usize,
    /// The arms on the way, first to last; the one that holds it at first included.
    pub(super) arms: Vec<ArmId>,
    /// The moves with the steps, from 1, in which they happen.
    pub(super) moves: Vec<(usize, Move)>,
    /// Where it is put down.
    pub(super) end: NodeId,
}

impl Leg {
    /// The step in which the object leaves its place of rest; 0 when it is in hand already.
    pub(super) fn begins(&self) -> usize {
        if self.arms.len() == self.moves.len() { 0 } else { self.moves.first().map_or(0, |(step, _)| *step) }
    }

    /// The step in which it is put down.
    pub(super) fn ends(&self) -> usize {
        self.moves.last().map_or(0, |(step, _)| *step)
    }

    /// The pick, when the object is at rest at first.
    pub(super) fn pick(&self) -> Option<Move> {
        if self.begins() == 0 { None } else { self.moves.first().map(|(_, action)| *action) }
    }

    /// The place at the end.
    pub(super) fn place(&self) -> Option<Move> {
        self.moves.last().map(|(_, action)| *action)
    }
}

/// The legs of `guide` from `vertex`, in order of their ends; those of one object follow one
/// another. Where a guide without foresight ends with an object in hand, the object's own
/// shortest way is taken for the rest.
pub(super) fn legs(map: &Map, vertex: &Vertex, guide: &Guide) -> Vec<Leg> {
    let mut legs = Vec::new();
    let last = guide.solution.steps.len();
    for object in 0..vertex.objects.len() {
        let mut moves: Vec<(usize, Move)> = Vec::new();
        for (index, step) in guide.solution.steps.iter().enumerate() {
            moves.extend(step.iter().filter(|m| m.object == object).map(|m| (index + 1, *m)));
        }
        let Some(mut at) = moves.last().map(|(_, action)| action.to) else { continue };
        let mut step = last;
        while map.arm(at).is_some() {
            let Some(to) = map.network().next_on_shortest_way(object, at) else { break };
            step += 1;
            moves.push((step, Move { object, from: at, to }));
            at = to;
        }
        let mut arms = Vec::new();
        if let Whereabouts::Held { arm, .. } = vertex.objects[object] {
            arms.push(arm);
        }
        let mut open = Vec::new();
        for (step, action) in moves {
            open.push((step, action));
            match map.arm(action.to) {
                Some(arm) => arms.push(arm),
                None => legs.push(Leg {
                    object,
                    arms: std::mem::take(&mut arms),
                    moves: std::mem::take(&mut open),
                    end: action.to,
                }),
            }
        }
    }
    legs.sort_by_key(|leg| (leg.ends(), leg.object));
    legs
}
