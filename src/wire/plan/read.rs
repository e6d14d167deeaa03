//! The plan document as it is read: strictly typed, unknown fields passed over.

use std::collections::BTreeMap;

use serde_json::Value;

use super::SCHEMA;
use crate::geometry::Pose;
use crate::plan::{
    Action, ActionKind, ArmTrajectory, Metrics, Plan, StepsProof, TrajectoryPoint, Verification,
};
use crate::problem::Problem;
use crate::wire::fault::{Fault, FaultCode, Faults};
use crate::wire::json;
use crate::wire::reader::{Fields, Node, Range, shown};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// Most points of one arm's trajectory.
const MAX_POINTS: usize = 1_000_000;

/// Most actions.
const MAX_ACTIONS: usize = 100_000;

/// Most faults that are listed.
const MAX_FAULTS: usize = 200;

/// Greatest count in the metrics.
const MAX_COUNT: u64 = 1 << 32;

/// Greatest time (s).
const MAX_TIME: f64 = 1.0e7;

/// Reads a plan for `problem`. Only what the document must have to be one is checked, names and
/// types and lengths of lists; whether the plan is any good is the judge's business.
///
/// # Errors
/// All faults of the document.
pub fn read_plan(bytes: &[u8], problem: &Problem) -> Result<Plan, Vec<Fault>> {
    let document = json::parse(bytes).map_err(|fault| vec![fault])?;
    read_plan_value(&document, problem)
}

/// Reads a plan for `problem` that is parsed already.
///
/// # Errors
/// All faults of the document.
pub fn read_plan_value(document: &Value, problem: &Problem) -> Result<Plan, Vec<Fault>> {
    let mut reader = PlanReader::new(problem);
    let plan = reader.plan(document);
    reader.faults.finish()?;
    plan.ok_or_else(|| {
        vec![Fault {
            pointer: String::new(),
            code: FaultCode::WrongType,
            message: "the plan is incomplete; compare it with the format".to_owned(),
        }]
    })
}

struct PlanReader<'p> {
    problem: &'p Problem,
    arms: BTreeMap<&'p str, ArmId>,
    objects: BTreeMap<&'p str, ObjectId>,
    surfaces: BTreeMap<&'p str, SurfaceId>,
    faults: Faults,
}

impl<'p> PlanReader<'p> {
    fn new(problem: &'p Problem) -> Self {
        let cell = &problem.workcell;
        let arms = cell.arms.iter().enumerate().map(|(i, arm)| (arm.id.as_str(), ArmId(i)));
        let objects = problem.objects.iter().enumerate().map(|(i, object)| (object.id.as_str(), ObjectId(i)));
        let surfaces =
            cell.surfaces.iter().enumerate().map(|(i, surface)| (surface.id.as_str(), SurfaceId(i)));
        Self {
            problem,
            arms: arms.collect(),
            objects: objects.collect(),
            surfaces: surfaces.collect(),
            faults: Faults::new(MAX_FAULTS),
        }
    }

    fn plan(&mut self, document: &Value) -> Option<Plan> {
        let mut fields = Node::root(document).fields(&mut self.faults)?;
        if let Some(node) = fields.required("schema", &mut self.faults) {
            node.choice(&mut self.faults, &[(SCHEMA, ())]);
        }
        if let Some(node) = fields.required("schedule", &mut self.faults)
            && let Some(false) =
                node.choice(&mut self.faults, &[("synchronous", true), ("asynchronous", false)])
        {
            let message = "asynchronous schedules come in a later version";
            node.fault(&mut self.faults, FaultCode::NotImplemented, message);
        }
        let digest = self.required(&mut fields, "problem_digest", |node, faults| node.string(faults));
        let revision = self.required(&mut fields, "revision", |node, faults| node.whole(faults, 0, 1 << 53));
        let metrics = fields.required("metrics", &mut self.faults).and_then(|node| self.metrics(&node));
        let arms = fields.required("arms", &mut self.faults).and_then(|node| self.arms(&node));
        let actions = fields.required("actions", &mut self.faults).and_then(|node| self.actions(&node));
        let verification = match fields.nullable("verification") {
            Some(node) => Some(self.verification(&node)?),
            None => None,
        };
        Some(Plan {
            problem_digest: digest?.to_owned(),
            revision: revision?,
            metrics: metrics?,
            arms: arms?,
            actions: actions?,
            verification,
        })
    }

