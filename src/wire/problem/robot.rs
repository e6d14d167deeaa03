//! Robots: their URDF and SRDF text, and the arm models that are loaded from them.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

use super::context::Context;
use super::known_robots::RobotKey;
use super::meshes::{Meshes, code_of};
use super::urdf_names;
use crate::geometry::{ConvexHull, Vec3};
use crate::kinematics::{
    ArmModel, Joint, JointLimits, LimitFault, MeshError, MeshPieces, MeshResolver, SrdfError, UrdfError,
    UrdfSize, UrdfWarning, XmlError, disabled_link_pairs, library, library_names,
};
use crate::wire::digest::sha256;
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Fields, Node, Range, shown};
use crate::wire::resources::{ResourceError, check_folder, folder_of, resolve_uri};
use crate::workcell::{ArmBody, BodyPair};

/// Greatest magnitude of a joint value, velocity or acceleration in an override.
const MAX_JOINT_FIGURE: f64 = 1.0e4;

/// Links of a robot without arms that are tried for one that could carry a tool.
const MOST_MOUNTS: usize = 4;

/// Most unknown joints of one arm that are told apart.
const MAX_UNKNOWN_JOINTS: usize = 16;

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
struct Source {
    text: String,
    pointer: String,
}

/// One entry of `workcell.robots`.
#[derive(Debug, Clone)]
pub struct RobotSpec {
    name: String,
    urdf: Source,
    srdf: Option<Source>,
    /// Folder of the URDF, relative to the document; empty for inline text.
    folder: String,
    packages: Vec<(String, String)>,
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

    /// Makes a model of it.
    fn load(
        &self,
        mount: &str,
        held: &BTreeMap<String, f64>,
        meshes: &UrdfMeshes<'_>,
        context: &Context<'_>,
    ) -> Result<(ArmModel, Vec<UrdfWarning>), UrdfError> {
        let size = context.limits.robot_size();
        ArmModel::from_urdf_within(&self.name, &self.urdf.text, mount, held, meshes, size)
    }
}

/// An arm model and what its SRDF exempts.
#[derive(Debug, Clone)]
pub struct LoadedModel {
    /// The model.
    pub model: Arc<ArmModel>,
    /// Pairs of links that the SRDF disables.
    pub disabled: Vec<BodyPair>,
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

/// What decides a model: robot, mount link, and the values (as bits) of held joints.
type ModelKey = (String, String, Vec<(String, u64)>);

/// Loads arm models, each once: arms of one robot, mount link and held joints share one.
#[derive(Debug, Default)]
pub struct ModelCache {
    loaded: BTreeMap<ModelKey, Option<LoadedModel>>,
    noted: BTreeSet<(String, String)>,
}

impl ModelCache {
    /// The model of `spec` with the tool on `mount` (which stands at `mount_pointer`), joints
    /// outside the chain standing where `home` puts them.
    pub fn load(
        &mut self,
        spec: &RobotSpec,
        mount: &str,
        mount_pointer: &str,
        home: &BTreeMap<String, (f64, String)>,
        context: &mut Context<'_>,
    ) -> Option<LoadedModel> {
        let plain = self.load_held(spec, mount, mount_pointer, &BTreeMap::new(), home, context)?;
        let on_chain: BTreeSet<&str> = plain.model.joints.iter().map(|joint| joint.name.as_str()).collect();
        let held: BTreeMap<String, f64> = home
            .iter()
            .filter(|(joint, _)| !on_chain.contains(joint.as_str()))
            .map(|(joint, (value, _))| (joint.clone(), *value))
            .collect();
        if held.is_empty() {
            return Some(plain);
        }
        self.load_held(spec, mount, mount_pointer, &held, home, context)
    }

    fn load_held(
        &mut self,
        spec: &RobotSpec,
        mount: &str,
        mount_pointer: &str,
        held: &BTreeMap<String, f64>,
        home: &BTreeMap<String, (f64, String)>,
        context: &mut Context<'_>,
    ) -> Option<LoadedModel> {
        let bits = held.iter().map(|(joint, value)| (joint.clone(), value.to_bits())).collect();
        let key = (spec.name.clone(), mount.to_owned(), bits);
        if let Some(loaded) = self.loaded.get(&key).cloned() {
            if loaded.is_none() && held.is_empty() {
                // The mount link's faults belong to each arm that names it.
                self.note_again(spec, mount, mount_pointer, context);
            }
            return loaded;
        }
        let loaded = self.load_fresh(spec, mount, mount_pointer, held, home, context);
        self.loaded.insert(key, loaded.clone());
        loaded
    }

    fn note_again(&mut self, spec: &RobotSpec, mount: &str, mount_pointer: &str, context: &mut Context<'_>) {
        let meshes = UrdfMeshes::new(context, spec);
        if let Err(error) = spec.load(mount, &BTreeMap::new(), &meshes, context) {
            self.note(&error, spec, mount_pointer, &BTreeMap::new(), context);
        }
    }

