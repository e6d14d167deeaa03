//! Robots that were read before: what is made of a URDF without meshes depends on its text, and to load a robot takes about
//! half the time that a document does.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::kinematics::{ArmModel, JointLimits, UrdfWarning};
use crate::workcell::BodyPair;
use crate::workcell::contacts::{Overlaps, TooMuchWork};

/// Models that are kept at most; beyond it all are forgotten.
const MOST_MODELS: usize = 32;

/// Longest URDF (bytes) that is kept.
const LONGEST_URDF: usize = 200_000;

/// Answers about overlapping bodies that are kept at most.
const MOST_OVERLAPPING: usize = 128;

/// All that decides a model without meshes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RobotKey {
    /// The robot's name in the document.
    pub name: String,
    /// Its URDF.
    pub urdf: String,
    /// The mount link.
    pub mount: String,
    /// Joints that are held, and where.
    pub held: BTreeMap<String, f64>,
}

/// All that decides which pairs of bodies overlap almost always.
#[derive(Debug, Clone)]
pub(super) struct OverlapKey {
    /// The model, told apart by its place in memory.
    pub model: Arc<ArmModel>,
    /// The tool's shapes, as numbers.
    pub tool: Vec<u64>,
    /// Limits of the chain's joints.
    pub limits: Vec<JointLimits>,
    /// Pairs that are exempt already.
    pub exempt: Vec<BodyPair>,
}

impl PartialEq for OverlapKey {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.model, &other.model)
            && self.tool == other.tool
            && self.limits == other.limits
            && self.exempt == other.exempt
    }
}

/// Which pairs overlap almost always, if that can be found out.
pub(super) type Answer = Result<Overlaps, TooMuchWork>;

/// A model with what is to be said of it.
pub(super) type Model = (Arc<ArmModel>, Vec<UrdfWarning>);

/// Models of robots without meshes, and which of their bodies overlap almost always; bounded in number, shared by
/// threads. A document means the same whether its robots are known.
#[derive(Debug, Default)]
pub struct KnownRobots(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    models: Vec<(RobotKey, Model)>,
    overlapping: Vec<(OverlapKey, Answer)>,
}

impl KnownRobots {
    /// None known.
    pub fn new() -> Self {
        Self::default()
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The model that was kept for `key`.
    pub(super) fn model(&self, key: &RobotKey) -> Option<Model> {
        self.known().models.iter().find(|(known, _)| known == key).map(|(_, model)| model.clone())
    }

    /// Whether `model` is one of those kept: another has its like in no other document.
    pub(super) fn keeps(&self, model: &Arc<ArmModel>) -> bool {
        self.known().models.iter().any(|(_, (known, _))| Arc::ptr_eq(known, model))
    }

    /// Keeps a model that no mesh went into; the one for `key`, be it this or what another was quicker to keep.
    pub(super) fn keep_model(&self, key: RobotKey, model: Model) -> Model {
        if key.urdf.len() > LONGEST_URDF {
            return model;
        }
        let mut known = self.known();
        if let Some((_, first)) = known.models.iter().find(|(known, _)| *known == key) {
            return first.clone();
        }
        if known.models.len() >= MOST_MODELS {
            known.models.clear();
            known.overlapping.clear();
        }
        known.models.push((key, model.clone()));
        model
    }

    /// The pairs that overlap almost always, by `find` where nobody asked before.
    pub(super) fn overlapping(&self, key: OverlapKey, find: impl FnOnce() -> Answer) -> Answer {
        if let Some((_, answer)) = self.known().overlapping.iter().find(|(known, _)| *known == key) {
            return answer.clone();
        }
        let answer = find();
        let mut known = self.known();
        if known.overlapping.len() >= MOST_OVERLAPPING {
            known.overlapping.clear();
        }
        known.overlapping.push((key, answer.clone()));
        answer
    }
}