    fn required<'a, T>(
        &mut self,
        fields: &mut Fields<'a>,
        key: &'static str,
        read: impl FnOnce(&Node<'a>, &mut Faults) -> Option<T>,
    ) -> Option<T> {
        let node = fields.required(key, &mut self.faults)?;
        read(&node, &mut self.faults)
    }

    fn metrics(&mut self, node: &Node<'_>) -> Option<Metrics> {
        let faults = &mut self.faults;
        let mut fields = node.fields(faults)?;
        let time = Range::NonNegative(MAX_TIME);
        let mut figure = |key| fields.required(key, faults).and_then(|node| node.number(faults, time));
        let duration_s = figure("duration_s");
        let arc_length = figure("arc_length");
        let mut count = |key| {
            fields.required(key, faults).and_then(|node| node.whole(faults, 0, MAX_COUNT)).map(|n| n as usize)
        };
        let (actions, steps) = (count("actions"), count("steps"));
        let mut optional = |key, default| match fields.nullable(key) {
            Some(node) => node.number(faults, time),
            None => default,
        };
        let duration_synchronous_s = optional("duration_synchronous_s", duration_s);
        let found_after_s = optional("found_after_s", Some(0.0));
        let mut optional_count = |key| match fields.nullable(key) {
            Some(node) => node.whole(faults, 0, MAX_COUNT).map(|count| Some(count as usize)),
            None => Some(None),
        };
        let mode_graph_optimum = optional_count("mode_graph_optimum");
        let steps_lower_bound = optional_count("steps_lower_bound");
        let steps_proof = match fields.optional("steps_proof") {
            Some(node) => {
                let choices =
                    [("none", StepsProof::None), ("bounds", StepsProof::Bounds), ("ilp", StepsProof::Ilp)];
                node.choice(faults, &choices)
            }
            None => Some(StepsProof::None),
        };
        Some(Metrics {
            duration_s: duration_s?,
            duration_synchronous_s: duration_synchronous_s?,
            arc_length: arc_length?,
            actions: actions?,
            steps: steps?,
            mode_graph_optimum: mode_graph_optimum?,
            steps_lower_bound: steps_lower_bound?.unwrap_or(0),
            steps_proof: steps_proof?,
            found_after_s: found_after_s?,
        })
    }

    fn arms(&mut self, node: &Node<'_>) -> Option<Vec<ArmTrajectory>> {
        let count = self.problem.workcell.arms.len();
        let mut out: Vec<Option<ArmTrajectory>> = vec![None; count];
        let mut seen = vec![false; count];
        for node in node.elements(&mut self.faults, "arms", count) {
            let Some(mut fields) = node.fields(&mut self.faults) else { continue };
            let Some(id) = fields.required("id", &mut self.faults) else { continue };
            let Some(ArmId(arm)) = self.arm(&id) else { continue };
            if std::mem::replace(&mut seen[arm], true) {
                id.fault(&mut self.faults, FaultCode::DuplicateId, "this arm has a trajectory already");
                continue;
            }
            let order = fields
                .required("joint_names", &mut self.faults)
                .and_then(|node| self.joint_order(&node, arm));
            let points = fields.required("points", &mut self.faults);
            if let (Some(order), Some(points)) = (order, points) {
                out[arm] = self.points(&points, &order);
            }
        }
        for (arm, _) in seen.iter().enumerate().filter(|(_, seen)| !**seen) {
            if node.value.is_array() {
                let message =
                    format!("arm `{}` has no trajectory; add one", self.problem.workcell.arms[arm].id);
                node.fault(&mut self.faults, FaultCode::MissingField, message);
            }
        }
        out.into_iter().collect()
    }

