//! Objects and their grasps.

use std::collections::{BTreeMap, BTreeSet};

use super::context::{Context, Named};
use super::shape::{pose_bits, read_shape, shape_bits};
use crate::geometry::{PlacedShape, Pose};
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Node, Range, shown};
use crate::workcell::{Grasp, GraspGenerator, ObjectModel, Symmetry, symmetry_rotations};

/// Greatest length of an approach or retreat (m).
const MAX_STROKE: f64 = 1.0;

/// `objects`, one entry per element; `max_opening` is that of the widest gripper.
pub fn read_objects(
    node: Option<Node<'_>>,
    max_opening: f64,
    context: &mut Context<'_>,
) -> Vec<Option<ObjectModel>> {
    let Some(node) = node else { return Vec::new() };
    let elements = context.named_elements(&node, "objects", context.limits.max_objects);
    let mut objects: Vec<_> = elements
        .iter()
        .enumerate()
        .map(|(index, node)| read_object(index, node, max_opening, context))
        .collect();
    number_classes(&mut objects);
    objects
}

fn read_object(
    index: usize,
    node: &Node<'_>,
    max_opening: f64,
    context: &mut Context<'_>,
) -> Option<ObjectModel> {
    let mut fields = node.fields(&mut context.faults)?;
    let id = fields.required("id", &mut context.faults);
    let id = context.register(id, Named::Object(index));
    let shape = fields
        .required("shape", &mut context.faults)
        .and_then(|node| read_shape(&node, Pose::identity(), context));
    let faults = &mut context.faults;
    let mut figure = |key, range, default| match fields.optional(key) {
        Some(node) => node.number(faults, range).unwrap_or(default),
        None => default,
    };
    let mass = figure("mass", Range::NonNegative(1.0e4), 0.2);
    let approach = figure("approach", Range::NonNegative(MAX_STROKE), 0.08);
    let retreat = figure("retreat", Range::NonNegative(MAX_STROKE), 0.08);
    let symmetry_node = fields.optional("symmetry");
    let symmetry = match &symmetry_node {
        Some(node) => {
            let choices = [
                ("none", Symmetry::None),
                ("box", Symmetry::Box),
                ("cylinder_z", Symmetry::CylinderZ),
                ("sphere", Symmetry::Sphere),
            ];
            node.choice(faults, &choices).unwrap_or(Symmetry::None)
        }
        None => Symmetry::None,
    };
    let shapes: Vec<PlacedShape> = shape.into_iter().flatten().collect();
    let grasps = match fields.optional("grasps") {
        Some(node) => read_grasps(&node, &shapes, max_opening, context),
        None => {
            let mut grasps = Vec::new();
            for generator in GraspGenerator::defaults(&shapes) {
                grasps.extend(generator.expand(&shapes, max_opening).unwrap_or_default());
            }
            grasps
        }
    };
    fields.finish(&mut context.faults);
    if shapes.is_empty() {
        return None;
    }
    if grasps.is_empty() {
        let message = "no gripper of this workcell has a grasp for this object; it stays where it is";
        context.faults.warn(node.pointer.clone(), FaultCode::OutOfRange, message);
    }
    let symmetry_rotations = match symmetry_rotations(symmetry, &shapes) {
        Ok(rotations) => rotations,
        Err(error) => {
            let pointer = symmetry_node.unwrap_or_else(|| node.clone()).pointer;
            let message = format!("{error}; until then the object has to be turned as its goal says");
            context.faults.warn(pointer, FaultCode::OutOfRange, message);
            vec![nalgebra::UnitQuaternion::identity()]
        }
    };
    Some(ObjectModel {
        id: id?,
        shapes,
        mass,
        symmetry,
        symmetry_rotations,
        grasps,
        approach,
        retreat,
        class: 0,
    })
}

