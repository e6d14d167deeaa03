//! Robots that were read before, for all documents of the process: what is made of a URDF without meshes depends on its
//! text, and to parse it takes longer than everything else in a document.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::kinematics::{ArmModel, JointLimits, UrdfWarning};
use crate::workcell::contacts::GroupPair;

/// Models that are kept at most; beyond it all are forgotten.
const MOST_MODELS: usize = 32;

/// Longest URDF (bytes) that is kept.
const LONGEST_URDF: usize = 200_000;

/// Answers about overlapping groups that are kept at most.
const MOST_OVERLAPPING: usize = 128;

/// All that decides a model without meshes.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelKey {
    /// The robot's name in the document.
    pub name: String,
    /// Its URDF.
    pub urdf: String,
    /// The mount link.
    pub mount: String,
    /// Joints that are held, and where.
    pub held: BTreeMap<String, f64>,
}

/// All that decides which pairs of rigid groups overlap almost always.
#[derive(Debug, Clone)]
pub struct OverlapKey {
    /// The model, told apart by its place in memory.
    pub model: Arc<ArmModel>,
    /// The tool's shapes, as numbers.
    pub tool: Vec<u64>,
    /// Limits of the chain's joints.
    pub limits: Vec<JointLimits>,
    /// Pairs that are exempt already.
    pub exempt: Vec<GroupPair>,
}

impl PartialEq for OverlapKey {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.model, &other.model)
            && self.tool == other.tool
            && self.limits == other.limits
            && self.exempt == other.exempt
    }
}

/// A model with what is to be said of it.
pub type Model = (Arc<ArmModel>, Vec<UrdfWarning>);

#[derive(Debug)]
struct Known {
    models: Vec<(ModelKey, Model)>,
    overlapping: Vec<(OverlapKey, Vec<GroupPair>)>,
}

static KNOWN: Mutex<Known> = Mutex::new(Known { models: Vec::new(), overlapping: Vec::new() });

fn known() -> MutexGuard<'static, Known> {
    KNOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The model that was kept for `key`.
pub fn model(key: &ModelKey) -> Option<Model> {
    known().models.iter().find(|(known, _)| known == key).map(|(_, model)| model.clone())
}

/// Keeps a model that no mesh went into.
pub fn keep_model(key: ModelKey, model: &Model) {
    if key.urdf.len() > LONGEST_URDF {
        return;
    }
    let mut known = known();
    if known.models.len() >= MOST_MODELS {
        known.models.clear();
        known.overlapping.clear();
    }
    known.models.push((key, model.clone()));
}

/// The pairs that overlap almost always, by `find` where nobody asked before.
pub fn overlapping(key: OverlapKey, find: impl FnOnce() -> Vec<GroupPair>) -> Vec<GroupPair> {
    if let Some((_, pairs)) = known().overlapping.iter().find(|(known, _)| *known == key) {
        return pairs.clone();
    }
    let pairs = find();
    let mut known = known();
    if known.overlapping.len() >= MOST_OVERLAPPING {
        known.overlapping.clear();
    }
    known.overlapping.push((key, pairs.clone()));
    pairs
}
