//! Reading a problem document: every fault at once, or a [`Problem`] that the planner may rely on.

mod arm;
mod bodies;
mod checks;
mod context;
mod draft;
mod homes;
mod known_robots;
mod limits;
mod meshes;
mod models;
mod object;
mod options;
mod packing;
mod placement;
mod robot;
mod shape;
mod statics;
mod triangles;
mod unused_robots;
mod urdf_names;

pub use known_robots::KnownRobots;
pub use limits::ReadLimits;

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::Value;

use self::context::Context;
use self::draft::Draft;
use self::homes::StatedHomes;
use super::digest::Digests;
use super::fault::{Fault, FaultCode};
use super::json;
use super::reader::{Fields, Node};
use super::resources::Resources;
use crate::problem::{Options, Problem};
use crate::workcell::{Arm, Workcell};

/// The schema that this version reads.
pub const SCHEMA: &str = "quadrille.problem/1";

/// The opening of FORMAT's default gripper (m), for cells whose arms could not be read.
const DEFAULT_OPENING: f64 = 0.10;

/// A problem, and what its author should know.
#[derive(Debug, Clone)]
pub struct ReadProblem {
    /// The problem.
    pub problem: Problem,
    /// What was assumed or decided on the way.
    pub warnings: Vec<Fault>,
}

/// Reads and validates a problem document.
///
/// # Errors
/// All faults of the document.
pub fn read_problem(
    bytes: &[u8],
    resources: &dyn Resources,
    limits: &ReadLimits,
) -> Result<ReadProblem, Vec<Fault>> {
    if bytes.len() > limits.max_bytes {
        return Err(vec![Fault {
            pointer: String::new(),
            code: FaultCode::TooLarge,
            message: format!(
                "{} bytes, at most {} are taken; split the problem",
                bytes.len(),
                limits.max_bytes
            ),
        }]);
    }
    let document = json::parse_bounded(bytes, limits.max_json_depth).map_err(|fault| vec![fault])?;
    read_problem_value(&document, resources, limits)
}

/// Reads and validates a problem document that is parsed already.
///
/// # Errors
/// All faults of the document.
pub fn read_problem_value(
    document: &Value,
    resources: &dyn Resources,
    limits: &ReadLimits,
) -> Result<ReadProblem, Vec<Fault>> {
    read_with(document, Context::new(resources, limits))
}

/// As [`read_problem_value`], for a document that was put around a workcell: nobody says where its arms start. Of their homes
/// only what the workcell gives has to be right; an arm without one stands somewhere.
///
/// # Errors
/// All faults of the document.
pub fn read_around_workcell(
    document: &Value,
    resources: &dyn Resources,
    limits: &ReadLimits,
) -> Result<ReadProblem, Vec<Fault>> {
    let mut context = Context::new(resources, limits);
    context.bare = true;
    read_with(document, context)
}

fn read_with(document: &Value, mut context: Context<'_>) -> Result<ReadProblem, Vec<Fault>> {
    let problem = read_document(document, &mut context);
    let warnings = std::mem::take(&mut context.faults).finish()?;
    match problem {
        Some(problem) => Ok(ReadProblem { problem, warnings }),
        // Nothing is at fault only if everything could be read.
        None => Err(vec![Fault {
            pointer: String::new(),
            code: FaultCode::WrongType,
            message: "the document is incomplete; compare it with the format".to_owned(),
        }]),
    }
}

