//! Where objects are and shall go, and where arms start.

use std::collections::BTreeMap;

use super::arm::start_configuration;
use super::context::{Context, Named};
use super::robot::read_joint_values;
use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::wire::fault::FaultCode;
use crate::wire::reader::Node;
use crate::workcell::Arm;

/// Longest name of a problem (bytes).
const MAX_NAME: usize = 1000;

/// A placement as it stands in `initial`.
#[derive(Debug, Clone)]
pub enum Start {
    /// At a pose in the world.
    Pose(Pose),
    /// In the hand of the arm of this place.
    Held(usize, Pose),
}

/// A placement as it stands in `goal`.
#[derive(Debug, Clone)]
pub enum End {
    /// At a pose in the world.
    Pose(Pose),
    /// Anywhere on the surface of this place.
    Surface(usize),
}

/// A placement and its JSON pointer.
#[derive(Debug, Clone)]
pub struct Placed<T> {
    /// The placement.
    pub what: T,
    /// JSON pointer to it.
    pub pointer: String,
}

/// Where an arm starts, and the JSON pointer of its entry in `initial_joints`.
pub type ArmStart = (Config, Option<String>);

/// The entries of a map from object ids, by object.
fn by_object<'a>(node: &Node<'a>, context: &mut Context<'_>) -> Vec<(usize, Node<'a>)> {
    let entries = node.entries(&mut context.faults);
    let mut out = Vec::with_capacity(entries.len());
    for (name, node) in entries {
        match context.named(name) {
            Some(Named::Object(index)) => out.push((index, node)),
            _ => context.unknown(&node.pointer, name, "object", FaultCode::UnknownObject),
        }
    }
    out
}

/// `initial`; `ids` are the objects' ids where they have one.
pub fn read_initial(
    node: Option<Node<'_>>,
    ids: &[Option<&str>],
    context: &mut Context<'_>,
) -> Vec<Option<Placed<Start>>> {
    let mut out = vec![None; ids.len()];
    let Some(node) = node else { return out };
    let mut present = vec![false; ids.len()];
    for (index, node) in by_object(&node, context) {
        if let (Some(slot), Some(present)) = (out.get_mut(index), present.get_mut(index)) {
            *present = true;
            *slot = read_start(&node, context).map(|what| Placed { what, pointer: node.pointer.clone() });
        }
    }
    if node.value.is_object() {
        for id in ids.iter().zip(&present).filter(|(_, present)| !**present).filter_map(|(id, _)| *id) {
            let message = format!("object `{id}` has no initial placement; add one");
            node.fault(&mut context.faults, FaultCode::MissingField, message);
        }
    }
    out
}

fn read_start(node: &Node<'_>, context: &mut Context<'_>) -> Option<Start> {
    let mut fields = node.fields(&mut context.faults)?;
    let pose = fields.optional("pose");
    let arm = fields.optional("held_by");
    let in_tcp = fields.optional("object_in_tcp");
    fields.finish(&mut context.faults);
    match (pose, arm, in_tcp) {
        (Some(pose), None, None) => pose.pose(&mut context.faults).map(Start::Pose),
        (None, Some(arm), Some(in_tcp)) => {
            let pose = in_tcp.pose(&mut context.faults);
            let text = arm.string(&mut context.faults)?;
            match context.named(text) {
                Some(Named::Arm(index)) => Some(Start::Held(index, pose?)),
                _ => {
                    context.unknown(&arm.pointer, text, "arm", FaultCode::UnknownBody);
                    None
                }
            }
        }
        (Some(_), _, _) => {
            let message = "`pose` excludes `held_by` and `object_in_tcp`; give one or the other";
            node.fault(&mut context.faults, FaultCode::OutOfRange, message);
            None
        }
        _ => {
            let message = "give `pose`, or both `held_by` and `object_in_tcp`";
            node.fault(&mut context.faults, FaultCode::MissingField, message);
            None
        }
    }
}

/// `goal`, by object; `None` for objects without a goal.
pub fn read_goal(
    node: Option<Node<'_>>,
    objects: usize,
    context: &mut Context<'_>,
) -> Vec<Option<Placed<End>>> {
    let mut out = vec![None; objects];
    let Some(node) = node else { return out };
    for (index, node) in by_object(&node, context) {
        if let Some(slot) = out.get_mut(index) {
            *slot = read_end(&node, context).map(|what| Placed { what, pointer: node.pointer.clone() });
        }
    }
    out
}

fn read_end(node: &Node<'_>, context: &mut Context<'_>) -> Option<End> {
    let mut fields = node.fields(&mut context.faults)?;
    let pose = fields.optional("pose");
    let surface = fields.optional("surface");
    fields.finish(&mut context.faults);
    match (pose, surface) {
        (Some(pose), None) => pose.pose(&mut context.faults).map(End::Pose),
        (None, Some(surface)) => {
            let text = surface.string(&mut context.faults)?;
            match context.named(text) {
                Some(Named::Surface(index)) => Some(End::Surface(index)),
                _ => {
                    context.unknown(&surface.pointer, text, "surface", FaultCode::UnknownSurface);
                    None
                }
            }
        }
        (Some(_), Some(surface)) => {
            let message = "`pose` and `surface` exclude each other; give one of them";
            surface.fault(&mut context.faults, FaultCode::OutOfRange, message);
            None
        }
        (None, None) => {
            let message = "give `pose` or `surface`, or leave the object out of `goal`";
            node.fault(&mut context.faults, FaultCode::MissingField, message);
            None
        }
    }
}

/// `initial_joints`, by arm: `None` where an arm's are at fault; an arm that is left out starts at
/// home. The pointers are those of the entries.
pub fn read_initial_joints(
    node: Option<Node<'_>>,
    arms: &[Option<Arm>],
    context: &mut Context<'_>,
) -> Vec<Option<ArmStart>> {
    let mut out: Vec<_> = arms.iter().map(|arm| arm.as_ref().map(|arm| (arm.home.clone(), None))).collect();
    let Some(node) = node else { return out };
    for (name, node) in node.entries(&mut context.faults) {
        let Some(Named::Arm(index)) = context.named(name) else {
            context.unknown(&node.pointer, name, "arm", FaultCode::UnknownBody);
            continue;
        };
        let values: BTreeMap<_, _> = read_joint_values(&node, context);
        let Some(Some(arm)) = arms.get(index) else { continue };
        let config = start_configuration(arm, &values, context);
        if let Some(slot) = out.get_mut(index) {
            *slot = config.map(|config| (config, Some(node.pointer.clone())));
        }
    }
    out
}

/// The document's name; empty when there is none.
pub fn read_name(node: Option<Node<'_>>, context: &mut Context<'_>) -> String {
    let Some(node) = node else { return String::new() };
    let text = node.string(&mut context.faults).unwrap_or_default();
    if text.len() > MAX_NAME {
        let message = format!("{} bytes, at most {MAX_NAME} are taken; shorten it", text.len());
        node.fault(&mut context.faults, FaultCode::TooLarge, message);
    }
    text.to_owned()
}
