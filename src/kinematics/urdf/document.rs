//! The elements of a URDF that matter here, as they stand in the text.
//!
//! Read from the checked XML tree directly: a missing limit stays distinct from a limit of zero,
//! and every number is looked at.

use nalgebra::{Translation3, UnitQuaternion};
use roxmltree::Node;

use super::error::UrdfError;
use crate::geometry::{Pose, Vec3};
use crate::kinematics::JointLimits;
use crate::kinematics::xml::parse_xml;

/// Greatest accepted length (m), angle (rad) or factor.
pub(super) const MAX_MAGNITUDE: f64 = 1e6;

/// A `<robot>`.
#[derive(Debug)]
pub(super) struct RobotElement {
    pub links: Vec<LinkElement>,
    pub joints: Vec<JointElement>,
}

/// A `<link>`.
#[derive(Debug)]
pub(super) struct LinkElement {
    pub name: String,
    pub collisions: Vec<CollisionElement>,
}

/// A `<collision>`.
#[derive(Debug)]
pub(super) struct CollisionElement {
    pub pose: Pose,
    pub geometry: GeometryElement,
}

/// What stands in a `<geometry>`; full lengths, as in the text.
#[derive(Debug)]
pub(super) enum GeometryElement {
    Box { size: Vec3 },
    Sphere { radius: f64 },
    Cylinder { radius: f64, length: f64 },
    Capsule { radius: f64, length: f64 },
    Mesh { uri: String, scale: Vec3 },
}

/// The type of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JointKind {
    Fixed,
    Revolute,
    Continuous,
    Prismatic,
    Planar,
    Floating,
}

impl JointKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Revolute => "revolute",
            Self::Continuous => "continuous",
            Self::Prismatic => "prismatic",
            Self::Planar => "planar",
            Self::Floating => "floating",
        }
    }

    /// Whether one value moves it.
    pub fn is_movable(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// A `<joint>`.
#[derive(Debug)]
pub(super) struct JointElement {
    pub name: String,
    pub kind: JointKind,
    pub origin: Pose,
    pub parent: String,
    pub child: String,
    pub axis: Vec3,
    /// Its `<limit>`, be it possible or not; absent numbers are zero, as the format says.
    pub limit: Option<JointLimits>,
    pub mimic: Option<MimicElement>,
}

/// A `<mimic>`.
#[derive(Debug)]
pub(super) struct MimicElement {
    pub joint: String,
    pub multiplier: f64,
    pub offset: f64,
}

/// Reads the text of a URDF.
pub(super) fn read_robot(text: &str) -> Result<RobotElement, UrdfError> {
    let document = parse_xml(text)?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(UrdfError::NotARobot { found: cut(root.tag_name().name()) });
    }
    let mut robot = RobotElement { links: Vec::new(), joints: Vec::new() };
    for node in root.children().filter(Node::is_element) {
        match node.tag_name().name() {
            "link" => robot.links.push(read_link(node)?),
            "joint" => robot.joints.push(read_joint(node)?),
            _ => {}
        }
    }
    Ok(robot)
}

fn read_link(node: Node) -> Result<LinkElement, UrdfError> {
    let name = required(node, "name", "a link")?;
    let place = format!("link \"{}\"", cut(name));
    let mut collisions = Vec::new();
    for collision in children(node, "collision") {
        let place = format!("{place}, collision");
        let geometry = child(collision, "geometry")
            .ok_or_else(|| UrdfError::Missing { place: place.clone(), what: "<geometry>" })?;
        let shape = geometry
            .children()
            .find(Node::is_element)
            .ok_or_else(|| UrdfError::Missing { place: place.clone(), what: "shape in its <geometry>" })?;
        collisions.push(CollisionElement {
            pose: origin(collision, &place)?,
            geometry: read_shape(shape, &place)?,
        });
    }
    Ok(LinkElement { name: name.to_owned(), collisions })
}

fn read_shape(node: Node, place: &str) -> Result<GeometryElement, UrdfError> {
    let kind = node.tag_name().name();
    let place = format!("{place} {}", cut(kind));
    let size = |attribute: &'static str| {
        let value = number(node, attribute, &place)?
            .ok_or_else(|| UrdfError::Missing { place: place.clone(), what: attribute })?;
        positive(value, &format!("{place} {attribute}"))
    };
    match kind {
        "box" => {
            let size = vector(node, "size", &place)?
                .ok_or_else(|| UrdfError::Missing { place: place.clone(), what: "size" })?;
            for extent in size.iter() {
                positive(*extent, &format!("{place} size"))?;
            }
            Ok(GeometryElement::Box { size })
        }
        "sphere" => Ok(GeometryElement::Sphere { radius: size("radius")? }),
        "cylinder" => Ok(GeometryElement::Cylinder { radius: size("radius")?, length: size("length")? }),
        "capsule" => Ok(GeometryElement::Capsule { radius: size("radius")?, length: size("length")? }),
        "mesh" => {
            let uri = required(node, "filename", &place)?.to_owned();
            let scale = vector(node, "scale", &place)?.unwrap_or_else(|| Vec3::repeat(1.0));
            Ok(GeometryElement::Mesh { uri, scale })
        }
        _ => Err(UrdfError::BadValue {
            place,
            text: cut(kind),
            expected: "one of box, sphere, cylinder, capsule, mesh",
        }),
    }
}

