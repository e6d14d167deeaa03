//! URDF text to arm model.
//!
//! The text comes from outside: it is bounded before it is parsed, nothing is read but what the
//! [`MeshResolver`] hands out, and every fault is a typed error.

mod collada;
mod document;
mod error;
mod mesh;
mod second_reading;
mod shapes;
mod tree;

pub use error::{LimitFault, UrdfError, UrdfWarning};
pub use mesh::{MAX_MESH_BYTES, MeshError, MeshFilled, MeshPieces, MeshResolver, NoMeshes, read_mesh};

use std::collections::BTreeMap;

use nalgebra::{Translation3, Unit, UnitQuaternion};

use super::{ArmModel, Joint, JointLimits, Link, LinkMotion};
use crate::geometry::Pose;
use document::{JointElement, JointKind, MAX_MAGNITUDE, RobotElement, cut, read_robot};
use tree::{LinkTree, closest_names, link_tree};

/// How many joints a mimic joint may follow one through the other.
const MAX_MIMIC_DEPTH: usize = 100;

/// How large a robot may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UrdfSize {
    /// Links.
    pub links: usize,
    /// Collision shapes of all links together, as they stand in the text.
    pub shapes: usize,
}

impl UrdfSize {
    /// As large as the text is.
    pub const ANY: Self = Self { links: usize::MAX, shapes: usize::MAX };

    /// Whether `robot` is within it.
    fn check(&self, robot: &RobotElement) -> Result<(), UrdfError> {
        let (links, most) = (robot.links.len(), self.links);
        if links > most {
            return Err(UrdfError::TooMany { what: "links", count: links, most });
        }
        self.check_shapes(robot.links.iter().map(|link| link.collisions.len()).sum())
    }

    /// Whether so many collision shapes are within it.
    fn check_shapes(&self, count: usize) -> Result<(), UrdfError> {
        let most = self.shapes;
        if count > most {
            return Err(UrdfError::TooMany { what: "collision shapes", count, most });
        }
        Ok(())
    }
}

/// What moves a joint of the document.
#[derive(Debug, Clone, Copy)]
enum Drive {
    /// It stands at this value (rad or m).
    Held(f64),
    /// It follows a joint of the chain.
    Chain { joint: usize, multiplier: f64, offset: f64 },
}

impl ArmModel {
    /// Loads a URDF.
    ///
    /// The chain's joints are the movable ones (revolute, continuous, prismatic) from the root to
    /// `mount_link`; mimic joints follow; other joints stand at their value in `held` (rad or m),
    /// or at 0. Values in `held` of joints on the chain are passed over. An acceleration limit is
    /// read from the `acceleration` attribute of `<limit>` where there is one.
    ///
    /// # Errors
    /// [`UrdfError`] for whatever is wrong with the text, the meshes, `mount_link` or `held`.
    pub fn from_urdf(
        name: &str,
        urdf_xml: &str,
        mount_link: &str,
        held: &BTreeMap<String, f64>,
        meshes: &dyn MeshResolver,
    ) -> Result<(Self, Vec<UrdfWarning>), UrdfError> {
        let (model, warnings) =
            Self::from_urdf_within(name, urdf_xml, mount_link, held, meshes, UrdfSize::ANY)?;
        match model.joints.iter().find_map(|joint| joint.limit_fault.clone()) {
            Some(fault) => Err(fault),
            None => Ok((model, warnings)),
        }
    }