    /// For each joint of the arm, its place in the lists of the document.
    fn joint_order(&mut self, node: &Node<'_>, arm: usize) -> Option<Vec<usize>> {
        let before = self.faults.count();
        let joints = &self.problem.workcell.arms.get(arm)?.model.joints;
        let mut order = vec![usize::MAX; joints.len()];
        for (place, node) in node.elements(&mut self.faults, "joints", joints.len()).iter().enumerate() {
            let Some(name) = node.string(&mut self.faults) else { continue };
            match joints.iter().position(|joint| joint.name == name) {
                Some(joint) if order[joint] == usize::MAX => order[joint] = place,
                Some(_) => node.fault(&mut self.faults, FaultCode::DuplicateId, "this joint is named twice"),
                None => {
                    let message = format!("the arm has no joint `{}`", shown(name));
                    node.fault(&mut self.faults, FaultCode::UnknownJoint, message);
                }
            }
        }
        if self.faults.count() == before {
            for (joint, _) in joints.iter().zip(&order).filter(|(_, place)| **place == usize::MAX) {
                let message = format!("joint `{}` is missing", joint.name);
                node.fault(&mut self.faults, FaultCode::MissingField, message);
            }
        }
        (self.faults.count() == before).then_some(order)
    }

    fn points(&mut self, node: &Node<'_>, order: &[usize]) -> Option<ArmTrajectory> {
        let before = self.faults.count();
        let mut points = Vec::new();
        for node in node.elements(&mut self.faults, "points", MAX_POINTS) {
            let Some(mut fields) = node.fields(&mut self.faults) else { continue };
            let t =
                self.required(&mut fields, "t", |node, faults| node.number(faults, Range::Within(MAX_TIME)));
            let mut list = |key| {
                let node = fields.required(key, &mut self.faults)?;
                numbers(&node, order, &mut self.faults)
            };
            let (q, qd, qdd) = (list("q"), list("qd"), list("qdd"));
            if let (Some(t), Some(q), Some(qd), Some(qdd)) = (t, q, qd, qdd) {
                points.push(TrajectoryPoint { t, q, qd, qdd });
            }
        }
        (self.faults.count() == before).then_some(ArmTrajectory { points })
    }

    fn actions(&mut self, node: &Node<'_>) -> Option<Vec<Action>> {
        let before = self.faults.count();
        let mut out = Vec::new();
        for node in node.elements(&mut self.faults, "actions", MAX_ACTIONS) {
            out.extend(self.action(&node));
        }
        (self.faults.count() == before).then_some(out)
    }

    fn action(&mut self, node: &Node<'_>) -> Option<Action> {
        let mut fields = node.fields(&mut self.faults)?;
        let step = self.required(&mut fields, "step", |node, faults| node.whole(faults, 0, MAX_COUNT));
        let t = self.required(&mut fields, "t", |node, faults| node.number(faults, Range::Within(MAX_TIME)));
        let object = fields.required("object", &mut self.faults).and_then(|node| self.object(&node));
        let arm = fields.required("arm", &mut self.faults).and_then(|node| self.arm(&node));
        let object_in_tcp = self.pose(&mut fields, "object_in_tcp");
        let kind = fields.required("kind", &mut self.faults)?;
        let kind = match kind.choice(&mut self.faults, &[("pick", 0), ("place", 1), ("handoff", 2)])? {
            0 => {
                let surface =
                    fields.required("surface", &mut self.faults).and_then(|node| self.surface(&node));
                ActionKind::Pick { arm: arm?, object_in_tcp: object_in_tcp?, surface: surface? }
            }
            1 => {
                let surface =
                    fields.required("surface", &mut self.faults).and_then(|node| self.surface(&node));
                let object_pose = self.pose(&mut fields, "object_pose");
                ActionKind::Place {
                    arm: arm?,
                    object_in_tcp: object_in_tcp?,
                    object_pose: object_pose?,
                    surface: surface?,
                }
            }
            _ => {
                let to_arm = fields.required("to_arm", &mut self.faults).and_then(|node| self.arm(&node));
                let to_object_in_tcp = self.pose(&mut fields, "to_object_in_tcp");
                ActionKind::Handoff {
                    arm: arm?,
                    to_arm: to_arm?,
                    object_in_tcp: object_in_tcp?,
                    to_object_in_tcp: to_object_in_tcp?,
                }
            }
        };
        Some(Action { step: step? as usize, t: t?, object: object?, kind })
    }

