//! Robots: their URDF and SRDF text, and what is said of their joints.

use std::collections::{BTreeMap, BTreeSet};

use super::context::Context;
use super::urdf_names;
use crate::kinematics::{Joint, JointLimits, LimitFault, UrdfError, library, library_names};
use crate::wire::digest::sha256;
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Fields, Node, Range, shown};
use crate::wire::resources::{check_folder, folder_of, resolve_uri};

/// Greatest magnitude of a joint value, velocity or acceleration in an override.
const MAX_JOINT_FIGURE: f64 = 1.0e4;

/// What an override says of one joint.
#[derive(Debug, Clone, Copy, Default)]
pub struct LimitOverride {
    lower: Option<f64>,
    upper: Option<f64>,
    velocity: Option<f64>,
    acceleration: Option<f64>,
}

impl LimitOverride {
    /// Takes over what `other` says.
    pub fn overrule_with(&mut self, other: &Self) {
        self.lower = other.lower.or(self.lower);
        self.upper = other.upper.or(self.upper);
        self.velocity = other.velocity.or(self.velocity);
        self.acceleration = other.acceleration.or(self.acceleration);
    }

    /// What is wrong with the limits of `joint` in its URDF and not mended by what this says; `limits`
    /// are what comes of both.
    pub fn left_open(&self, joint: &Joint, limits: &JointLimits) -> Option<UrdfError> {
        let fault = joint.limit_fault.as_ref()?;
        let mended = match fault {
            UrdfError::NoLimit { .. } => {
                self.lower.is_some() && self.upper.is_some() && self.velocity.is_some()
            }
            UrdfError::BadLimit { fault: LimitFault::Crossed { .. }, .. } => {
                (self.lower.is_some() || self.upper.is_some()) && limits.lower <= limits.upper
            }
            _ => true,
        };
        if !mended {
            return Some(fault.clone());
        }
        LimitFault::negative(limits).map(|fault| UrdfError::BadLimit { joint: shown(&joint.name), fault })
    }

    /// Replaces what it says.
    pub fn apply(&self, limits: &mut JointLimits) {
        limits.lower = self.lower.unwrap_or(limits.lower);
        limits.upper = self.upper.unwrap_or(limits.upper);
        limits.velocity = self.velocity.unwrap_or(limits.velocity);
        limits.acceleration = self.acceleration.unwrap_or(limits.acceleration);
    }
}

/// A text and the JSON pointer of the field that it came from.
#[derive(Debug, Clone)]
pub(super) struct Source {
    pub text: String,
    pub pointer: String,
}

/// One entry of `workcell.robots`.
#[derive(Debug, Clone)]
pub struct RobotSpec {
    pub(super) name: String,
    pub(super) urdf: Source,
    pub(super) srdf: Option<Source>,
    /// Folder of the URDF, relative to the document; empty for inline text.
    pub(super) folder: String,
    pub(super) packages: Vec<(String, String)>,
    /// Overrides, by joint, with their pointers.
    pub limits: BTreeMap<String, (LimitOverride, String)>,
}

impl RobotSpec {
    /// Tells it from the other robots of the document.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// JSON pointer to its URDF.
    pub fn pointer(&self) -> String {
        self.urdf.pointer.clone()
    }

    /// The names of all its joints, of a URDF that could be loaded.
    pub fn joint_names(&self) -> BTreeSet<String> {
        urdf_names::joint_names(&self.urdf.text)
    }
}

/// `workcell.robots`; `None` for an entry that cannot be used.
pub fn read_robots(node: Option<Node<'_>>, context: &mut Context<'_>) -> BTreeMap<String, Option<RobotSpec>> {
    let Some(node) = node else { return BTreeMap::new() };
    let entries = node.entries(&mut context.faults);
    if entries.len() > context.limits.max_robots {
        let message = format!("{} robots, at most {} are taken", entries.len(), context.limits.max_robots);
        node.fault(&mut context.faults, FaultCode::TooLarge, message);
    }
    let most = context.limits.max_robots;
    entries
        .into_iter()
        .enumerate()
        .map(|(index, (name, node))| {
            let spec = if index < most { read_robot(name, &node, context) } else { None };
            (name.to_owned(), spec)
        })
        .collect()
}

