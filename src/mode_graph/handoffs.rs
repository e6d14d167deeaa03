//! Which arms can hand over to which, for one class of objects.

use crate::problem::Problem;
use crate::run::Control;
use crate::workcell::{ArmId, ObjectId};

use super::proof::Proof;
use super::reach::{HandoffWitness, Hold, Reach};

/// How each arm may hold an object of the class when it takes it off a surface, and when it puts
/// it on one.
#[derive(Debug, Clone)]
pub(super) struct RestHolds {
    /// By arm, from picks (or from the start, in the hand).
    pub(super) picked: Vec<Vec<Hold>>,
    /// By arm, for places.
    pub(super) placeable: Vec<Vec<Hold>>,
}

/// A pair of arms that can hand over, with a case of it.
#[derive(Debug)]
pub(super) struct Handover {
    pub(super) giver: ArmId,
    pub(super) receiver: ArmId,
    pub(super) witness: HandoffWitness,
}

/// All ordered pairs of arms that can hand over objects like `object`: the giver in a hold that it
/// can come by, by a pick or an earlier handoff, the receiver in one that it can place, or else
/// pass on. The second value is `false` when `control` stopped it.
pub(super) fn handoffs(
    problem: &Problem,
    reach: &mut dyn Reach,
    proof: &Proof<'_>,
    object: ObjectId,
    holds: &RestHolds,
    control: &Control,
) -> (Vec<Handover>, bool) {
    let arms = &problem.workcell.arms;
    let class = problem.objects[object.0].class;
    let all: Vec<Vec<Hold>> = arms
        .iter()
        .map(|arm| {
            let grasps = problem.objects[object.0].grasps.iter().enumerate();
            let usable = grasps.filter(|(_, grasp)| grasp.fits(arm.tool.max_opening));
            usable.map(|(n, g)| Hold { grasp: Some(n), object_in_tcp: g.object_in_tcp }).collect()
        })
        .collect();
    let mut pairs: Vec<(usize, usize)> = (0..arms.len())
        .flat_map(|a| (0..arms.len()).map(move |b| (a, b)))
        .filter(|&(a, b)| a != b && proof.may_meet(ArmId(a), ArmId(b), class))
        .collect();
    let apart =
        |&(a, b): &(usize, usize)| (arms[a].base.translation.vector - arms[b].base.translation.vector).norm();
    pairs.sort_by(|x, y| apart(x).total_cmp(&apart(y)));
    let passes_on = |arm: usize, not_to: usize| pairs.iter().any(|&(from, to)| from == arm && to != not_to);
    let mut obtained = holds.picked.clone();
    // How many holds the giver had when the pair was tried last.
    let mut tried = vec![0; pairs.len()];
    let mut found: Vec<Handover> = Vec::new();
    loop {
        let mut changed = false;
        for (index, &(a, b)) in pairs.iter().enumerate() {
            let (giver, receiver) = (ArmId(a), ArmId(b));
            let known = found.iter().any(|pair| pair.giver == giver && pair.receiver == receiver);
            if known || obtained[a].len() <= tried[index] {
                continue;
            }
            if control.should_stop() {
                return (found, false);
            }
            tried[index] = obtained[a].len();
            let placeable = &holds.placeable[b];
            let mut witness = None;
            if !placeable.is_empty() {
                witness = reach.handoff(giver, receiver, object, &obtained[a], placeable);
            }
            if witness.is_none() && passes_on(b, a) {
                let others: Vec<Hold> = all[b]
                    .iter()
                    .filter(|hold| !placeable.iter().any(|p| p.grasp == hold.grasp))
                    .copied()
                    .collect();
                if !others.is_empty() {
                    witness = reach.handoff(giver, receiver, object, &obtained[a], &others);
                }
            }
            if let Some(witness) = witness {
                found.push(Handover { giver, receiver, witness });
                changed = true;
                for hold in &all[b] {
                    if !obtained[b].iter().any(|known| known.grasp == hold.grasp) {
                        obtained[b].push(*hold);
                    }
                }
            }
        }
        if !changed {
            return (found, true);
        }
    }
}
