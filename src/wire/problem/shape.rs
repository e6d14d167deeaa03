//! Shapes.

use super::context::Context;
use super::meshes::code_of;
use crate::geometry::{PlacedShape, Pose, Shape, Vec3};
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Fields, Node, Range};
use crate::wire::resources::resolve_uri;

/// Greatest extent of a shape (m).
const MAX_EXTENT: f64 = 1000.0;

/// Most convex pieces that meshes of tools, obstacles and objects may have on top of one each: all of them may have to be compared
/// with each other.
const MOST_PIECES_BESIDE: usize = 4096;

/// A shape in the frame of what it belongs to, at `pose` there; several where it is a mesh of several convex pieces, never none.
pub fn read_shape(node: &Node<'_>, pose: Pose, context: &mut Context<'_>) -> Option<Vec<PlacedShape>> {
    let mut fields = node.fields(&mut context.faults)?;
    let kind = fields.required("type", &mut context.faults)?;
    let name = kind.string(&mut context.faults)?;
    let size = Range::Positive(MAX_EXTENT);
    let shape = match name {
        "box" => required(&mut fields, "size", context)
            .and_then(|node| node.vector(&mut context.faults, size))
            .map(|size| Shape::Box { half_extents: size / 2.0 }),
        "sphere" => number(&mut fields, "radius", size, context).map(|radius| Shape::Sphere { radius }),
        "cylinder" => {
            let radius = number(&mut fields, "radius", size, context);
            let length = number(&mut fields, "length", size, context);
            radius.zip(length).map(|(radius, length)| Shape::Cylinder { radius, half_length: length / 2.0 })
        }
        "capsule" => {
            let radius = number(&mut fields, "radius", size, context);
            let length = number(&mut fields, "length", Range::NonNegative(MAX_EXTENT), context);
            radius.zip(length).map(|(radius, length)| Shape::Capsule { radius, half_length: length / 2.0 })
        }
        "convex" => convex(&mut fields, context),
        "mesh" => {
            let pieces = mesh(&mut fields, context);
            fields.finish(&mut context.faults);
            return pieces
                .map(|pieces| pieces.into_iter().map(|shape| PlacedShape { shape, pose }).collect());
        }
        _ => {
            let choices = ["box", "sphere", "cylinder", "capsule", "convex", "mesh"].map(|name| (name, ()));
            kind.choice(&mut context.faults, &choices);
            return None;
        }
    };
    fields.finish(&mut context.faults);
    shape.map(|shape| vec![PlacedShape { shape, pose }])
}

fn required<'a>(fields: &mut Fields<'a>, key: &'static str, context: &mut Context<'_>) -> Option<Node<'a>> {
    fields.required(key, &mut context.faults)
}

fn number(
    fields: &mut Fields<'_>,
    key: &'static str,
    range: Range,
    context: &mut Context<'_>,
) -> Option<f64> {
    required(fields, key, context).and_then(|node| node.number(&mut context.faults, range))
}

fn convex(fields: &mut Fields<'_>, context: &mut Context<'_>) -> Option<Shape> {
    let node = required(fields, "points", context)?;
    let before = context.faults.count();
    let elements = node.elements(&mut context.faults, "points", context.limits.max_points);
    let points: Vec<Vec3> = elements
        .iter()
        .filter_map(|node| node.vector(&mut context.faults, Range::Within(MAX_EXTENT)))
        .collect();
    if context.faults.count() > before {
        return None;
    }
    context.hull(&node, &points, FaultCode::OutOfRange).map(Shape::Convex)
}

fn mesh(fields: &mut Fields<'_>, context: &mut Context<'_>) -> Option<Vec<Shape>> {
    let node = required(fields, "uri", context)?;
    let scale = match fields.optional("scale") {
        Some(node) => {
            let scale = node.vector(&mut context.faults, Range::Within(MAX_EXTENT))?;
            if scale.iter().any(|factor| *factor == 0.0) {
                node.fault(&mut context.faults, FaultCode::OutOfRange, "a scale of 0 flattens the mesh");
                return None;
            }
            scale
        }
        None => Vec3::repeat(1.0),
    };
    let uri = node.string(&mut context.faults)?;
    let path = resolve_uri(uri, "", &[]);
    let mesh = match path.and_then(|path| context.meshes.get(&path, &scale)) {
        Ok(mesh) => mesh,
        Err(error) => {
            context.unread(&node, &error);
            return None;
        }
    };
    context.contents.insert(node.pointer.clone(), mesh.digest);
    let pieces = match mesh.pieces {
        Ok(pieces) => pieces,
        Err(error) => {
            node.fault(&mut context.faults, code_of(&error), error.to_string());
            return None;
        }
    };
    let corners: usize = pieces.hulls.iter().map(|hull| hull.vertices().len()).sum();
    if corners > context.limits.max_points {
        let message = format!(
            "the mesh's convex pieces have {corners} corners, at most {} are taken; simplify the mesh",
            context.limits.max_points
        );
        node.fault(&mut context.faults, FaultCode::TooLarge, message);
        return None;
    }
    context.pieces += pieces.hulls.len() - 1;
    if context.pieces > MOST_PIECES_BESIDE {
        let message = format!(
            "the meshes of tools, obstacles and objects up to this one have more than {MOST_PIECES_BESIDE} convex \
             pieces; use coarser decompositions"
        );
        node.fault(&mut context.faults, FaultCode::TooLarge, message);
        return None;
    }
    if let Some(filled) = pieces.filled {
        context.faults.warn(node.pointer, FaultCode::BadMesh, format!("the mesh {filled}"));
    }
    Some(pieces.hulls.into_iter().map(Shape::Convex).collect())
}

/// Everything that tells lists of shapes from each other, as bits.
pub fn shape_bits(shapes: &[PlacedShape]) -> Vec<u64> {
    let mut bits = Vec::new();
    for placed in shapes {
        match &placed.shape {
            Shape::Box { half_extents } => {
                bits.push(0);
                bits.extend(half_extents.iter().map(|v| v.to_bits()));
            }
            Shape::Sphere { radius } => bits.extend([1, radius.to_bits()]),
            Shape::Cylinder { radius, half_length } => {
                bits.extend([2, radius.to_bits(), half_length.to_bits()]);
            }
            Shape::Capsule { radius, half_length } => {
                bits.extend([3, radius.to_bits(), half_length.to_bits()]);
            }
            Shape::Convex(hull) => {
                bits.extend([4, hull.vertices().len() as u64]);
                bits.extend(hull.vertices().iter().flat_map(|v| [v.x, v.y, v.z]).map(f64::to_bits));
            }
        }
        bits.extend(pose_bits(&placed.pose));
    }
    bits
}

/// A pose as bits.
pub fn pose_bits(pose: &Pose) -> [u64; 7] {
    let (t, r) = (&pose.translation.vector, &pose.rotation.coords);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(f64::to_bits)
}
