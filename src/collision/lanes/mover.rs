//! An arm that takes part in a query, and where its joints are at eight instants.

use std::sync::Arc;

use smallvec::SmallVec;

use super::arm::{LaneArm, LaneAtom, Limb, row, swings};
use super::core::LaneCapsule;
use crate::collision::held::HeldAtoms;
use crate::geometry::Vec3;

/// Joint values and how far they stray, at eight instants.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// By joint the values in the middle of each interval (rad or m).
    pub values: SmallVec<[[f32; 8]; 8]>,
    /// By joint how far it is from there at most within the interval (rad or m).
    pub deviations: SmallVec<[[f32; 8]; 8]>,
}

impl Samples {
    /// Makes room for `joints` joints; what was there is lost.
    pub fn resize(&mut self, joints: usize) {
        if self.values.len() != joints || self.deviations.len() != joints {
            self.values.resize(joints, [0.0; 8]);
            self.deviations.resize(joints, [0.0; 8]);
        }
    }

    /// Sets one joint in one lane (below 8).
    pub fn set(&mut self, joint: usize, lane: usize, value: f32, deviation: f32) {
        self.values[joint][lane] = value;
        self.deviations[joint][lane] = deviation;
    }
}

/// An arm in a query.
pub(in crate::collision) struct LaneMover<'a> {
    pub(in crate::collision) arm: &'a LaneArm,
    pub(in crate::collision) held: Option<Arc<LaneHeld>>,
}

/// A held object.
pub(in crate::collision) struct LaneHeld {
    pub(super) limb: Limb,
    pub(super) atoms: SmallVec<[LaneAtom; 1]>,
}

impl<'a> LaneMover<'a> {
    pub(super) fn limb(&self, index: usize) -> Option<&Limb> {
        self.arm.limbs.get(index).or(self.held.as_ref().map(|held| &held.limb))
    }

    /// One of the arm's atoms or, counted after them, of the held object's.
    pub(super) fn atom(&self, index: u16) -> &LaneAtom {
        let (index, own) = (usize::from(index), &self.arm.atoms);
        match &self.held {
            Some(held) if index >= own.len() => &held.atoms[index - own.len()],
            _ => &own[index],
        }
    }

    /// Number of limbs, the held object's included.
    pub(super) fn limb_count(&self) -> usize {
        self.arm.limbs.len() + usize::from(self.held.is_some())
    }
}

impl LaneHeld {
    /// The held object's lanes on `arm`.
    pub(in crate::collision) fn new(arm: &LaneArm, held: &HeldAtoms) -> Self {
        let (frame, mount) = &arm.mount;
        let body = mount * held.in_mount;
        let levers = row(&held.levers);
        let atoms: SmallVec<[LaneAtom; 1]> =
            held.atoms.iter().map(|atom| LaneAtom::new(atom, &body, *frame, &held.levers)).collect();
        // A ball around all atoms' balls.
        let centres = held.atoms.iter().map(|atom| atom.centre);
        let middle = centres.sum::<Vec3>() / held.atoms.len().max(1) as f64;
        let radius =
            held.atoms.iter().map(|atom| (atom.centre - middle).norm() + atom.radius).fold(0.0, f64::max);
        let centre = body.rotation * middle + body.translation.vector;
        let capsule = LaneCapsule::new(&centre, &centre, radius);
        let first = arm.atoms.len() as u16;
        let indices = (first..first + held.atoms.len() as u16).collect();
        let swings = swings(&levers);
        Self { limb: Limb { capsule, frame: *frame, levers, swings, reach: 0.0, atoms: indices }, atoms }
    }
}
