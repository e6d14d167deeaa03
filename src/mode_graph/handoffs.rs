//! Which arms can hand over to which, for one class of objects.

use crate::geometry::Pose;
use crate::problem::Problem;
use crate::run::Control;
use crate::workcell::{Arm, ArmId, ObjectId, ObjectModel, SurfaceId};

use super::holds::{ArmHolds, RestHolds, is_same};
use super::proof::Proof;
use super::reach::{HandoffWitness, Hold, Reach, RestAction};
use super::survey::Group;

/// A pair of arms that can hand over, with a case of it.
#[derive(Debug)]
pub(super) struct Handover {
    pub(super) giver: ArmId,
    pub(super) receiver: ArmId,
    pub(super) witness: HandoffWitness,
}

/// Handoffs that were found while one graph is built, for all that may do with one of them again: the
/// fewer are looked for, the better. What is known depends on nothing but what was asked before.
#[derive(Debug, Default)]
pub(super) struct Meetings(Vec<(ArmId, ArmId, usize, HandoffWitness)>);

impl Meetings {
    /// Keeps a handoff of an object of `class`, backwards in time too where that `is_mirrored`.
    fn keep(
        &mut self,
        (giver, receiver): (ArmId, ArmId),
        class: usize,
        witness: &HandoffWitness,
        is_mirrored: bool,
    ) {
        self.0.push((giver, receiver, class, witness.clone()));
        if is_mirrored {
            self.0.push((receiver, giver, class, witness.reversed()));
        }
    }

    /// One by which an object of `class` can go from a hold of `giving` to one of `taking`.
    fn find(
        &self,
        arms: (ArmId, ArmId),
        class: usize,
        giving: &[Hold],
        taking: &[Hold],
    ) -> Option<HandoffWitness> {
        let mut known =
            self.0.iter().filter(|(giver, receiver, of, _)| (*giver, *receiver) == arms && *of == class);
        let has = |holds: &[Hold], hold: &Hold| holds.iter().any(|other| is_same(other, hold));
        let suits = |witness: &HandoffWitness| {
            has(giving, &witness.giver_hold) && has(taking, &witness.receiver_hold)
        };
        known.find(|(.., witness)| suits(witness)).map(|(.., witness)| witness.clone())
    }
}

/// Spots of each region by which further holds are looked for.
const FURTHER_SPOTS: usize = 3;

/// All ordered pairs of arms that can hand over objects like `object`: the giver in a hold that it
/// can come by, by a pick or an earlier handoff, the receiver in one that it can place, or else
/// pass on. Where arms do not come together by the `holds` of starts and goals, an object may be put
/// down in one of the `regions` and taken up in another way in between. The second value is `false`
/// when `control` stopped it.
pub(super) fn handoffs(
    problem: &Problem,
    reach: &mut dyn Reach,
    proof: &Proof<'_>,
    object: ObjectId,
    (holds, regions): (&RestHolds, &[(SurfaceId, Group)]),
    meetings: &mut Meetings,
    control: &Control,
) -> (Vec<Handover>, bool) {
    let arms = &problem.workcell.arms;
    let class = problem.objects[object.0].class;
    let mut pairs: Vec<(usize, usize)> = (0..arms.len())
        .flat_map(|a| (0..arms.len()).map(move |b| (a, b)))
        .filter(|&(a, b)| a != b && proof.may_meet(ArmId(a), ArmId(b), class))
        .collect();
    let apart =
        |&(a, b): &(usize, usize)| (arms[a].base.translation.vector - arms[b].base.translation.vector).norm();
    pairs.sort_by(|x, y| apart(x).total_cmp(&apart(y)));
    let mut finder = Finder {
        reach,
        meetings,
        object,
        class,
        is_mirrored: problem.objects[object.0].approach == problem.objects[object.0].retreat,
        all: arms.iter().map(|arm| every_hold(problem, object, arm)).collect(),
        obtained: holds.picked.clone(),
        placeable: holds.placeable.clone(),
        found: Vec::new(),
    };
    let mut complete = finder.look(&pairs, false, control);
    if complete && pairs.iter().any(|&(a, b)| !finder.leads(a, b)) {
        finder.add_spots(regions);
        complete = finder.look(&pairs, true, control);
    }
    (finder.found, complete)
}

