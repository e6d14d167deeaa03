//! Robots that no arm uses: they have to be good all the same.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::context::Context;
use super::models::ModelCache;
use super::robot::{RobotSpec, lacks_joint};
use super::urdf_names;
use crate::geometry::{ConvexHull, Vec3};
use crate::kinematics::{ArmModel, JointLimits, MeshError, MeshPieces, MeshResolver, UrdfError, UrdfSize};
use crate::wire::fault::FaultCode;
use crate::wire::reader::shown;

/// Links of a robot without arms that are tried for one that could carry a tool.
const MOST_MOUNTS: usize = 4;

impl ModelCache {
    /// Looks at a robot that no arm has loaded: its URDF, its SRDF and its limits have to be good all the same. Files of
    /// meshes are not asked for.
    pub fn look_at_unused(&mut self, spec: &RobotSpec, context: &mut Context<'_>) {
        if self.has(&spec.name) {
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
