//! What was found out about reach in one workcell, for all runs on it.
//!
//! Answers depend on the question alone, so that it makes no difference to a run whether an answer
//! was known before: it is only sooner there.

mod stored;

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use sha2::{Digest, Sha256};

use crate::geometry::Pose;
use crate::mode_graph::{HandoffWitness, Hold, RestAction};
use crate::workcell::{ArmId, ObjectModel, SurfaceId};

use super::contacts::bits;
use super::draws::Draws;

/// Answers about rest that are kept at most; beyond it all are forgotten.
const MOST_REACHES: usize = 200_000;

/// Answers about handoffs that are kept at most.
const MOST_HANDOFFS: usize = 20_000;

/// Number of a class of objects in this memory.
pub(super) type Class = u32;

/// What is asked about a pick or place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Matter {
    /// Whether it seems possible.
    Estimate,
    /// Whether it is, by any grasp.
    Any,
    /// Whether it is, by the grasp of this number.
    Grasp(usize),
}

/// A pick or place: class, whether it is a place, arm, surface, pose, and what is asked.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RestQuestion {
    class: Class,
    is_place: bool,
    arm: usize,
    surface: usize,
    pose: [u64; 7],
    matter: Matter,
}

impl RestQuestion {
    pub(super) fn new(
        class: Class,
        action: RestAction,
        arm: ArmId,
        surface: SurfaceId,
        pose: &Pose,
        matter: Matter,
    ) -> Self {
        let is_place = action == RestAction::Place;
        Self { class, is_place, arm: arm.0, surface: surface.0, pose: bits(pose), matter }
    }
}

/// A handoff: class, giver, receiver, and the grasps of both.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct HandoffQuestion {
    class: Class,
    giver: usize,
    receiver: usize,
    giver_grasps: Vec<usize>,
    receiver_grasps: Vec<usize>,
}

impl HandoffQuestion {
    /// `None` where a hold is none of the class's grasps: such questions are not remembered.
    pub(super) fn new(class: Class, giver: (ArmId, &[Hold]), receiver: (ArmId, &[Hold])) -> Option<Self> {
        let grasps = |holds: &[Hold]| holds.iter().map(|hold| hold.grasp).collect::<Option<Vec<_>>>();
        Some(Self {
            class,
            giver: giver.0.0,
            receiver: receiver.0.0,
            giver_grasps: grasps(giver.1)?,
            receiver_grasps: grasps(receiver.1)?,
        })
    }
}

/// Answers to questions of reach, bounded in number, shared by threads and runs.
#[derive(Debug, Default)]
pub struct ReachMemory {
    known: Mutex<Known>,
    draws: Draws,
}

#[derive(Debug, Default)]
struct Known {
    /// Digests of the classes, by number.
    classes: Vec<[u8; 32]>,
    rests: BTreeMap<RestQuestion, bool>,
    handoffs: BTreeMap<HandoffQuestion, Option<HandoffWitness>>,
}

impl ReachMemory {
    /// An empty memory.
    pub fn new() -> Self {
        Self::default()
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where arms were found to meet.
    pub(super) fn draws(&self) -> &Draws {
        &self.draws
    }

    /// The number of the class of `object`, by all that matters to reach.
    pub(super) fn class(&self, object: &ObjectModel) -> Class {
        let digest = class_digest(object);
        let mut known = self.known();
        let number = known.classes.iter().position(|other| *other == digest).unwrap_or_else(|| {
            known.classes.push(digest);
            known.classes.len() - 1
        });
        number as Class
    }

    pub(super) fn rest(&self, question: &RestQuestion) -> Option<bool> {
        self.known().rests.get(question).copied()
    }

    pub(super) fn learn_rest(&self, question: RestQuestion, answer: bool) {
        let mut known = self.known();
        if known.rests.len() >= MOST_REACHES {
            known.rests.clear();
        }
        known.rests.insert(question, answer);
    }

    pub(super) fn handoff(&self, question: &HandoffQuestion) -> Option<Option<HandoffWitness>> {
        self.known().handoffs.get(question).cloned()
    }

    pub(super) fn learn_handoff(&self, question: HandoffQuestion, answer: Option<HandoffWitness>) {
        let mut known = self.known();
        if known.handoffs.len() >= MOST_HANDOFFS {
            known.handoffs.clear();
        }
        known.handoffs.insert(question, answer);
    }
}

/// A digest of what makes objects alike to reach.
fn class_digest(object: &ObjectModel) -> [u8; 32] {
    let mut text = format!("{:?} {:?} {:?}", object.shapes, object.approach, object.retreat);
    for grasp in &object.grasps {
        text.push_str(&format!(" {:?} {:?}", bits(&grasp.object_in_tcp), grasp.opening.to_bits()));
    }
    Sha256::digest(text.as_bytes()).into()
}