    fn verification(&mut self, node: &Node<'_>) -> Option<Verification> {
        let mut fields = node.fields(&mut self.faults)?;
        let valid = self.required(&mut fields, "valid", |node, faults| node.boolean(faults));
        let min_clearance_m = match fields.nullable("min_clearance_m") {
            Some(node) => Some(node.number(&mut self.faults, Range::Any)?),
            None => None,
        };
        let (mut at_t, mut bodies) = (0.0, None);
        if let Some(node) = fields.nullable("at") {
            let mut fields = node.fields(&mut self.faults)?;
            at_t = self.required(&mut fields, "t", |node, faults| node.number(faults, Range::Any))?;
            if let Some(node) = fields.nullable("bodies") {
                let names: Vec<Option<String>> = node
                    .elements(&mut self.faults, "bodies", 2)
                    .iter()
                    .map(|node| node.string(&mut self.faults).map(str::to_owned))
                    .collect();
                let [Some(one), Some(other)] = &names[..] else {
                    node.fault(&mut self.faults, FaultCode::WrongType, "give the names of two bodies");
                    return None;
                };
                bodies = Some([one.clone(), other.clone()]);
            }
        }
        Some(Verification { valid: valid?, min_clearance_m, at_t, bodies })
    }

    fn pose(&mut self, fields: &mut Fields<'_>, key: &'static str) -> Option<Pose> {
        self.required(fields, key, |node, faults| node.lenient_pose(faults))
    }

    fn arm(&mut self, node: &Node<'_>) -> Option<ArmId> {
        let name = node.string(&mut self.faults)?;
        let found = self.arms.get(name).copied();
        self.known(node, name, "arm", FaultCode::UnknownBody, found)
    }

    fn object(&mut self, node: &Node<'_>) -> Option<ObjectId> {
        let name = node.string(&mut self.faults)?;
        let found = self.objects.get(name).copied();
        self.known(node, name, "object", FaultCode::UnknownObject, found)
    }

    fn surface(&mut self, node: &Node<'_>) -> Option<SurfaceId> {
        let name = node.string(&mut self.faults)?;
        let found = self.surfaces.get(name).copied();
        self.known(node, name, "surface", FaultCode::UnknownSurface, found)
    }

    fn known<T>(
        &mut self,
        node: &Node<'_>,
        name: &str,
        what: &str,
        code: FaultCode,
        found: Option<T>,
    ) -> Option<T> {
        if found.is_none() {
            node.fault(&mut self.faults, code, format!("the problem has no {what} `{}`", shown(name)));
        }
        found
    }
}

/// One number per joint, brought into the arm's order. Pointers are only made for faults: there
/// are many numbers.
fn numbers(node: &Node<'_>, order: &[usize], faults: &mut Faults) -> Option<Vec<f64>> {
    let Value::Array(list) = node.value else {
        node.fault(faults, FaultCode::WrongType, "expected a list of numbers");
        return None;
    };
    if list.len() != order.len() {
        let message = format!("{} numbers for {} joints", list.len(), order.len());
        node.fault(faults, FaultCode::WrongType, message);
        return None;
    }
    let mut out = Vec::with_capacity(order.len());
    for place in order {
        match list.get(*place).and_then(Value::as_f64).filter(|value| value.is_finite()) {
            Some(value) => out.push(value),
            None => {
                faults.push(format!("{}/{place}", node.pointer), FaultCode::WrongType, "expected a number");
                return None;
            }
        }
    }
    Some(out)
}