fn read_robot(name: &str, node: &Node<'_>, context: &mut Context<'_>) -> Option<RobotSpec> {
    let mut fields = node.fields(&mut context.faults)?;
    let packages = read_packages(&mut fields, context);
    let limits = fields.optional("limits").map(|node| read_limits(&node, context)).unwrap_or_default();
    let reference = fields.optional("urdf");
    let inline = fields.optional("urdf_xml");
    let srdf = read_srdf(&mut fields, context);
    fields.finish(&mut context.faults);
    let mut folder = String::new();
    let mut shipped_srdf = None;
    let urdf = match (reference, inline) {
        (Some(_), Some(inline)) => {
            let message = "`urdf` and `urdf_xml` exclude each other; give one of them";
            inline.fault(&mut context.faults, FaultCode::OutOfRange, message);
            None
        }
        (None, None) => {
            let message = "`urdf` is missing; add it, or `urdf_xml`";
            node.fault(&mut context.faults, FaultCode::MissingField, message);
            None
        }
        (None, Some(inline)) => read_inline(&inline, context),
        (Some(reference), None) => {
            let text = reference.string(&mut context.faults)?;
            if let Some(wanted) = text.strip_prefix("library:") {
                let Some(robot) = library(wanted) else {
                    let names: Vec<_> = library_names().collect();
                    let message =
                        format!("the library has no robot `{}`; it has {}", shown(wanted), names.join(", "));
                    reference.fault(&mut context.faults, FaultCode::UnresolvedUri, message);
                    return None;
                };
                let content = [robot.urdf.as_bytes(), robot.srdf.as_bytes()].concat();
                context.contents.insert(reference.pointer.clone(), sha256(&content));
                shipped_srdf =
                    Some(Source { text: robot.srdf.to_owned(), pointer: reference.pointer.clone() });
                Some(Source { text: robot.urdf.to_owned(), pointer: reference.pointer })
            } else {
                let path = resolve_uri(text, "", &[]);
                folder = path.map(|path| folder_of(&path).to_owned()).unwrap_or_default();
                read_text_file(&reference, context, FaultCode::BadUrdf)
            }
        }
    };
    let srdf = match srdf {
        Ok(srdf) => srdf.or(shipped_srdf),
        Err(()) => None,
    };
    Some(RobotSpec { name: name.to_owned(), urdf: urdf?, srdf, folder, packages, limits })
}

fn read_inline(node: &Node<'_>, context: &mut Context<'_>) -> Option<Source> {
    let text = node.string(&mut context.faults)?;
    if text.len() > context.limits.max_urdf_bytes {
        let message = format!("{} bytes, at most {} are taken", text.len(), context.limits.max_urdf_bytes);
        node.fault(&mut context.faults, FaultCode::TooLarge, message);
        return None;
    }
    Some(Source { text: text.to_owned(), pointer: node.pointer.clone() })
}

fn read_text_file(node: &Node<'_>, context: &mut Context<'_>, code: FaultCode) -> Option<Source> {
    let path = node.string(&mut context.faults)?;
    let path = resolve_uri(path, "", &[]);
    let bytes = context.read_file(node, path, context.limits.max_urdf_bytes)?;
    match String::from_utf8(bytes) {
        Ok(text) => Some(Source { text, pointer: node.pointer.clone() }),
        Err(_) => {
            node.fault(&mut context.faults, code, "the file is not UTF-8 text");
            None
        }
    }
}

/// `srdf` or `srdf_xml`: `Ok(None)` when there is neither, `Err` when what is there is no good.
fn read_srdf(fields: &mut Fields<'_>, context: &mut Context<'_>) -> Result<Option<Source>, ()> {
    match (fields.optional("srdf"), fields.optional("srdf_xml")) {
        (None, None) => Ok(None),
        (Some(_), Some(inline)) => {
            let message = "`srdf` and `srdf_xml` exclude each other; give one of them";
            inline.fault(&mut context.faults, FaultCode::OutOfRange, message);
            Err(())
        }
        (Some(node), None) => read_text_file(&node, context, FaultCode::BadSrdf).map(Some).ok_or(()),
        (None, Some(node)) => read_inline(&node, context).map(Some).ok_or(()),
    }
}

fn read_packages(fields: &mut Fields<'_>, context: &mut Context<'_>) -> Vec<(String, String)> {
    let Some(node) = fields.optional("package_map") else { return Vec::new() };
    let mut packages = Vec::new();
    for (name, node) in node.entries(&mut context.faults) {
        if let Some(folder) = node.string(&mut context.faults) {
            match check_folder(folder) {
                Ok(()) => packages.push((name.to_owned(), folder.to_owned())),
                Err(error) => context.unread(&node, &error),
            }
        }
    }
    packages
}

/// Overrides of limits, by joint, with their pointers.
pub fn read_limits(node: &Node<'_>, context: &mut Context<'_>) -> BTreeMap<String, (LimitOverride, String)> {
    let faults = &mut context.faults;
    let mut out = BTreeMap::new();
    for (joint, node) in node.entries(faults) {
        let Some(mut fields) = node.fields(faults) else { continue };
        let mut figure = |key, range| fields.optional(key).and_then(|node| node.number(faults, range));
        let limits = LimitOverride {
            lower: figure("lower", Range::Within(MAX_JOINT_FIGURE)),
            upper: figure("upper", Range::Within(MAX_JOINT_FIGURE)),
            velocity: figure("velocity", Range::Positive(MAX_JOINT_FIGURE)),
            acceleration: figure("acceleration", Range::Positive(MAX_JOINT_FIGURE * 100.0)),
        };
        fields.finish(faults);
        out.insert(joint.to_owned(), (limits, node.pointer));
    }
    out
}

/// Joint values by name, as they stand in `home` or `initial_joints`, with their pointers.
pub fn read_joint_values(node: &Node<'_>, context: &mut Context<'_>) -> BTreeMap<String, (f64, String)> {
    let entries = node.entries(&mut context.faults);
    let mut out = BTreeMap::new();
    for (joint, node) in entries {
        if let Some(value) = node.number(&mut context.faults, Range::Within(MAX_JOINT_FIGURE)) {
            out.insert(joint.to_owned(), (value, node.pointer));
        }
    }
    out
}

/// What is said of limits for a joint that the robot lacks.
pub fn lacks_joint(joint: &str) -> String {
    format!("the robot has no joint `{}`; remove it or name another", shown(joint))
}
