//! Arms: base, tool, home, limits.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::context::{Context, Named};
use super::known_robots::{KnownRobots, OverlapKey};
use super::models::{LoadedModel, ModelCache};
use super::robot::{LimitOverride, RobotSpec, lacks_joint, read_joint_values, read_limits};
use super::shape::{read_shape, shape_bits};
use super::statics::optional_pose;
use crate::kinematics::{ArmModel, Config, Joint, JointLimits};
use crate::run::Seed;
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Fields, Node, Range, shown};
use crate::workcell::contacts::{self, TooMuchWork};
use crate::workcell::{Arm, BodyPair, Tool};

/// A missing acceleration limit is this many times the velocity limit, per second.
const DEFAULT_ACCELERATION_FACTOR: f64 = 5.0;

/// Reads arms that share robots.
pub struct ArmReader<'s> {
    robots: &'s BTreeMap<String, Option<RobotSpec>>,
    models: ModelCache,
    /// What is known of this document's robots, and of those of others.
    own: KnownRobots,
    known: Option<&'s KnownRobots>,
    /// What is left of the limits' `max_overlap_work`; `None` when it was not enough.
    work_left: Option<u64>,
    warned: BTreeSet<String>,
    /// Joints on the chain of some arm of each robot.
    chains: BTreeMap<String, BTreeSet<String>>,
}

/// `workcell.arms`, one entry per element; robots have been read.
pub fn read_arms(
    node: Option<Node<'_>>,
    robots: &BTreeMap<String, Option<RobotSpec>>,
    context: &mut Context<'_>,
) -> Vec<Option<Arm>> {
    let Some(node) = node else { return Vec::new() };
    let elements = context.named_elements(&node, "arms", context.limits.max_arms);
    if node.value.as_array().is_some_and(Vec::is_empty) {
        node.fault(&mut context.faults, FaultCode::OutOfRange, "there is no arm; give at least one");
    }
    let mut reader = ArmReader {
        robots,
        own: KnownRobots::new(),
        known: context.resources.known_robots(),
        models: ModelCache::default(),
        work_left: Some(context.limits.max_overlap_work),
        warned: BTreeSet::new(),
        chains: BTreeMap::new(),
    };
    let arms: Vec<_> =
        elements.iter().enumerate().map(|(index, node)| reader.read_arm(index, node, context)).collect();
    reader.note_unused_limits(context);
    for robot in robots.values().flatten() {
        reader.models.look_at_unused(robot, context);
    }
    arms
}