/// Every grasp of the object that fits the arm's gripper.
fn every_hold(problem: &Problem, object: ObjectId, arm: &Arm) -> Vec<Hold> {
    let grasps = problem.objects[object.0].grasps.iter().enumerate();
    let usable = grasps.filter(|(_, grasp)| grasp.fits(arm.tool.max_opening));
    usable.map(|(n, g)| Hold { grasp: Some(n), object_in_tcp: g.object_in_tcp }).collect()
}

/// What is known while handoffs of one class are looked for.
pub(super) struct Finder<'a> {
    reach: &'a mut dyn Reach,
    meetings: &'a mut Meetings,
    object: ObjectId,
    class: usize,
    /// Whether a handoff backwards in time is a handoff: the giver's retreat is then the
    /// receiver's approach.
    is_mirrored: bool,
    /// By arm, all grasps that it can use at all.
    all: Vec<Vec<Hold>>,
    /// By arm, the holds in which it may come to have an object.
    obtained: Vec<ArmHolds>,
    /// By arm, the holds in which it may put one down.
    placeable: Vec<ArmHolds>,
    found: Vec<Handover>,
}

impl<'a> Finder<'a> {
    /// Looks for handoffs of `object` between the `holds` by which it is taken up and put down.
    pub(super) fn for_rest(
        reach: &'a mut dyn Reach,
        meetings: &'a mut Meetings,
        (object, model): (ObjectId, &ObjectModel),
        holds: &RestHolds,
    ) -> Self {
        Self {
            reach,
            meetings,
            object,
            class: model.class,
            is_mirrored: model.approach == model.retreat,
            all: Vec::new(),
            obtained: holds.picked.clone(),
            placeable: holds.placeable.clone(),
            found: Vec::new(),
        }
    }
}