fn read_joint(node: Node) -> Result<JointElement, UrdfError> {
    let name = required(node, "name", "a joint")?;
    let place = format!("joint \"{}\"", cut(name));
    let kind = match required(node, "type", &place)? {
        "fixed" => JointKind::Fixed,
        "revolute" => JointKind::Revolute,
        "continuous" => JointKind::Continuous,
        "prismatic" => JointKind::Prismatic,
        "planar" => JointKind::Planar,
        "floating" => JointKind::Floating,
        other => {
            return Err(UrdfError::BadValue {
                place: format!("{place} type"),
                text: cut(other),
                expected: "one of fixed, revolute, continuous, prismatic, planar, floating",
            });
        }
    };
    let link_of = |tag: &'static str, what: &'static str| {
        let element = child(node, tag).ok_or_else(|| UrdfError::Missing { place: place.clone(), what })?;
        required(element, "link", &format!("{place} <{tag}>")).map(str::to_owned)
    };
    let axis = match child(node, "axis") {
        Some(element) => vector(element, "xyz", &format!("{place} axis"))?
            .ok_or_else(|| UrdfError::Missing { place: format!("{place} axis"), what: "xyz" })?,
        None => Vec3::x(),
    };
    let limit = child(node, "limit").map(|element| read_limit(element, &place)).transpose()?;
    let mimic = child(node, "mimic").map(|element| read_mimic(element, &place)).transpose()?;
    Ok(JointElement {
        name: name.to_owned(),
        kind,
        origin: origin(node, &place)?,
        parent: link_of("parent", "<parent>")?,
        child: link_of("child", "<child>")?,
        axis,
        limit,
        mimic,
    })
}

fn read_limit(node: Node, place: &str) -> Result<JointLimits, UrdfError> {
    let place = format!("{place} limit");
    let value = |attribute| Ok::<f64, UrdfError>(number(node, attribute, &place)?.unwrap_or(0.0));
    Ok(JointLimits {
        lower: value("lower")?,
        upper: value("upper")?,
        velocity: value("velocity")?,
        // In the format since URDF 1.2; readers of older versions pass over it.
        acceleration: value("acceleration")?,
    })
}

fn read_mimic(node: Node, place: &str) -> Result<MimicElement, UrdfError> {
    let place = format!("{place} mimic");
    Ok(MimicElement {
        joint: required(node, "joint", &place)?.to_owned(),
        multiplier: number(node, "multiplier", &place)?.unwrap_or(1.0),
        offset: number(node, "offset", &place)?.unwrap_or(0.0),
    })
}

/// The pose in the `<origin>` of `node`: roll, pitch, yaw about fixed axes x, y, z.
fn origin(node: Node, place: &str) -> Result<Pose, UrdfError> {
    let Some(element) = child(node, "origin") else {
        return Ok(Pose::identity());
    };
    let place = format!("{place} origin");
    let xyz = vector(element, "xyz", &place)?.unwrap_or_else(Vec3::zeros);
    let rpy = vector(element, "rpy", &place)?.unwrap_or_else(Vec3::zeros);
    Ok(Pose::from_parts(Translation3::from(xyz), UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z)))
}

fn child<'a, 'i>(node: Node<'a, 'i>, tag: &'static str) -> Option<Node<'a, 'i>> {
    children(node, tag).next()
}

fn children<'a, 'i: 'a>(node: Node<'a, 'i>, tag: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |n| n.is_element() && n.tag_name().name() == tag)
}

fn required<'a>(node: Node<'a, '_>, attribute: &'static str, place: &str) -> Result<&'a str, UrdfError> {
    match node.attribute(attribute) {
        Some(text) if !text.is_empty() => Ok(text),
        _ => Err(UrdfError::Missing { place: place.to_owned(), what: attribute }),
    }
}

fn number(node: Node, attribute: &'static str, place: &str) -> Result<Option<f64>, UrdfError> {
    node.attribute(attribute).map(|text| parse_number(text, &format!("{place} {attribute}"))).transpose()
}

fn vector(node: Node, attribute: &'static str, place: &str) -> Result<Option<Vec3>, UrdfError> {
    let Some(text) = node.attribute(attribute) else {
        return Ok(None);
    };
    let place = format!("{place} {attribute}");
    let mut values = [0.0; 3];
    let mut words = text.split_whitespace();
    for value in &mut values {
        let word = words.next().ok_or_else(|| bad_vector(text, &place))?;
        *value = parse_number(word, &place)?;
    }
    match words.next() {
        Some(_) => Err(bad_vector(text, &place)),
        None => Ok(Some(Vec3::from(values))),
    }
}

fn bad_vector(text: &str, place: &str) -> UrdfError {
    UrdfError::BadValue { place: place.to_owned(), text: cut(text), expected: "three numbers" }
}

fn parse_number(text: &str, place: &str) -> Result<f64, UrdfError> {
    let value: f64 = text.trim().parse().map_err(|_| UrdfError::BadValue {
        place: place.to_owned(),
        text: cut(text),
        expected: "a number",
    })?;
    if !value.is_finite() {
        return Err(UrdfError::NotFinite { place: place.to_owned(), text: cut(text) });
    }
    if value.abs() > MAX_MAGNITUDE {
        return Err(UrdfError::OutOfRange { place: place.to_owned(), value, limit: MAX_MAGNITUDE });
    }
    Ok(value)
}

fn positive(value: f64, place: &str) -> Result<f64, UrdfError> {
    if value > 0.0 { Ok(value) } else { Err(UrdfError::SizeNotPositive { place: place.to_owned(), value }) }
}

/// At most 80 characters of `text`, for messages.
pub(super) fn cut(text: &str) -> String {
    if text.chars().nth(80).is_none() {
        return text.to_owned();
    }
    text.chars().take(80).chain("...".chars()).collect()
}