impl ArmReader<'_> {
    fn read_arm(&mut self, index: usize, node: &Node<'_>, context: &mut Context<'_>) -> Option<Arm> {
        let mut fields = node.fields(&mut context.faults)?;
        let id = fields.required("id", &mut context.faults);
        let id = context.register(id, Named::Arm(index));
        let robot = fields.required("robot", &mut context.faults).and_then(|node| {
            let name = node.string(&mut context.faults)?;
            let Some(spec) = self.robots.get(name) else {
                let message = format!("`workcell.robots` has no `{}`; add it or name another", shown(name));
                node.fault(&mut context.faults, FaultCode::UnknownRobot, message);
                return None;
            };
            spec.as_ref()
        });
        let base =
            fields.required("base", &mut context.faults).and_then(|node| node.pose(&mut context.faults));
        let home = fields.optional("home").map(|node| read_joint_values(&node, context)).unwrap_or_default();
        let overrides = fields.optional("limits").map(|node| read_limits(&node, context)).unwrap_or_default();
        let tool = fields.required("tool", &mut context.faults).and_then(|node| {
            let mut fields = node.fields(&mut context.faults)?;
            let tool = read_tool(&mut fields, context);
            fields.finish(&mut context.faults);
            tool
        });
        fields.finish(&mut context.faults);
        let (robot, (mount, tool)) = (robot?, tool?);
        let loaded = self.models.load(
            robot,
            mount.value.as_str().unwrap_or_default(),
            &mount.pointer,
            &home,
            context,
        )?;
        let limits = self.limits(node, robot, &loaded.model, &overrides, context)?;
        let value = |joint: &Joint| home.get(&joint.name).map_or(0.0, |(value, _)| *value);
        let home = loaded.model.joints.iter().map(value).collect();
        let tool = tool?;
        let exempt_bodies = self.exempt(&loaded, &tool, &limits, robot, context)?;
        Some(Arm {
            id: id?,
            hand_groups: contacts::hand_groups(&loaded.model),
            exempt_groups: contacts::neighbours(&loaded.model),
            model: loaded.model,
            base: base?,
            tool,
            limits,
            home,
            exempt_bodies,
        })
    }

    fn limits(
        &mut self,
        node: &Node<'_>,
        robot: &RobotSpec,
        model: &ArmModel,
        overrides: &BTreeMap<String, (LimitOverride, String)>,
        context: &mut Context<'_>,
    ) -> Option<Vec<JointLimits>> {
        let before = context.faults.count();
        let names: BTreeSet<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
        let chain = self.chains.entry(robot.name().to_owned()).or_default();
        chain.extend(names.iter().map(|name| (*name).to_owned()));
        for (joint, (_, pointer)) in overrides {
            if !names.contains(joint.as_str()) {
                context.faults.push(pointer.clone(), FaultCode::UnknownJoint, unknown_joint(joint, model));
            }
        }
        let (mut is_whole, mut assumed) = (true, Vec::new());
        let mut out = Vec::with_capacity(model.joints.len());
        for joint in &model.joints {
            let mut given = LimitOverride::default();
            let mut pointer = node.pointer.as_str();
            for (limit, place) in
                [robot.limits.get(&joint.name), overrides.get(&joint.name)].into_iter().flatten()
            {
                given.overrule_with(limit);
                pointer = place;
            }
            let mut limits = joint.limits;
            given.apply(&mut limits);
            if let Some(fault) = given.left_open(joint, &limits) {
                let message = fault.to_string();
                self.models.note_once(&robot.pointer(), FaultCode::BadUrdf, &message, context);
                is_whole = false;
                continue;
            }
            let name = &joint.name;
            if limits.lower > limits.upper {
                let message = format!(
                    "joint `{name}`: lower limit {} above upper limit {}; swap or widen them",
                    limits.lower, limits.upper
                );
                context.faults.push(pointer, FaultCode::OutOfRange, message);
            }
            if limits.velocity <= 0.0 {
                let message = format!(
                    "joint `{name}` has no velocity limit above 0; give one in the URDF or in `limits`"
                );
                context.faults.push(pointer, FaultCode::OutOfRange, message);
            }
            if limits.acceleration <= 0.0 {
                limits.acceleration = DEFAULT_ACCELERATION_FACTOR * limits.velocity;
                assumed.push(name.as_str());
            }
            out.push(limits);
        }
        if !assumed.is_empty() {
            let message = format!(
                "no acceleration limit for {}; {DEFAULT_ACCELERATION_FACTOR} times the velocity limit per \
                 second is taken",
                assumed.join(", ")
            );
            context.faults.warn(node.pointer.clone(), FaultCode::MissingField, message);
        }
        (is_whole && context.faults.count() == before).then_some(out)
    }

    /// Notes the robots' overrides for joints that no arm of the robot has on its chain, a finger's perhaps: they say nothing.
    /// One for a joint that the robot lacks is a fault.
    fn note_unused_limits(&self, context: &mut Context<'_>) {
        for robot in self.robots.values().flatten() {
            // No arm of it could be loaded: nothing is known about its joints.
            let Some(chain) = self.chains.get(robot.name()) else { continue };
            let unused: Vec<_> = robot.limits.iter().filter(|(joint, _)| !chain.contains(*joint)).collect();
            let names = if unused.is_empty() { BTreeSet::new() } else { robot.joint_names() };
            for (joint, (_, pointer)) in unused {
                if names.contains(joint) {
                    let message = format!(
                        "no arm of this robot has the joint `{}` between its root and its mount link; its \
                         limits are passed over",
                        shown(joint)
                    );
                    context.faults.warn(pointer.clone(), FaultCode::UnknownJoint, message);
                } else {
                    context.faults.push(pointer.clone(), FaultCode::UnknownJoint, lacks_joint(joint));
                }
            }
        }
    }

    /// The pairs of bodies that may touch for good, beyond those whose groups are joined; `None` when that takes too much
    /// work to find out.
    fn exempt(
        &mut self,
        loaded: &LoadedModel,
        tool: &Tool,
        limits: &[JointLimits],
        robot: &RobotSpec,
        context: &mut Context<'_>,
    ) -> Option<Vec<BodyPair>> {
        let model = &loaded.model;
        let mut pairs: BTreeSet<BodyPair> = loaded.disabled.iter().copied().collect();
        let key = OverlapKey {
            model: Arc::clone(model),
            tool: shape_bits(&tool.shapes),
            limits: limits.to_vec(),
            exempt: pairs.iter().copied().collect(),
        };
        let found = self.overlapping(key, tool, robot, context)?;
        for (a, b) in &found {
            let message = format!(
                "{} and {} overlap in more than 95 % of 1,000 random configurations and are not checked \
                 against each other",
                a.name(model),
                b.name(model)
            );
            if self.warned.insert(format!("{} {message}", robot.name())) {
                context.faults.warn(robot.pointer(), FaultCode::InitialCollision, message);
            }
        }
        pairs.extend(found);
        Some(pairs.into_iter().collect())
    }

    /// The pairs that overlap almost always; `None`, with a fault at the first, when the document's robots
    /// take more work than they may. An answer counts once, and with its work whoever found it.
    fn overlapping(
        &mut self,
        key: OverlapKey,
        tool: &Tool,
        robot: &RobotSpec,
        context: &mut Context<'_>,
    ) -> Option<Vec<BodyPair>> {
        let left = self.work_left?;
        let most = context.limits.max_overlap_work;
        let known = self.known.filter(|known| known.keeps(&key.model));
        let mut is_new = false;
        let answer = self.own.overlapping(key.clone(), || {
            is_new = true;
            let find = || {
                let exempt = key.exempt.iter().copied().collect();
                let mut rng = Seed(0).stream("workcell/contacts");
                let (model, limits) = (&key.model, &key.limits);
                contacts::almost_always_overlapping(model, &tool.shapes, limits, &exempt, most, &mut rng)
            };
            match known {
                Some(known) => known.overlapping(key.clone(), find),
                None => find(),
            }
        });
        if is_new {
            self.work_left = answer.as_ref().ok().and_then(|found| left.checked_sub(found.work));
        }
        if self.work_left.is_none() {
            let message = format!(
                "{TooMuchWork}; disable pairs of links that touch by design in an SRDF, or give fewer and \
                 simpler collision shapes"
            );
            context.faults.push(robot.pointer(), FaultCode::TooLarge, message);
        }
        answer.ok().map(|found| found.pairs).filter(|_| self.work_left.is_some())
    }
}