    fn load_fresh(
        &mut self,
        spec: &RobotSpec,
        mount: &str,
        mount_pointer: &str,
        held: &BTreeMap<String, f64>,
        home: &BTreeMap<String, (f64, String)>,
        context: &mut Context<'_>,
    ) -> Option<LoadedModel> {
        let meshes = UrdfMeshes::new(context, spec);
        let mut held = held.clone();
        let mut usable = true;
        let mut left = MAX_UNKNOWN_JOINTS;
        let (model, warnings) = loop {
            let known = context.resources.known_robots().map(|robots| {
                let (name, urdf, mount) = (spec.name.clone(), spec.urdf.text.clone(), mount.to_owned());
                (robots, RobotKey { name, urdf, mount, held: held.clone() })
            });
            if let Some(model) = known.as_ref().and_then(|(robots, key)| robots.model(key)) {
                break model;
            }
            match spec.load(mount, &held, &meshes, context) {
                Ok((model, warnings)) => {
                    let loaded = (Arc::new(model), warnings);
                    break match known.filter(|_| meshes.is_untouched()) {
                        Some((robots, key)) => robots.keep_model(key, loaded),
                        None => loaded,
                    };
                }
                Err(error) => {
                    self.note(&error, spec, mount_pointer, home, context);
                    usable = false;
                    // Go on without the joint at fault, so that all of them are noted.
                    let joint = faulty_joint(&error)?.to_owned();
                    left -= 1;
                    if left == 0 || held.remove(&joint).is_none() {
                        return None;
                    }
                }
            }
        };
        if !usable {
            return None;
        }
        for warning in warnings {
            let code = match warning {
                UrdfWarning::MeshFilled { .. } => FaultCode::BadMesh,
                _ => FaultCode::BadUrdf,
            };
            if self.noted.insert((spec.urdf.pointer.clone(), warning.to_string())) {
                context.faults.warn(spec.urdf.pointer.clone(), code, warning.to_string());
            }
        }
        if let Some(digest) = meshes.digest(&spec.urdf.text) {
            context.contents.insert(spec.urdf.pointer.clone(), digest);
        }
        let disabled = self.disabled(spec, &model, context)?;
        Some(LoadedModel { model, disabled })
    }

    /// The pairs of links that the SRDF of `spec` disables; `None` when it is no good.
    fn disabled(
        &mut self,
        spec: &RobotSpec,
        model: &ArmModel,
        context: &mut Context<'_>,
    ) -> Option<Vec<BodyPair>> {
        let Some(srdf) = &spec.srdf else { return Some(Vec::new()) };
        match disabled_link_pairs(&srdf.text, model) {
            Ok(pairs) => Some(pairs.into_iter().map(|(a, b)| (ArmBody::Link(a), ArmBody::Link(b))).collect()),
            Err(error) => {
                let code = match &error {
                    SrdfError::UnknownLinks { .. } => FaultCode::UnknownLink,
                    SrdfError::Xml(XmlError::TooLarge { .. }) => FaultCode::TooLarge,
                    _ => FaultCode::BadSrdf,
                };
                self.note_once(&srdf.pointer, code, &error.to_string(), context);
                None
            }
        }
    }

    /// Looks at a robot that no arm has loaded: its URDF, its SRDF and its limits have to be good all the same. Files of
    /// meshes are not asked for.
    pub fn look_at_unused(&mut self, spec: &RobotSpec, context: &mut Context<'_>) {
        if self.loaded.keys().any(|(name, ..)| *name == spec.name) {
            return;
        }
        let model = match model_of_unused(spec, context.limits.robot_size()) {
            Ok(model) => model,
            Err(error) => return self.note(&error, spec, &spec.urdf.pointer, &BTreeMap::new(), context),
        };
        if let Some(model) = &model {
            self.disabled(spec, model, context);
        }
        let names = if spec.limits.is_empty() { BTreeSet::new() } else { spec.joint_names() };
        for (joint, (given, pointer)) in &spec.limits {
            if !names.contains(joint) {
                context.faults.push(pointer.clone(), FaultCode::UnknownJoint, lacks_joint(joint));
                continue;
            }
            let known = model.iter().flat_map(|model| &model.joints).find(|known| known.name == *joint);
            let (lower, upper) = (f64::NEG_INFINITY, f64::INFINITY);
            let unlimited = JointLimits { lower, upper, velocity: 0.0, acceleration: 0.0 };
            let mut limits = known.map_or(unlimited, |known| known.limits);
            given.apply(&mut limits);
            if limits.lower > limits.upper {
                let message = format!(
                    "joint `{}`: lower limit {} above upper limit {}; swap or widen them",
                    shown(joint),
                    limits.lower,
                    limits.upper
                );
                context.faults.push(pointer.clone(), FaultCode::OutOfRange, message);
            }
        }
    }

    /// Notes a fault of a robot once, however many arms it has.
    pub fn note_once(&mut self, pointer: &str, code: FaultCode, message: &str, context: &mut Context<'_>) {
        if self.noted.insert((pointer.to_owned(), message.to_owned())) {
            context.faults.push(pointer, code, message);
        }
    }

