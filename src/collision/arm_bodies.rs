//! An arm's atoms, compiled: where they hang, how far each joint can move them, and which of them
//! are checked against each other.

use smallvec::SmallVec;

use crate::geometry::{Pose, Vec3};
use crate::kinematics::{Lever, LinkMotion};
use crate::workcell::{Arm, ArmBody};

use super::atom::Atom;
#[cfg(test)]
use super::atom::PlacedAtom;

/// Lever arms of a body by joint: the most (m per rad, or 1 for a slide) that a point of it moves
/// per unit of the joint; `None` where the joint does not move it.
pub(super) type Levers = SmallVec<[Option<f64>; 8]>;

/// An atom on a link.
#[derive(Debug, Clone)]
pub(super) struct ArmAtom {
    pub(super) atom: Atom,
    /// The link in whose frame the atom is given.
    pub(super) link: usize,
    /// The link, or the tool on it.
    pub(super) body: ArmBody,
    pub(super) is_hand: bool,
    pub(super) levers: Levers,
}

/// The compiled bodies of one arm.
#[derive(Debug, Clone)]
pub struct ArmBodies {
    pub(super) atoms: Vec<ArmAtom>,
    /// Pairs of atoms that are checked against each other.
    pub(super) self_pairs: Vec<(usize, usize)>,
    /// Lever arms of a point at the mount link's origin.
    mount_levers: SmallVec<[Option<Lever>; 8]>,
    /// Origin of the first joint in the world and the radius (m) of the ball around it that the
    /// moving atoms never leave.
    pub(super) reach_centre: Vec3,
    pub(super) reach_radius: f64,
    /// The radius by which a ball around the mount's origin grows the reach.
    mount_reach: f64,
}

impl ArmBodies {
    /// Compiles `arm`.
    pub(super) fn new(arm: &Arm) -> Self {
        let model = &arm.model;
        let mut atoms = Vec::new();
        for (body, link, shapes) in arm.bodies() {
            let is_hand = arm.hand_groups.contains(&arm.group_of(body));
            for placed in shapes {
                let atom = Atom::new(placed);
                let levers = levers(arm, link, atom.reach());
                atoms.push(ArmAtom { atom, link, body, is_hand, levers });
            }
        }
        let mut self_pairs = Vec::new();
        for i in 0..atoms.len() {
            for j in i + 1..atoms.len() {
                if arm.checks_bodies(atoms[i].body, atoms[j].body) {
                    self_pairs.push((i, j));
                }
            }
        }
        let mut poses = Vec::new();
        model.link_poses(&vec![0.0; model.dof()], &mut poses);
        let first = model.joints.first().map_or(0, |joint| joint.link);
        let reach_centre = (arm.base * poses[first]).translation.vector;
        let placed: Vec<Pose> = poses.iter().map(|pose| arm.base * *pose).collect();
        let reach_of = |link: usize, radius: f64| link_reach(arm, link, radius, &placed, &reach_centre);
        let reach_radius =
            atoms.iter().map(|atom| reach_of(atom.link, atom.atom.reach())).fold(0.0, f64::max);
        let mount_reach = reach_of(model.mount, 0.0);
        Self {
            atoms,
            self_pairs,
            mount_levers: link_levers(arm, model.mount),
            reach_centre,
            reach_radius,
            mount_reach,
        }
    }

    /// The same bodies on an arm that differs in its base alone.
    pub(super) fn moved_to(&self, arm: &Arm) -> Self {
        let mut poses = Vec::new();
        arm.model.link_poses(&vec![0.0; arm.model.dof()], &mut poses);
        let first = arm.model.joints.first().map_or(0, |joint| joint.link);
        Self { reach_centre: (arm.base * poses[first]).translation.vector, ..self.clone() }
    }

    /// Places all atoms with the links at `links` (world frame).
    #[cfg(test)]
    pub(super) fn place(&self, links: &[Pose], out: &mut Vec<PlacedAtom>) {
        out.resize_with(self.atoms.len(), PlacedAtom::nowhere);
        for (atom, placed) in self.atoms.iter().zip(out.iter_mut()) {
            atom.atom.place(&links[atom.link], placed);
        }
    }

    /// Lever arms of a body on the mount link within `radius` of its origin.
    pub(super) fn held_levers(&self, radius: f64) -> Levers {
        self.mount_levers.iter().map(|lever| lever.as_ref().map(|lever| lever.at(radius))).collect()
    }

    /// The reach radius with a held body within `radius` of the mount's origin.
    pub(super) fn reach_with(&self, radius: f64) -> f64 {
        self.reach_radius.max(self.mount_reach + radius)
    }
}

/// Radius (m) of a ball around the first joint's origin `centre` that no point within `radius` of the
/// origin of `link` ever leaves; `links` are the links in place at zero.
pub(super) fn link_reach(arm: &Arm, link: usize, radius: f64, links: &[Pose], centre: &Vec3) -> f64 {
    let model = &arm.model;
    match model.lever(&arm.limits, 0, link) {
        Some(_) => {
            model.origin_distance(&arm.limits, 0, link).unwrap_or(f64::INFINITY) + slide_extent(arm) + radius
        }
        // The first joint does not move it: either nothing does, or a joint of another branch.
        None if (0..model.dof()).all(|joint| model.lever(&arm.limits, joint, link).is_none()) => {
            (links[link].translation.vector - centre).norm() + radius
        }
        None => f64::INFINITY,
    }
}

/// How far a first prismatic joint can carry everything from its zero position (m).
fn slide_extent(arm: &Arm) -> f64 {
    let slides = |link: usize| matches!(arm.model.links[link].motion, LinkMotion::Prismatic { .. });
    match (arm.model.joints.first(), arm.limits.first()) {
        (Some(joint), Some(limits)) if slides(joint.link) => limits.lower.abs().max(limits.upper.abs()),
        _ => 0.0,
    }
}

/// By joint, how far it moves points of `link`.
fn link_levers(arm: &Arm, link: usize) -> SmallVec<[Option<Lever>; 8]> {
    (0..arm.model.dof()).map(|joint| arm.model.lever(&arm.limits, joint, link)).collect()
}

/// Lever arms of a body within `radius` of `link`'s origin.
fn levers(arm: &Arm, link: usize, radius: f64) -> Levers {
    link_levers(arm, link).iter().map(|lever| lever.as_ref().map(|lever| lever.at(radius))).collect()
}