fn read_document(document: &Value, context: &mut Context<'_>) -> Option<Problem> {
    let mut fields = Node::root(document).fields(&mut context.faults)?;
    if let Some(node) = fields.required("schema", &mut context.faults) {
        node.choice(&mut context.faults, &[(SCHEMA, ())]);
    }
    let name = placement::read_name(fields.optional("name"), context);
    let workcell = fields.required("workcell", &mut context.faults);
    let workcell = workcell.and_then(|node| node.fields(&mut context.faults));
    let objects = fields.required("objects", &mut context.faults);
    let options = match fields.optional("options") {
        Some(node) => options::read_options(&node, context.limits, &mut context.faults),
        None => Options { time_budget_s: context.limits.default_time_budget_s, ..Options::default() },
    };
    let mut draft = read_parts(workcell, objects, options, &mut fields, context);
    fields.finish(&mut context.faults);
    let checks::Checked { initial, goal, homes } = checks::check(&draft, context);
    if !context.faults.is_empty() {
        return None;
    }
    let Some(digests) = Digests::of(document, &context.contents) else {
        let message = "the document has no canonical form; use ordinary numbers and text";
        context.faults.push("", FaultCode::InvalidJson, message);
        return None;
    };
    for (arm, home) in draft.arms.iter_mut().zip(&homes) {
        if let (Some(arm), Some(home)) = (arm, home) {
            arm.home.clone_from(home);
        }
    }
    let workcell = Workcell {
        arms: whole(draft.arms)?,
        obstacles: whole(draft.obstacles)?,
        surfaces: whole(draft.surfaces)?,
        allowed_arm_obstacle: draft.allowed.arm_obstacle.into_iter().collect(),
        allowed_arm_arm: draft.allowed.arm_arm.into_iter().collect(),
    };
    Some(Problem {
        name,
        digest: digests.problem,
        workcell_digest: homes::digest_with(digests.workcell, &homes),
        workcell: Arc::new(workcell),
        objects: whole(draft.objects)?,
        initial: whole(initial)?,
        goal: whole(goal)?,
        initial_joints: whole(draft.starts)?.into_iter().map(|(config, _)| config).collect(),
        allowed_object_contacts: draft.allowed.object.into_iter().collect(),
        options: draft.options,
    })
}

/// All elements, if all are there.
fn whole<T>(list: Vec<Option<T>>) -> Option<Vec<T>> {
    list.into_iter().collect()
}

fn read_parts(
    workcell: Option<Fields<'_>>,
    objects: Option<Node<'_>>,
    options: Options,
    fields: &mut Fields<'_>,
    context: &mut Context<'_>,
) -> Draft {
    let mut allowed_contacts = None;
    let (mut robots, mut arms, mut obstacles, mut surfaces) = (None, None, None, None);
    if let Some(mut workcell) = workcell {
        robots = workcell.required("robots", &mut context.faults);
        arms = workcell.required("arms", &mut context.faults);
        obstacles = workcell.optional("obstacles");
        surfaces = workcell.optional("surfaces");
        allowed_contacts = workcell.optional("allowed_contacts");
        workcell.finish(&mut context.faults);
    }
    let robots = if robots.is_some() { robot::read_robots(robots, context) } else { BTreeMap::new() };
    let obstacles = statics::read_obstacles(obstacles, context);
    let surfaces = statics::read_surfaces(surfaces, context);
    let homes = StatedHomes::of(arms.as_ref());
    let mut arms = arm::read_arms(arms, &robots, context);
    let max_opening = widest_opening(&arms);
    let ids_of = objects.as_ref().and_then(|node| node.value.as_array());
    let objects = object::read_objects(objects.clone(), max_opening, context);
    let ids: Vec<Option<&str>> = match ids_of {
        Some(list) if list.len() == objects.len() => {
            list.iter().map(|object| object.get("id").and_then(Value::as_str)).collect()
        }
        _ => vec![None; objects.len()],
    };
    let allowed = statics::read_allowed_contacts(allowed_contacts, &arms, context);
    for (index, arm) in arms.iter_mut().enumerate() {
        let Some(arm) = arm else { continue };
        if let Some(own) = allowed.within_arm.get(&index) {
            arm.exempt_bodies.extend(own);
            arm.exempt_bodies.sort_unstable();
            arm.exempt_bodies.dedup();
        }
    }
    let initial = fields.required("initial", &mut context.faults);
    let initial = placement::read_initial(initial, &ids, context);
    let goal = placement::read_goal(fields.optional("goal"), objects.len(), context);
    let mut starts = placement::read_initial_joints(fields.optional("initial_joints"), &arms, context);
    let assumed = homes::settle(&mut arms, &mut starts, &homes, options.return_home, context);
    Draft { arms, homes, assumed, obstacles, surfaces, allowed, objects, initial, goal, starts, options }
}

/// The opening (m) of the widest gripper.
fn widest_opening(arms: &[Option<Arm>]) -> f64 {
    let widest = arms.iter().flatten().map(|arm| arm.tool.max_opening).fold(0.0_f64, f64::max);
    if widest > 0.0 { widest } else { DEFAULT_OPENING }
}

#[cfg(test)]
mod tests;