/// The mount link's name and the tool; the tool is `None` when its parts are at fault.
fn read_tool<'a>(fields: &mut Fields<'a>, context: &mut Context<'_>) -> Option<(Node<'a>, Option<Tool>)> {
    let mount = fields
        .required("mount_link", &mut context.faults)
        .filter(|node| node.string(&mut context.faults).is_some());
    let tcp = optional_pose(fields, "tcp", context);
    let before = context.faults.count();
    let mut shapes = Vec::new();
    if let Some(node) = fields.optional("collision") {
        let most = context.limits.max_tool_shapes;
        for node in node.elements(&mut context.faults, "collision shapes", most) {
            let Some(mut fields) = node.fields(&mut context.faults) else { continue };
            let pose = optional_pose(&mut fields, "pose", context);
            if let (Some(node), Some(pose)) = (fields.required("shape", &mut context.faults), pose) {
                shapes.extend(read_shape(&node, pose, context).into_iter().flatten());
            }
            fields.finish(&mut context.faults);
        }
        if shapes.len() > most {
            let message = format!("{} convex pieces of meshes, at most {most} are taken", shapes.len());
            node.fault(&mut context.faults, FaultCode::TooLarge, message);
        }
    }
    let max_opening = match fields.optional("max_opening") {
        Some(node) => node.number(&mut context.faults, Range::Positive(10.0)).unwrap_or(0.10),
        None => 0.10,
    };
    let grasp_time = match fields.optional("grasp_time_s") {
        Some(node) => node.number(&mut context.faults, Range::NonNegative(60.0)).unwrap_or(0.0),
        None => 0.0,
    };
    let whole = context.faults.count() == before;
    let tool = tcp.filter(|_| whole).map(|tcp| Tool { tcp, shapes, max_opening, grasp_time });
    mount.map(|mount| (mount, tool))
}

/// Where an arm starts by `values`, each within its joint's limits; joints that these leave out stand as at home, which is
/// judged elsewhere.
pub fn start_configuration(
    arm: &Arm,
    values: &BTreeMap<String, (f64, String)>,
    context: &mut Context<'_>,
) -> Option<Config> {
    let (before, model) = (context.faults.count(), &arm.model);
    for (joint, (_, pointer)) in values {
        if model.joints.iter().all(|known| known.name != *joint) {
            context.faults.push(pointer.clone(), FaultCode::UnknownJoint, unknown_joint(joint, model));
        }
    }
    let mut out = arm.home.clone();
    for ((joint, limit), start) in model.joints.iter().zip(&arm.limits).zip(&mut out) {
        let Some((value, pointer)) = values.get(&joint.name) else { continue };
        if !(limit.lower..=limit.upper).contains(value) {
            let message = format!(
                "joint `{}` at {value} is outside its limits {} to {}; give a value inside",
                joint.name, limit.lower, limit.upper
            );
            context.faults.push(pointer.clone(), FaultCode::OutOfRange, message);
        }
        *start = *value;
    }
    (context.faults.count() == before).then_some(out)
}

fn unknown_joint(joint: &str, model: &ArmModel) -> String {
    let names: Vec<&str> = model.joints.iter().take(40).map(|joint| joint.name.as_str()).collect();
    format!("`{}` is no joint between root and mount link; those are {}", shown(joint), names.join(", "))
}