/// The grasps at `node`, generators expanded.
fn read_grasps(
    node: &Node<'_>,
    shapes: &[PlacedShape],
    max_opening: f64,
    context: &mut Context<'_>,
) -> Vec<Grasp> {
    let most = context.limits.max_grasps;
    let entries = if node.value.is_object() {
        vec![node.clone()]
    } else {
        node.elements(&mut context.faults, "grasps", most)
    };
    let mut grasps: Vec<Grasp> = Vec::new();
    let mut ids = BTreeSet::new();
    for entry in entries {
        let Some(mut fields) = entry.fields(&mut context.faults) else { continue };
        if let Some(kind) = fields.optional("generator") {
            let Some(name) = kind.string(&mut context.faults) else { continue };
            let depth = fields
                .optional("depth")
                .and_then(|node| node.number(&mut context.faults, Range::Positive(1.0)));
            let mut yaw_steps = || match fields.optional("yaw_steps") {
                Some(node) => node.whole(&mut context.faults, 1, 360).map_or(8, |steps| steps as usize),
                None => 8,
            };
            let generator = match name {
                "box_faces" => GraspGenerator::BoxFaces { depth },
                "box_edges" => GraspGenerator::BoxEdges { depth },
                "top" => GraspGenerator::Top { depth, yaw_steps: yaw_steps() },
                "cylinder_side" => GraspGenerator::CylinderSide { depth, yaw_steps: yaw_steps() },
                _ => {
                    let choices = ["box_faces", "box_edges", "top", "cylinder_side"].map(|name| (name, ()));
                    kind.choice(&mut context.faults, &choices);
                    continue;
                }
            };
            fields.finish(&mut context.faults);
            // Without a shape there is nothing to expand on, and its fault is noted.
            if shapes.is_empty() {
                continue;
            }
            match generator.expand(shapes, max_opening) {
                Ok(made) => {
                    for mut grasp in made {
                        let plain = grasp.id.clone();
                        let mut copy = 1;
                        while !ids.insert(grasp.id.clone()) {
                            copy += 1;
                            grasp.id = format!("{plain}#{copy}");
                        }
                        grasps.push(grasp);
                    }
                }
                Err(error) => kind.fault(&mut context.faults, FaultCode::WrongType, error.to_string()),
            }
        } else {
            let id = fields.required("id", &mut context.faults);
            let id = id.and_then(|node| node.id(&mut context.faults).map(|text| (node, text)));
            let pose = fields
                .required("object_in_tcp", &mut context.faults)
                .and_then(|node| node.pose(&mut context.faults));
            fields.finish(&mut context.faults);
            if let Some((node, text)) = id {
                if !ids.insert(text.to_owned()) {
                    let message = format!("this object has a grasp `{}` already", shown(text));
                    node.fault(&mut context.faults, FaultCode::DuplicateId, message);
                } else if let Some(object_in_tcp) = pose {
                    grasps.push(Grasp { id: text.to_owned(), object_in_tcp, opening: 0.0 });
                }
            }
        }
        if grasps.len() > most {
            let message = format!("more than {most} grasps; give fewer or smaller `yaw_steps`");
            node.fault(&mut context.faults, FaultCode::TooLarge, message);
            return Vec::new();
        }
    }
    grasps
}

/// Gives equal objects equal classes, numbered by first appearance.
fn number_classes(objects: &mut [Option<ObjectModel>]) {
    let mut classes: BTreeMap<Vec<u64>, usize> = BTreeMap::new();
    for object in objects.iter_mut().flatten() {
        let next = classes.len();
        object.class = *classes.entry(class_key(object)).or_insert(next);
    }
}

/// Everything that decides the class, as bits.
fn class_key(object: &ObjectModel) -> Vec<u64> {
    let mut key = vec![object.symmetry as u64, object.approach.to_bits(), object.retreat.to_bits()];
    key.extend(shape_bits(&object.shapes));
    for grasp in &object.grasps {
        key.extend(pose_bits(&grasp.object_in_tcp));
    }
    key
}