    /// Loads a URDF as [`ArmModel::from_urdf`] does, if the robot is no larger than `size`: that is
    /// looked at before anything is built. Limits of the chain's joints that are missing or cannot be
    /// are no error here, so that others may replace them: see [`Joint::limit_fault`].
    ///
    /// # Errors
    /// [`UrdfError`], of which [`UrdfError::TooMany`] says that it is larger.
    pub fn from_urdf_within(
        name: &str,
        urdf_xml: &str,
        mount_link: &str,
        held: &BTreeMap<String, f64>,
        meshes: &dyn MeshResolver,
        size: UrdfSize,
    ) -> Result<(Self, Vec<UrdfWarning>), UrdfError> {
        let robot = read_robot(urdf_xml)?;
        size.check(&robot)?;
        let tree = link_tree(&robot)?;
        let mount = robot.links.iter().position(|link| link.name == mount_link).ok_or_else(|| {
            UrdfError::NoSuchMountLink {
                name: cut(mount_link),
                closest: closest_names(mount_link, robot.links.iter().map(|link| link.name.as_str())),
            }
        })?;
        let mut warnings: Vec<UrdfWarning> = second_reading::compare(urdf_xml, &robot)?.into_iter().collect();
        let chain = chain_joints(&robot, &tree, mount)?;
        check_limits_beside(&robot, &chain)?;
        if chain.is_empty() {
            return Err(UrdfError::NoMovableJoint { mount: cut(mount_link) });
        }
        let drives = joint_drives(&robot, &chain, held, &mut warnings)?;

        let mut place = vec![0; robot.links.len()];
        for (position, link) in tree.order.iter().enumerate() {
            place[*link] = position;
        }
        let mut links: Vec<Link> = Vec::with_capacity(robot.links.len());
        let mut groups = 1;
        // A mesh has several convex pieces, perhaps.
        let mut count = 0;
        for &index in &tree.order {
            let element = &robot.links[index];
            let shapes = shapes::link_shapes(element, meshes, &mut warnings)?;
            count += shapes.len();
            size.check_shapes(count)?;
            let link_name = element.name.clone();
            let parent = tree.parent[index].map(|link| place[link]);
            let (origin, motion, group) = match (tree.joint_above[index], parent) {
                (Some(joint), Some(parent)) => {
                    let element = &robot.joints[joint];
                    let (origin, motion) = joint_motion(element, drives[joint])?;
                    let group = if element.kind == JointKind::Fixed {
                        links[parent].group
                    } else {
                        groups += 1;
                        groups - 1
                    };
                    (origin, motion, group)
                }
                _ => (Pose::identity(), LinkMotion::Held, 0),
            };
            links.push(Link { name: link_name, parent, origin, motion, group, shapes });
        }

        let mut joints = Vec::with_capacity(chain.len());
        for &index in &chain {
            let element = &robot.joints[index];
            let link = tree.joint_above.iter().position(|above| *above == Some(index)).unwrap_or_default();
            let (limits, limit_fault) = joint_limits(element);
            if limits.lower == limits.upper {
                warnings.push(UrdfWarning::NoRange { joint: cut(&element.name) });
            }
            joints.push(Joint { name: element.name.clone(), link: place[link], limits, limit_fault });
        }
        Ok((Self::new(name.to_owned(), links, joints, place[mount]), warnings))
    }
}

/// The independent movable joints from the root to `mount`, in this order.
fn chain_joints(robot: &RobotElement, tree: &LinkTree, mount: usize) -> Result<Vec<usize>, UrdfError> {
    let mut chain = Vec::new();
    let mut link = mount;
    while let (Some(joint), Some(parent)) = (tree.joint_above[link], tree.parent[link]) {
        let element = &robot.joints[joint];
        match element.kind {
            JointKind::Planar | JointKind::Floating => {
                return Err(UrdfError::UnsupportedJoint {
                    joint: cut(&element.name),
                    kind: element.kind.name(),
                });
            }
            kind if kind.is_movable() && element.mimic.is_none() => chain.push(joint),
            _ => {}
        }
        link = parent;
    }
    chain.reverse();
    Ok(chain)
}

/// Checks the limits of the joints outside the chain, which nothing else replaces.
fn check_limits_beside(robot: &RobotElement, chain: &[usize]) -> Result<(), UrdfError> {
    for (index, joint) in robot.joints.iter().enumerate() {
        if let Some(fault) = joint.limit.as_ref().and_then(LimitFault::of)
            && !chain.contains(&index)
        {
            return Err(UrdfError::BadLimit { joint: cut(&joint.name), fault });
        }
    }
    Ok(())
}

/// What moves each joint of the document.
fn joint_drives(
    robot: &RobotElement,
    chain: &[usize],
    held: &BTreeMap<String, f64>,
    warnings: &mut Vec<UrdfWarning>,
) -> Result<Vec<Drive>, UrdfError> {
    let by_name: BTreeMap<&str, usize> =
        robot.joints.iter().enumerate().map(|(index, joint)| (joint.name.as_str(), index)).collect();
    let mut drives = vec![Drive::Held(0.0); robot.joints.len()];
    for (joint, index) in chain.iter().enumerate() {
        drives[*index] = Drive::Chain { joint, multiplier: 1.0, offset: 0.0 };
    }
    for (name, value) in held {
        let index = *by_name.get(name.as_str()).ok_or_else(|| UrdfError::UnknownHeldJoint {
            name: cut(name),
            closest: closest_names(name, robot.joints.iter().map(|joint| joint.name.as_str())),
        })?;
        let element = &robot.joints[index];
        if !element.kind.is_movable() {
            return Err(UrdfError::NotHoldable { name: cut(name), kind: element.kind.name() });
        }
        if element.mimic.is_some() {
            return Err(UrdfError::NotHoldable { name: cut(name), kind: "a mimic joint" });
        }
        if matches!(drives[index], Drive::Chain { .. }) {
            continue;
        }
        if value.is_nan() || value.abs() > MAX_MAGNITUDE {
            return Err(UrdfError::BadHeldValue { name: cut(name), value: *value });
        }
        if let Some(limit) = element.limit
            && element.kind != JointKind::Continuous
            && !(limit.lower..=limit.upper).contains(value)
        {
            warnings.push(UrdfWarning::HeldOutsideLimits {
                joint: cut(name),
                value: *value,
                lower: limit.lower,
                upper: limit.upper,
            });
        }
        drives[index] = Drive::Held(*value);
    }
    for index in 0..robot.joints.len() {
        if robot.joints[index].kind.is_movable() && robot.joints[index].mimic.is_some() {
            drives[index] = mimic_drive(robot, index, &by_name, &drives)?;
        }
    }
    Ok(drives)
}

