//! The graph that bounds: nothing is left out without proof.

use crate::geometry::{Pose, Shape};
use crate::problem::Problem;
use crate::workcell::{ArmId, SurfaceId};

use super::build::{arm_nodes, classes, edge, given_capacities, mode_object, nodes_on};
use super::graph::{GraphKind, ModeGraph, ModeNode, NodeConflict, Place};
use super::proof::Proof;
use super::slots::{Slots, symmetric_poses};

/// Overlaps that surely break a rule are deeper than this (m): FORMAT allows 2 mm of contact and
/// small tolerances of poses.
const SURE_OVERLAP: f64 = 6.0e-3;
/// How far (m) an object's contact may lie outside a surface's rectangle, and two objects overlap.
const CONTACT_PLAY: f64 = 2.0e-3;

/// Builds the optimistic graph of `problem`: every plan that exists is a walk on it. A plan maps to
/// it so: an object that never moved is on its start slot, one at its goal pose on its goal slot,
/// any other at rest on its surface's node.
///
/// An edge is missing only where distances exceed the greatest reach; a surface holds what its
/// area can hold, where that can be said; two slots exclude each other only if the objects there
/// would surely overlap.
pub fn optimistic_mode_graph(problem: &Problem) -> ModeGraph {
    let proof = Proof::new(problem);
    let slots = Slots::new(problem);
    let classes = classes(problem);
    let arms = problem.workcell.arms.len();
    let mut nodes = arm_nodes(problem);
    let mut edges = Vec::new();
    let mut slot_node = Vec::new();
    for slot in &slots.slots {
        let node = nodes.len();
        slot_node.push(Some(node));
        nodes.push(ModeNode {
            place: Place::Slot(slot.clone()),
            capacity: 1,
            centre: slot.pose.translation.vector,
        });
        let poses = goal_poses(problem, slot.goal_of, &slot.pose);
        for arm in (0..arms).filter(|&arm| proof.may_hold(ArmId(arm), slot.class, &poses)) {
            edges.push(edge(&nodes, node, arm, slot.class, None));
            edges.push(edge(&nodes, arm, node, slot.class, None));
        }
    }
    for (index, surface) in problem.workcell.surfaces.iter().enumerate() {
        let node = nodes.len();
        nodes.push(ModeNode {
            place: Place::Surface(SurfaceId(index)),
            capacity: problem.objects.len(),
            centre: surface.pose.translation.vector,
        });
        for &class in &classes {
            for arm in (0..arms).filter(|&arm| proof.may_reach_surface(ArmId(arm), class, SurfaceId(index))) {
                edges.push(edge(&nodes, node, arm, class, None));
                edges.push(edge(&nodes, arm, node, class, None));
            }
        }
    }
    for &class in &classes {
        for a in 0..arms {
            for b in (0..arms).filter(|&b| b != a && proof.may_meet(ArmId(a), ArmId(b), class)) {
                edges.push(edge(&nodes, a, b, class, None));
            }
        }
    }
    edges.sort_by_key(|edge| (edge.from, edge.to, edge.class));
    let mut conflicts: Vec<NodeConflict> = slots
        .overlaps(problem, -SURE_OVERLAP, true)
        .into_iter()
        .filter_map(|(a, b)| Some(NodeConflict { nodes: vec![slot_node[a]?, slot_node[b]?], capacity: 1 }))
        .collect();
    conflicts.extend(area_capacities(problem, &nodes));
    conflicts.extend(given_capacities(problem, &nodes));
    let objects = (0..problem.objects.len())
        .map(|index| mode_object(problem, &slots, &slot_node, &nodes, index))
        .collect::<Option<Vec<_>>>();
    let objects = objects.unwrap_or_default();
    ModeGraph {
        kind: GraphKind::Optimistic,
        nodes,
        edges,
        conflicts,
        objects,
        barred: Vec::new(),
        crowdings: Vec::new(),
        blockages: Vec::new(),
        complete: true,
    }
}

fn goal_poses(problem: &Problem, goal_of: Option<crate::workcell::ObjectId>, pose: &Pose) -> Vec<Pose> {
    match goal_of {
        Some(object) => symmetric_poses(&problem.objects[object.0], pose),
        None => vec![*pose],
    }
}

/// Surfaces that surely cannot hold all objects: their area over the smallest face of any object.
/// Only for problems whose objects are all boxes; round objects may touch a surface in a point.
fn area_capacities(problem: &Problem, nodes: &[ModeNode]) -> Vec<NodeConflict> {
    let smallest_face = |shapes: &[crate::geometry::PlacedShape]| match shapes {
        [placed] => match &placed.shape {
            Shape::Box { half_extents: h } => {
                let side = |half: f64| (2.0 * half - CONTACT_PLAY).max(0.0);
                let faces = [side(h.x) * side(h.y), side(h.y) * side(h.z), side(h.z) * side(h.x)];
                Some(faces.into_iter().fold(f64::INFINITY, f64::min))
            }
            _ => None,
        },
        _ => None,
    };
    let faces: Option<Vec<f64>> =
        problem.objects.iter().map(|object| smallest_face(&object.shapes)).collect();
    let Some(least) = faces.and_then(|faces| faces.into_iter().reduce(f64::min)) else { return Vec::new() };
    if least <= 0.0 || !problem.allowed_object_contacts.is_empty() {
        return Vec::new();
    }
    let surfaces = problem.workcell.surfaces.iter().enumerate();
    surfaces
        .filter_map(|(index, surface)| {
            let [x, y] = surface.half_extents.map(|half| 2.0 * half + 2.0 * CONTACT_PLAY);
            let fit = (x * y / least + 1e-9).floor();
            let capacity = if fit < problem.objects.len() as f64 { fit as usize } else { return None };
            Some(NodeConflict { nodes: nodes_on(nodes, SurfaceId(index)), capacity })
        })
        .collect()
}
