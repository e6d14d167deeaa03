//! A second reading of the same text by `urdf-rs`, the field's reader: an arm that two readers see
//! differently is not moved.
//!
//! It is handed only what has passed the checks of [`super::document`], without the parts that no
//! arm model is made of, and never resolves a URI.

use nalgebra::UnitQuaternion;
use roxmltree::Node;
use urdf_rs::{Geometry, JointType};

use super::document::{GeometryElement, JointElement, JointKind, LinkElement, RobotElement, cut};
use super::error::{UrdfError, UrdfWarning};
use crate::geometry::Pose;
use crate::kinematics::xml::parse_xml;

/// Greatest difference of two numbers that are read from the same text.
const SAME: f64 = 1e-9;

/// Elements that no arm model is made of.
const PASSED_OVER: [&str; 7] =
    ["visual", "inertial", "material", "transmission", "gazebo", "dynamics", "safety_controller"];

/// Compares `robot`, read from `text`, with what `urdf-rs` reads there. A text that it does not read
/// at all (it asks for more than is needed here) is worth a warning.
pub(super) fn compare(text: &str, robot: &RobotElement) -> Result<Option<UrdfWarning>, UrdfError> {
    let reduced = reduced(text)?;
    let other = match urdf_rs::read_from_string(&reduced) {
        Ok(other) => other,
        Err(error) => return Ok(Some(UrdfWarning::ReadOnce { why: cut(&error.to_string()) })),
    };
    let disputed = |place: String, what: &'static str| Err(UrdfError::Disputed { place, what });
    if other.links.len() != robot.links.len() || other.joints.len() != robot.joints.len() {
        return disputed("the robot".to_owned(), "number of links and joints");
    }
    for (link, other) in robot.links.iter().zip(&other.links) {
        if let Some(what) = link_difference(link, other) {
            return disputed(format!("link \"{}\"", cut(&link.name)), what);
        }
    }
    for (joint, other) in robot.joints.iter().zip(&other.joints) {
        if let Some(what) = joint_difference(joint, other) {
            return disputed(format!("joint \"{}\"", cut(&joint.name)), what);
        }
    }
    Ok(None)
}

/// `text` without the elements that are passed over.
fn reduced(text: &str) -> Result<String, UrdfError> {
    let document = parse_xml(text)?;
    let is_passed_over = |node: &Node| node.is_element() && PASSED_OVER.contains(&node.tag_name().name());
    let mut kept = String::with_capacity(text.len());
    let mut at = 0;
    for node in document.descendants().filter(is_passed_over) {
        let range = node.range();
        // One within another has gone with it.
        if range.start >= at {
            kept.push_str(&text[at..range.start]);
            at = range.end;
        }
    }
    kept.push_str(&text[at..]);
    Ok(kept)
}

fn link_difference(link: &LinkElement, other: &urdf_rs::Link) -> Option<&'static str> {
    if link.name != other.name {
        return Some("name");
    }
    if link.collisions.len() != other.collision.len() {
        return Some("number of collision shapes");
    }
    link.collisions.iter().zip(&other.collision).find_map(|(collision, other)| {
        if !same_pose(&collision.pose, &other.origin) {
            return Some("origin of a collision shape");
        }
        (!same_shape(&collision.geometry, &other.geometry)).then_some("collision shape")
    })
}

fn joint_difference(joint: &JointElement, other: &urdf_rs::Joint) -> Option<&'static str> {
    let kind = match other.joint_type {
        JointType::Fixed => Some(JointKind::Fixed),
        JointType::Revolute => Some(JointKind::Revolute),
        JointType::Continuous => Some(JointKind::Continuous),
        JointType::Prismatic => Some(JointKind::Prismatic),
        JointType::Planar => Some(JointKind::Planar),
        JointType::Floating => Some(JointKind::Floating),
        JointType::Spherical => None,
    };
    let axis = other.axis.xyz.0;
    let limit = joint.limit.map(|limit| [limit.lower, limit.upper, limit.velocity]);
    let theirs = [other.limit.lower, other.limit.upper, other.limit.velocity];
    let mimic = joint.mimic.as_ref().map(|m| (m.joint.as_str(), m.multiplier, m.offset));
    let their_mimic = other
        .mimic
        .as_ref()
        .map(|m| (m.joint.as_str(), m.multiplier.unwrap_or(1.0), m.offset.unwrap_or(0.0)));
    let same_mimic = match (mimic, their_mimic) {
        (Some((a, b, c)), Some((x, y, z))) => a == x && same(b, y) && same(c, z),
        (None, None) => true,
        _ => false,
    };
    // An axis means nothing to a joint that cannot move.
    let same_axis =
        !joint.kind.is_movable() || joint.axis.iter().zip(axis).all(|(mine, theirs)| same(*mine, theirs));
    let same_limit = limit.is_none_or(|limit| limit.iter().zip(theirs).all(|(a, b)| same(*a, b)));
    [
        (joint.name == other.name, "name"),
        (kind == Some(joint.kind), "type"),
        (joint.parent == other.parent.link, "parent"),
        (joint.child == other.child.link, "child"),
        (same_pose(&joint.origin, &other.origin), "origin"),
        (same_axis, "axis"),
        (same_limit, "limit"),
        (same_mimic, "mimic"),
    ]
    .into_iter()
    .find_map(|(agree, what)| (!agree).then_some(what))
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.abs().max(1.0)
}

fn same_pose(mine: &Pose, theirs: &urdf_rs::Pose) -> bool {
    let [roll, pitch, yaw] = theirs.rpy.0;
    let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    mine.translation.vector.iter().zip(theirs.xyz.0).all(|(a, b)| same(*a, b))
        && mine.rotation.angle_to(&turn) <= 1e-6
}

fn same_shape(mine: &GeometryElement, theirs: &Geometry) -> bool {
    match (mine, theirs) {
        (GeometryElement::Box { size }, Geometry::Box { size: other }) => {
            size.iter().zip(other.0).all(|(a, b)| same(*a, b))
        }
        (GeometryElement::Sphere { radius }, Geometry::Sphere { radius: other }) => same(*radius, *other),
        (GeometryElement::Cylinder { radius, length }, Geometry::Cylinder { radius: r, length: l })
        | (GeometryElement::Capsule { radius, length }, Geometry::Capsule { radius: r, length: l }) => {
            same(*radius, *r) && same(*length, *l)
        }
        (GeometryElement::Mesh { uri, scale }, Geometry::Mesh { filename, scale: other }) => {
            let other = other.map_or([1.0; 3], |scale| scale.0);
            uri == filename && scale.iter().zip(other).all(|(a, b)| same(*a, b))
        }
        _ => false,
    }
}