/// Follows a mimic joint to the joint that drives it in the end.
fn mimic_drive(
    robot: &RobotElement,
    start: usize,
    by_name: &BTreeMap<&str, usize>,
    drives: &[Drive],
) -> Result<Drive, UrdfError> {
    let (mut multiplier, mut offset) = (1.0, 0.0);
    let mut index = start;
    let mut steps = 0;
    while let Some(mimic) = &robot.joints[index].mimic {
        steps += 1;
        if steps > MAX_MIMIC_DEPTH {
            return Err(UrdfError::MimicCycle { joint: cut(&robot.joints[start].name) });
        }
        let bad = || UrdfError::BadMimic { joint: cut(&robot.joints[index].name), target: cut(&mimic.joint) };
        let target = *by_name.get(mimic.joint.as_str()).ok_or_else(bad)?;
        if !robot.joints[target].kind.is_movable() {
            return Err(bad());
        }
        offset += multiplier * mimic.offset;
        multiplier *= mimic.multiplier;
        index = target;
    }
    let usable = |value: f64| value.is_finite() && value.abs() <= MAX_MAGNITUDE;
    if !usable(multiplier) || !usable(offset) {
        return Err(UrdfError::OutOfRange {
            place: format!("joint \"{}\" mimic", cut(&robot.joints[start].name)),
            value: multiplier,
            limit: MAX_MAGNITUDE,
        });
    }
    Ok(match drives[index] {
        Drive::Held(value) => Drive::Held(multiplier * value + offset),
        Drive::Chain { joint, .. } => Drive::Chain { joint, multiplier, offset },
    })
}

/// The joint frame in the parent's frame, and how the child moves against it.
fn joint_motion(element: &JointElement, drive: Drive) -> Result<(Pose, LinkMotion), UrdfError> {
    if !element.kind.is_movable() {
        return Ok((element.origin, LinkMotion::Held));
    }
    let axis =
        Unit::try_new(element.axis, 1e-9).ok_or_else(|| UrdfError::ZeroAxis { joint: cut(&element.name) })?;
    let turns = element.kind != JointKind::Prismatic;
    Ok(match drive {
        Drive::Held(value) if turns => {
            (element.origin * UnitQuaternion::from_axis_angle(&axis, value), LinkMotion::Held)
        }
        Drive::Held(value) => {
            (element.origin * Translation3::from(axis.into_inner() * value), LinkMotion::Held)
        }
        Drive::Chain { joint, multiplier, offset } if turns => {
            (element.origin, LinkMotion::Revolute { axis, joint, multiplier, offset })
        }
        Drive::Chain { joint, multiplier, offset } => {
            (element.origin, LinkMotion::Prismatic { axis, joint, multiplier, offset })
        }
    })
}

/// The limits of a joint of the chain, unlimited where there are none, and what is wrong with them.
fn joint_limits(element: &JointElement) -> (JointLimits, Option<UrdfError>) {
    let name = || cut(&element.name);
    let unlimited = JointLimits {
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: element.limit.map_or(0.0, |limit| limit.velocity),
        acceleration: element.limit.map_or(0.0, |limit| limit.acceleration),
    };
    let bad =
        |limit: JointLimits| LimitFault::of(&limit).map(|fault| UrdfError::BadLimit { joint: name(), fault });
    match (element.kind, element.limit) {
        (JointKind::Continuous, limit) => (unlimited, limit.and_then(bad)),
        (_, Some(limit)) => (limit, bad(limit)),
        (_, None) => (unlimited, Some(UrdfError::NoLimit { joint: name() })),
    }
}

#[cfg(test)]
mod tests;
