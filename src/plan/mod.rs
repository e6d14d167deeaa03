//! A plan: one trajectory per arm on a shared clock, and the actions along it.

mod from_curve;

use crate::geometry::Pose;
use crate::problem::Objective;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// One breakpoint of an arm's trajectory. Between breakpoints the motion is the cubic Hermite
/// interpolant of (q, qd).
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectoryPoint {
    /// Seconds since the plan's start.
    pub t: f64,
    /// Joint values (rad or m).
    pub q: Vec<f64>,
    /// Joint velocities.
    pub qd: Vec<f64>,
    /// Joint accelerations of the curve just after the point.
    pub qdd: Vec<f64>,
}

/// An arm's trajectory: at least two points, the first at 0, the last at the plan's duration,
/// strictly increasing and at least 1 ms apart, at rest at both ends.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ArmTrajectory {
    /// The breakpoints.
    pub points: Vec<TrajectoryPoint>,
}

/// What happens to an object at one instant.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionKind {
    /// `arm` takes the object from `surface`.
    Pick {
        /// Who picks.
        arm: ArmId,
        /// The object's frame in the arm's TCP frame from now on.
        object_in_tcp: Pose,
        /// Where it stood.
        surface: SurfaceId,
    },
    /// `arm` puts the object on `surface`.
    Place {
        /// Who places.
        arm: ArmId,
        /// The object's frame in the arm's TCP frame until now.
        object_in_tcp: Pose,
        /// The object's frame in the world from now on.
        object_pose: Pose,
        /// Where it stands.
        surface: SurfaceId,
    },
    /// `arm` gives the object to `to_arm`.
    Handoff {
        /// Who gives.
        arm: ArmId,
        /// Who receives.
        to_arm: ArmId,
        /// The object's frame in the giver's TCP frame until now.
        object_in_tcp: Pose,
        /// The object's frame in the receiver's TCP frame from now on.
        to_object_in_tcp: Pose,
    },
}

/// An action: the attachment of one object changes at `t`.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// The synchronised step that it ends, from 1.
    pub step: usize,
    /// Seconds since the plan's start.
    pub t: f64,
    /// The object.
    pub object: ObjectId,
    /// What happens.
    pub kind: ActionKind,
}

/// How the step counts were proved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepsProof {
    /// Not proved.
    None,
    /// Lower bound and a found solution meet.
    Bounds,
    /// An integer program closed the gap.
    Ilp,
}

/// A plan's figures, as FORMAT.md defines them.
#[derive(Debug, Clone, PartialEq)]
pub struct Metrics {
    /// Duration (s).
    pub duration_s: f64,
    /// Duration of the synchronous schedule that it came from (s).
    pub duration_synchronous_s: f64,
    /// The largest over the arms of the Euclidean length of its joint path.
    pub arc_length: f64,
    /// Picks, places and handoffs.
    pub actions: usize,
    /// Synchronised steps with at least one action.
    pub steps: usize,
    /// The proved optimum on the mode graph that guided, if proved.
    pub mode_graph_optimum: Option<usize>,
    /// Lower bound over all synchronised plans with the given grasps.
    pub steps_lower_bound: usize,
    /// How `mode_graph_optimum` was proved.
    pub steps_proof: StepsProof,
    /// When the verified plan was published (s since the run's start).
    pub found_after_s: f64,
}

impl Metrics {
    /// The cost under `objective`: what comes first counts first, and less is better.
    pub fn cost(&self, objective: Objective) -> [f64; 2] {
        objective.cost(self.duration_s, self.arc_length, self.steps)
    }
}

/// What the judge said of the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Verification {
    /// Whether it breaks no rule.
    pub valid: bool,
    /// Least signed distance over the whole time (m), exempt pairs left out; `None` when there is
    /// no pair to look at.
    pub min_clearance_m: Option<f64>,
    /// When that is (s).
    pub at_t: f64,
    /// Between which bodies, by FORMAT.md's body names.
    pub bodies: Option<[String; 2]>,
}

/// A plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Digest of the problem that it solves.
    pub problem_digest: String,
    /// Counts the incumbents of a run, from 1.
    pub revision: u64,
    /// Its figures.
    pub metrics: Metrics,
    /// One trajectory per arm, in the workcell's order.
    pub arms: Vec<ArmTrajectory>,
    /// Actions sorted by time.
    pub actions: Vec<Action>,
    /// The judge's word.
    pub verification: Option<Verification>,
}