    fn note(
        &mut self,
        error: &UrdfError,
        spec: &RobotSpec,
        mount_pointer: &str,
        home: &BTreeMap<String, (f64, String)>,
        context: &mut Context<'_>,
    ) {
        let message = error.to_string();
        if let Some((_, pointer)) = faulty_joint(error).and_then(|joint| home.get(joint)) {
            let code = match error {
                UrdfError::BadHeldValue { .. } => FaultCode::OutOfRange,
                _ => FaultCode::UnknownJoint,
            };
            context.faults.push(pointer.clone(), code, message);
            return;
        }
        match error {
            UrdfError::NoSuchMountLink { .. } => {
                context.faults.push(mount_pointer, FaultCode::UnknownLink, message);
            }
            UrdfError::NoMovableJoint { .. } => {
                context.faults.push(mount_pointer, FaultCode::BadUrdf, message);
            }
            UrdfError::Mesh { error, .. } => {
                self.note_once(&spec.urdf.pointer, code_of(error), &message, context);
            }
            UrdfError::Xml(XmlError::TooLarge { .. }) | UrdfError::TooMany { .. } => {
                self.note_once(&spec.urdf.pointer, FaultCode::TooLarge, &message, context);
            }
            _ => self.note_once(&spec.urdf.pointer, FaultCode::BadUrdf, &message, context),
        }
    }
}

/// A model of a robot that no arm uses, with the tool on some link; `None` when none was found that could carry one, which is
/// no fault of the robot.
fn model_of_unused(spec: &RobotSpec, size: UrdfSize) -> Result<Option<ArmModel>, UrdfError> {
    let urdf = &spec.urdf.text;
    let none = BTreeMap::new();
    let load = |mount: &str| match ArmModel::from_urdf_within(&spec.name, urdf, mount, &none, &AnyMesh, size)
    {
        Ok((model, _)) => Ok(Some(model)),
        Err(
            UrdfError::NoSuchMountLink { .. }
            | UrdfError::NoMovableJoint { .. }
            | UrdfError::UnsupportedJoint { .. }
            | UrdfError::NoLimit { .. },
        ) => Ok(None),
        Err(error) => Err(error),
    };
    // On no link at first: that tells whether the text can be read.
    if let Some(model) = load("")? {
        return Ok(Some(model));
    }
    for mount in urdf_names::mount_links(urdf).iter().take(MOST_MOUNTS) {
        if let Some(model) = load(mount)? {
            return Ok(Some(model));
        }
    }
    Ok(None)
}

/// Has a small hull for every mesh, where meshes do not matter.
struct AnyMesh;

impl MeshResolver for AnyMesh {
    fn pieces(&self, _uri: &str, _scale: &Vec3) -> Result<MeshPieces, MeshError> {
        let corners = [Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        Ok(MeshPieces { hulls: vec![Arc::new(ConvexHull::new(&corners)?)], filled: None })
    }
}

/// The joint whose value in `home` is at fault.
fn faulty_joint(error: &UrdfError) -> Option<&str> {
    match error {
        UrdfError::UnknownHeldJoint { name, .. }
        | UrdfError::NotHoldable { name, .. }
        | UrdfError::BadHeldValue { name, .. } => Some(name),
        _ => None,
    }
}

/// Resolves a URDF's mesh URIs within the document's resources, and remembers what they held.
struct UrdfMeshes<'a> {
    meshes: Rc<Meshes<'a>>,
    spec: &'a RobotSpec,
    digests: RefCell<BTreeMap<String, String>>,
    asked: Cell<bool>,
}

impl<'a> UrdfMeshes<'a> {
    fn new(context: &Context<'a>, spec: &'a RobotSpec) -> Self {
        let meshes = Rc::clone(&context.meshes);
        Self { meshes, spec, digests: RefCell::default(), asked: Cell::new(false) }
    }

    /// Whether nobody asked for a mesh.
    fn is_untouched(&self) -> bool {
        !self.asked.get()
    }

    /// Digest of the URDF and all meshes that it refers to; `None` without meshes.
    fn digest(&self, urdf: &str) -> Option<String> {
        let digests = self.digests.borrow();
        if digests.is_empty() {
            return None;
        }
        let mut text = sha256(urdf.as_bytes());
        for (uri, digest) in digests.iter() {
            text.push_str(&format!("\n{uri} {digest}"));
        }
        Some(sha256(text.as_bytes()))
    }
}

impl MeshResolver for UrdfMeshes<'_> {
    fn pieces(&self, uri: &str, scale: &Vec3) -> Result<MeshPieces, MeshError> {
        self.asked.set(true);
        let path = resolve_uri(uri, &self.spec.folder, &self.spec.packages);
        let mesh = path.and_then(|path| self.meshes.get(&path, scale)).map_err(|error| match error {
            ResourceError::TooLarge(_) => MeshError::TooLarge,
            _ => MeshError::Unresolved,
        })?;
        self.digests.borrow_mut().insert(uri.to_owned(), mesh.digest);
        mesh.pieces
    }
}