impl Finder<'_> {
    /// Looks for handoffs of all `pairs`, or of those alone that have no way from the one to the other, until no
    /// more are found; whether it came to the end.
    fn look(&mut self, pairs: &[(usize, usize)], apart_only: bool, control: &Control) -> bool {
        // How many holds the giver had when the pair was tried last.
        let mut tried = vec![0; pairs.len()];
        loop {
            let mut changed = false;
            for (index, &(a, b)) in pairs.iter().enumerate() {
                let count = self.obtained[a].likely.len();
                if self.is_known(a, b) || count <= tried[index] || apart_only && self.leads(a, b) {
                    continue;
                }
                if control.should_stop() {
                    return false;
                }
                tried[index] = count;
                let passes_on = pairs.iter().any(|&(from, to)| from == b && to != a);
                changed |= self.find(ArmId(a), ArmId(b), passes_on);
            }
            if !changed {
                return true;
            }
        }
    }

    /// Whether objects can go from one arm's hand to another's, over any others.
    fn leads(&self, from: usize, to: usize) -> bool {
        let mut reached = vec![from];
        let mut next = 0;
        while let Some(&at) = reached.get(next) {
            next += 1;
            for pair in self.found.iter().filter(|pair| pair.giver.0 == at) {
                if !reached.contains(&pair.receiver.0) {
                    reached.push(pair.receiver.0);
                }
            }
        }
        reached.contains(&to)
    }

    /// Adds the holds that arms have at a few spots of their regions.
    fn add_spots(&mut self, regions: &[(SurfaceId, Group)]) {
        for (surface, group) in regions {
            let stride = group.spots.len().div_ceil(FURTHER_SPOTS).max(1);
            let poses = group.spots.iter().step_by(stride).filter_map(|spot| spot.poses.first().copied());
            for pose in poses.collect::<Vec<Pose>>() {
                for &arm in &group.arms {
                    for (action, known) in [
                        (RestAction::Pick, &mut self.obtained[arm.0]),
                        (RestAction::Place, &mut self.placeable[arm.0]),
                    ] {
                        let likely = self.reach.possible_holds(action, arm, self.object, &pose, *surface);
                        known.add(self.object, &[pose], *surface, &likely);
                    }
                }
            }
        }
    }

    fn is_known(&self, giver: usize, receiver: usize) -> bool {
        self.found.iter().any(|pair| pair.giver.0 == giver && pair.receiver.0 == receiver)
    }

    /// Looks for a handoff to be placed, then for one to be passed on; whether there is one.
    fn find(&mut self, giver: ArmId, receiver: ArmId, passes_on: bool) -> bool {
        let witness = self
            .backwards(giver, receiver, passes_on)
            .or_else(|| self.ends_placed(giver, receiver))
            .or_else(|| if passes_on { self.ends_passed_on(giver, receiver) } else { None });
        let Some(witness) = witness else { return false };
        self.found.push(Handover { giver, receiver, witness });
        let all = self.all[receiver.0].clone();
        self.obtained[receiver.0].add_certain(&all);
        true
    }

    /// The handoff found the other way round, if it is one this way too.
    fn backwards(&mut self, giver: ArmId, receiver: ArmId, passes_on: bool) -> Option<HandoffWitness> {
        let other = self.found.iter().find(|pair| pair.giver == receiver && pair.receiver == giver)?;
        if !self.is_mirrored {
            return None;
        }
        let witness = other.witness.reversed();
        if !self.confirm_giver(giver, &witness.giver_hold) {
            return None;
        }
        let is_grasp = witness.receiver_hold.grasp.is_some();
        let placed = is_grasp && self.confirm_receiver(receiver, &witness.receiver_hold);
        (placed || (is_grasp && passes_on)).then_some(witness)
    }

    /// A handoff to a hold in which the receiver can put the object down.
    pub(super) fn ends_placed(&mut self, giver: ArmId, receiver: ArmId) -> Option<HandoffWitness> {
        loop {
            let (giving, taking) = (&self.obtained[giver.0].likely, &self.placeable[receiver.0].likely);
            if giving.is_empty() || taking.is_empty() {
                return None;
            }
            let known = self.meetings.find((giver, receiver), self.class, giving, taking);
            let witness = match known {
                Some(known) => known,
                None => {
                    let found = self.reach.handoff(giver, receiver, self.object, giving, taking)?;
                    self.meetings.keep((giver, receiver), self.class, &found, self.is_mirrored);
                    found
                }
            };
            // Each round without success leaves fewer holds to try.
            let gives = self.confirm_giver(giver, &witness.giver_hold);
            if gives && self.confirm_receiver(receiver, &witness.receiver_hold) {
                return Some(witness);
            }
        }
    }

    /// A handoff to a hold in which the receiver cannot put the object down.
    fn ends_passed_on(&mut self, giver: ArmId, receiver: ArmId) -> Option<HandoffWitness> {
        let placeable = &self.placeable[receiver.0].likely;
        let others: Vec<Hold> = self.all[receiver.0]
            .iter()
            .filter(|hold| !placeable.iter().any(|known| known.grasp == hold.grasp))
            .copied()
            .collect();
        if others.is_empty() {
            return None;
        }
        loop {
            let giving = &self.obtained[giver.0].likely;
            if giving.is_empty() {
                return None;
            }
            let witness = self.reach.handoff(giver, receiver, self.object, giving, &others)?;
            if self.confirm_giver(giver, &witness.giver_hold) {
                return Some(witness);
            }
        }
    }

    fn confirm_giver(&mut self, arm: ArmId, hold: &Hold) -> bool {
        self.obtained[arm.0].confirm(self.reach, RestAction::Pick, arm, hold)
    }

    fn confirm_receiver(&mut self, arm: ArmId, hold: &Hold) -> bool {
        self.placeable[arm.0].confirm(self.reach, RestAction::Place, arm, hold)
    }
}
