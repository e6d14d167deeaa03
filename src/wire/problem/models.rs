//! The arm models that are loaded from robots.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

use super::context::Context;
use super::known_robots::RobotKey;
use super::meshes::{Meshes, code_of};
use super::robot::RobotSpec;
use crate::geometry::Vec3;
use crate::kinematics::{
    ArmModel, MeshError, MeshPieces, MeshResolver, SrdfError, UrdfError, UrdfWarning, XmlError,
    disabled_link_pairs,
};
use crate::wire::digest::sha256;
use crate::wire::fault::FaultCode;
use crate::wire::resources::{ResourceError, resolve_uri};
use crate::workcell::{ArmBody, BodyPair};

/// Most unknown joints of one arm that are told apart.
const MAX_UNKNOWN_JOINTS: usize = 16;

/// An arm model and what its SRDF exempts.
#[derive(Debug, Clone)]
pub struct LoadedModel {
    /// The model.
    pub model: Arc<ArmModel>,
    /// Pairs of links that the SRDF disables.
    pub disabled: Vec<BodyPair>,
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
        if let Err(error) = load(spec, mount, &BTreeMap::new(), &meshes, context) {
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
            match load(spec, mount, &held, &meshes, context) {
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

    /// Whether an arm has loaded the robot of this name.
    pub(super) fn has(&self, robot: &str) -> bool {
        self.loaded.keys().any(|(name, ..)| name == robot)
    }

    /// The pairs of links that the SRDF of `spec` disables; `None` when it is no good.
    pub(super) fn disabled(
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

    /// Notes a fault of a robot once, however many arms it has.
    pub fn note_once(&mut self, pointer: &str, code: FaultCode, message: &str, context: &mut Context<'_>) {
        if self.noted.insert((pointer.to_owned(), message.to_owned())) {
            context.faults.push(pointer, code, message);
        }
    }

    /// Notes what is wrong with the URDF of `spec`, the tool on the link named at `mount_pointer`, where it comes from.
    pub(super) fn note(
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

/// Makes a model of `spec`.
fn load(
    spec: &RobotSpec,
    mount: &str,
    held: &BTreeMap<String, f64>,
    meshes: &UrdfMeshes<'_>,
    context: &Context<'_>,
) -> Result<(ArmModel, Vec<UrdfWarning>), UrdfError> {
    let size = context.limits.robot_size();
    ArmModel::from_urdf_within(&spec.name, &spec.urdf.text, mount, held, meshes, size)
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
