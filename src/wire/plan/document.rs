//! The plan document as it is written.

use serde::Serialize;

use super::{MetricsDocument, SCHEMA};
use crate::plan::{Action, ActionKind, ArmTrajectory, Plan, TrajectoryPoint, Verification};
use crate::problem::Problem;
use crate::wire::pose::PoseDocument;
use crate::workcell::{Arm, ArmId, ObjectId, SurfaceId};

/// A plan (FORMAT "Plan").
#[derive(Debug, Clone, Serialize)]
pub struct PlanDocument<'a> {
    /// `quadrille.plan/1`.
    pub schema: &'static str,
    /// Digest of the problem.
    pub problem_digest: &'a str,
    /// Counts the incumbents of a run, from 1.
    pub revision: u64,
    /// `synchronous`.
    pub schedule: &'static str,
    /// Its figures.
    pub metrics: MetricsDocument,
    /// One trajectory per arm.
    pub arms: Vec<ArmDocument<'a>>,
    /// Actions sorted by time.
    pub actions: Vec<ActionDocument<'a>>,
    /// The judge's word, if it was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verification: Option<VerificationDocument<'a>>,
}

/// An arm's trajectory.
#[derive(Debug, Clone, Serialize)]
pub struct ArmDocument<'a> {
    /// The arm's id.
    pub id: &'a str,
    /// The joints, in the order of the points' lists.
    pub joint_names: Vec<&'a str>,
    /// The breakpoints.
    pub points: Vec<PointDocument<'a>>,
}

/// A breakpoint.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PointDocument<'a> {
    /// Time (s).
    pub t: f64,
    /// Joint values.
    pub q: &'a [f64],
    /// Joint velocities.
    pub qd: &'a [f64],
    /// Joint accelerations just after.
    pub qdd: &'a [f64],
}

/// An action.
#[derive(Debug, Clone, Serialize)]
pub struct ActionDocument<'a> {
    /// Its place in the list, from 0.
    pub id: usize,
    /// The step that it ends.
    pub step: usize,
    /// Time (s).
    pub t: f64,
    /// `pick`, `place` or `handoff`.
    pub kind: &'static str,
    /// The object's id.
    pub object: &'a str,
    /// Who picks, places or gives.
    pub arm: &'a str,
    /// Who receives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to_arm: Option<&'a str>,
    /// The object in the hand of `arm`.
    pub object_in_tcp: PoseDocument,
    /// The object in the hand of `to_arm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to_object_in_tcp: Option<PoseDocument>,
    /// Where a placed object stands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_pose: Option<PoseDocument>,
    /// What a picked or placed object stands on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<&'a str>,
}

/// What the judge said.
#[derive(Debug, Clone, Serialize)]
pub struct VerificationDocument<'a> {
    /// Whether the plan breaks no rule.
    pub valid: bool,
    /// Least distance over the whole time (m), or null when there is no pair to look at.
    pub min_clearance_m: Option<f64>,
    /// When and between which bodies that is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<WitnessDocument<'a>>,
}

/// When and between which bodies the least distance is.
#[derive(Debug, Clone, Serialize)]
pub struct WitnessDocument<'a> {
    /// Time (s).
    pub t: f64,
    /// The bodies.
    pub bodies: &'a [String; 2],
}

impl<'a> PlanDocument<'a> {
    /// The document of `plan`, which solves `problem`.
    pub fn new(problem: &'a Problem, plan: &'a Plan) -> Self {
        let arms = &problem.workcell.arms;
        Self {
            schema: SCHEMA,
            problem_digest: &plan.problem_digest,
            revision: plan.revision,
            schedule: "synchronous",
            metrics: MetricsDocument::from(&plan.metrics),
            arms: arms.iter().zip(&plan.arms).map(|(arm, way)| ArmDocument::new(arm, way)).collect(),
            actions: plan
                .actions
                .iter()
                .enumerate()
                .map(|(id, action)| ActionDocument::new(problem, id, action))
                .collect(),
            verification: plan.verification.as_ref().map(VerificationDocument::new),
        }
    }
}

impl<'a> ArmDocument<'a> {
    fn new(arm: &'a Arm, trajectory: &'a ArmTrajectory) -> Self {
        let point = |point: &'a TrajectoryPoint| PointDocument {
            t: point.t,
            q: &point.q,
            qd: &point.qd,
            qdd: &point.qdd,
        };
        Self {
            id: &arm.id,
            joint_names: arm.model.joints.iter().map(|joint| joint.name.as_str()).collect(),
            points: trajectory.points.iter().map(point).collect(),
        }
    }
}

impl<'a> ActionDocument<'a> {
    fn new(problem: &'a Problem, id: usize, action: &Action) -> Self {
        let arm_name = |ArmId(arm)| problem.workcell.arms.get(arm).map_or("", |arm| arm.id.as_str());
        let surface_name =
            |SurfaceId(index)| problem.workcell.surfaces.get(index).map_or("", |surface| surface.id.as_str());
        let ObjectId(object) = action.object;
        let object = problem.objects.get(object).map_or("", |object| object.id.as_str());
        let (kind, arm, object_in_tcp) = match &action.kind {
            ActionKind::Pick { arm, object_in_tcp, .. } => ("pick", *arm, object_in_tcp),
            ActionKind::Place { arm, object_in_tcp, .. } => ("place", *arm, object_in_tcp),
            ActionKind::Handoff { arm, object_in_tcp, .. } => ("handoff", *arm, object_in_tcp),
        };
        let mut document = Self {
            id,
            step: action.step,
            t: action.t,
            kind,
            object,
            arm: arm_name(arm),
            to_arm: None,
            object_in_tcp: PoseDocument::from(object_in_tcp),
            to_object_in_tcp: None,
            object_pose: None,
            surface: None,
        };
        match &action.kind {
            ActionKind::Pick { surface, .. } => document.surface = Some(surface_name(*surface)),
            ActionKind::Place { object_pose, surface, .. } => {
                document.object_pose = Some(PoseDocument::from(object_pose));
                document.surface = Some(surface_name(*surface));
            }
            ActionKind::Handoff { to_arm, to_object_in_tcp, .. } => {
                document.to_arm = Some(arm_name(*to_arm));
                document.to_object_in_tcp = Some(PoseDocument::from(to_object_in_tcp));
            }
        }
        document
    }
}

impl<'a> VerificationDocument<'a> {
    fn new(verification: &'a Verification) -> Self {
        let at = verification.bodies.as_ref().map(|bodies| WitnessDocument { t: verification.at_t, bodies });
        Self { valid: verification.valid, min_clearance_m: verification.min_clearance_m, at }
    }
}
