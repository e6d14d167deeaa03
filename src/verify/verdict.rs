//! What the judge says: violations, clearance, recomputed figures.

use std::fmt;

use serde::{Serialize, Serializer};

use crate::plan::Verification;

/// The rules of a plan, each with a stable code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// The plan names another problem.
    ProblemDigest,
    /// More points, actions or seconds than the judge takes on.
    TooLarge,
    /// Trajectories, joints or ids do not fit the workcell.
    Shape,
    /// A number is not finite, beyond any sense, or a quaternion is not of unit length.
    BadNumber,
    /// Times of an arm's points: first 0, strictly increasing, at least 1 ms apart.
    PointTimes,
    /// An arm's last point is not at the plan's duration.
    Duration,
    /// An arm does not start at its initial joints.
    Start,
    /// An arm is not at rest at the first or last point.
    RestAtEnds,
    /// A joint leaves its range.
    PositionLimit,
    /// A joint is too fast.
    VelocityLimit,
    /// A joint accelerates too hard.
    AccelerationLimit,
    /// A point's `qdd` is not the curve's second derivative.
    AccelerationValue,
    /// Actions are not sorted by time, or lie outside of the plan.
    ActionTime,
    /// Steps do not count from 1 without gaps.
    StepNumber,
    /// Actions of one step do not share one time, or two steps do.
    StepTime,
    /// An arm takes part in two actions of one step.
    ArmTwiceInStep,
    /// An object takes part in two actions of one step.
    ObjectTwiceInStep,
    /// An arm moves at an action of its own.
    RestAtAction,
    /// An arm moves on before the gripper has closed or opened.
    Dwell,
    /// What is picked does not stand on that surface.
    PickState,
    /// An arm that shall take an object holds one.
    HandFull,
    /// An arm that shall release an object does not hold it.
    HandEmpty,
    /// The stated object pose in the tool frame is not the real one.
    GraspPose,
    /// The grasp is none of the object's grasps.
    UnknownGrasp,
    /// The object pose stated at a place is not the real one.
    PlacePose,
    /// A released object does not rest on the surface.
    Resting,
    /// A surface holds more objects than its capacity.
    Capacity,
    /// The way to a grasp or release is not straight.
    Approach,
    /// The way from a grasp or release is not straight.
    Retreat,
    /// The giver moves while the receiver approaches.
    GiverMoves,
    /// The receiver moves while the giver retreats.
    ReceiverMoves,
    /// Two bodies overlap.
    Collision,
    /// Two bodies come so close that no contact cannot be shown.
    CollisionUndecided,
    /// An object is not where it shall be.
    Goal,
    /// An arm is not home in the end.
    ReturnHome,
    /// A stated figure is not the real one.
    Metrics,
}

impl Rule {
    /// The rule's stable name on the wire.
    pub fn code(self) -> &'static str {
        match self {
            Rule::ProblemDigest => "problem_digest",
            Rule::TooLarge => "too_large",
            Rule::Shape => "shape",
            Rule::BadNumber => "bad_number",
            Rule::PointTimes => "point_times",
            Rule::Duration => "duration",
            Rule::Start => "start",
            Rule::RestAtEnds => "rest_at_ends",
            Rule::PositionLimit => "position_limit",
            Rule::VelocityLimit => "velocity_limit",
            Rule::AccelerationLimit => "acceleration_limit",
            Rule::AccelerationValue => "acceleration_value",
            Rule::ActionTime => "action_time",
            Rule::StepNumber => "step_number",
            Rule::StepTime => "step_time",
            Rule::ArmTwiceInStep => "arm_twice_in_step",
            Rule::ObjectTwiceInStep => "object_twice_in_step",
            Rule::RestAtAction => "rest_at_action",
            Rule::Dwell => "dwell",
            Rule::PickState => "pick_state",
            Rule::HandFull => "hand_full",
            Rule::HandEmpty => "hand_empty",
            Rule::GraspPose => "grasp_pose",
            Rule::UnknownGrasp => "unknown_grasp",
            Rule::PlacePose => "place_pose",
            Rule::Resting => "resting",
            Rule::Capacity => "capacity",
            Rule::Approach => "approach",
            Rule::Retreat => "retreat",
            Rule::GiverMoves => "giver_moves",
            Rule::ReceiverMoves => "receiver_moves",
            Rule::Collision => "collision",
            Rule::CollisionUndecided => "collision_undecided",
            Rule::Goal => "goal",
            Rule::ReturnHome => "return_home",
            Rule::Metrics => "metrics",
        }
    }

    /// The unit of [`Violation::amount`].
    pub fn unit(self) -> &'static str {
        match self {
            Rule::PointTimes | Rule::Duration | Rule::ActionTime | Rule::StepTime => "s",
            Rule::RestAtEnds | Rule::RestAtAction | Rule::Dwell => "rad/s or m/s",
            Rule::GiverMoves | Rule::ReceiverMoves | Rule::VelocityLimit => "rad/s or m/s",
            Rule::AccelerationLimit | Rule::AccelerationValue => "rad/s^2 or m/s^2",
            Rule::Start | Rule::ReturnHome | Rule::PositionLimit => "rad or m",
            Rule::GraspPose | Rule::UnknownGrasp | Rule::PlacePose | Rule::Goal => "m",
            Rule::Resting | Rule::Approach | Rule::Retreat => "m",
            Rule::Collision | Rule::CollisionUndecided => "m",
            _ => "",
        }
    }

    /// How grave a violation is as such: whatever makes the plan unreadable stands above contact,
    /// contact above a broken logic, and that above a limit that is exceeded.
    fn gravity(self) -> u8 {
        match self {
            Rule::ProblemDigest | Rule::TooLarge | Rule::Shape | Rule::BadNumber | Rule::PointTimes => 4,
            Rule::Collision => 3,
            Rule::CollisionUndecided
            | Rule::PositionLimit
            | Rule::VelocityLimit
            | Rule::AccelerationLimit
            | Rule::AccelerationValue
            | Rule::Approach
            | Rule::Retreat => 1,
            Rule::Metrics => 0,
            _ => 2,
        }
    }
}

impl Serialize for Rule {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.code())
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.code())
    }
}

/// One broken rule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Violation {
    /// Which rule.
    pub rule: Rule,
    /// When it is first broken (s); `None` where it has no time.
    pub t: Option<f64>,
    /// The bodies, arms or objects concerned, by FORMAT.md's body names.
    pub bodies: Vec<String>,
    /// By how much, in [`Rule::unit`]: for contacts the greatest depth found, elsewhere what
    /// exceeds the rule's bound. 0 where there is no measure.
    pub amount: f64,
    /// One sentence for people.
    pub message: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.rule)?;
        if let Some(t) = self.t {
            write!(f, " at t={t:.3} s")?;
        }
        if !self.bodies.is_empty() {
            write!(f, " ({})", self.bodies.join(", "))?;
        }
        write!(f, ": {}", self.message)
    }
}

/// The least distance that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Clearance {
    /// Signed distance (m).
    pub distance_m: f64,
    /// When (s).
    pub t: f64,
    /// Between which bodies.
    pub bodies: [String; 2],
}

/// A plan's figures, computed anew from its curve and actions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// Duration (s).
    pub duration_s: f64,
    /// The largest over the arms of the Euclidean length of its joint path.
    pub arc_length: f64,
    /// Picks, places and handoffs.
    pub actions: usize,
    /// Steps with at least one action.
    pub steps: usize,
}

/// The judge's answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether the plan breaks no rule.
    pub valid: bool,
    /// The earliest violation; those without a time come first.
    pub first: Option<Violation>,
    /// The gravest violation: the deepest contact, unless the plan is unreadable.
    pub worst: Option<Violation>,
    /// Violations in the order of their times, at most [`Verdict::MAX_VIOLATIONS`].
    pub violations: Vec<Violation>,
    /// How many violations were found in all.
    pub violation_count: usize,
    /// The least distance found over pairs that FORMAT.md counts; `None` without such a pair, or
    /// when the plan is unreadable. True to 1 mm: no instant is closer than this by more.
    pub min_clearance: Option<Clearance>,
    /// The figures, unless the plan is unreadable.
    pub metrics: Option<Figures>,
}

impl Verdict {
    /// The most violations that are listed.
    pub const MAX_VIOLATIONS: usize = 100;

    /// The word that goes into the plan.
    pub fn verification(&self) -> Verification {
        Verification {
            valid: self.valid,
            min_clearance_m: self.min_clearance.as_ref().map(|c| c.distance_m),
            at_t: self.min_clearance.as_ref().map_or(0.0, |c| c.t),
            bodies: self.min_clearance.as_ref().map(|c| c.bodies.clone()),
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.valid {
            writeln!(f, "valid")?;
        } else {
            let plural = if self.violation_count == 1 { "" } else { "s" };
            writeln!(f, "invalid: {} violation{plural}", self.violation_count)?;
            if let Some(first) = &self.first {
                writeln!(f, "first: {first}")?;
            }
            if let Some(worst) = self.worst.as_ref().filter(|worst| Some(*worst) != self.first.as_ref()) {
                writeln!(f, "worst: {worst}")?;
            }
            for violation in self.violations.iter().skip(1) {
                writeln!(f, "  {violation}")?;
            }
            if self.violation_count > self.violations.len() {
                writeln!(f, "  and {} more", self.violation_count - self.violations.len())?;
            }
        }
        if let Some(metrics) = &self.metrics {
            writeln!(
                f,
                "duration {:.3} s, arc length {:.3}, {} actions in {} steps",
                metrics.duration_s, metrics.arc_length, metrics.actions, metrics.steps
            )?;
        }
        if let Some(clearance) = &self.min_clearance {
            writeln!(
                f,
                "least clearance {:.1} mm at t={:.3} s between {} and {}",
                clearance.distance_m * 1e3,
                clearance.t,
                clearance.bodies[0],
                clearance.bodies[1]
            )?;
        }
        Ok(())
    }
}

/// Collects violations; keeps a bounded number in memory.
#[derive(Debug, Default)]
pub(super) struct Report {
    violations: Vec<Violation>,
    worst: Option<Violation>,
    first: Option<Violation>,
    count: usize,
}

/// Whether a value exceeds its bound, or is not a number at all.
pub(super) fn beyond(value: f64, bound: f64) -> bool {
    value.is_nan() || value > bound
}

/// The order in time; what has no time comes first.
fn time_key(violation: &Violation) -> f64 {
    violation.t.unwrap_or(f64::NEG_INFINITY)
}

impl Report {
    /// Adds a violation.
    pub(super) fn add(
        &mut self,
        rule: Rule,
        t: Option<f64>,
        bodies: &[&str],
        amount: f64,
        message: impl Into<String>,
    ) {
        let bodies = bodies.iter().map(|body| (*body).to_owned()).collect();
        let violation = Violation { rule, t, bodies, amount, message: message.into() };
        self.count += 1;
        let graver = self.worst.as_ref().is_none_or(|worst| {
            (rule.gravity(), amount) > (worst.rule.gravity(), worst.amount)
                || (rule.gravity() == worst.rule.gravity() && worst.amount.is_nan())
        });
        if graver {
            self.worst = Some(violation.clone());
        }
        if self.first.as_ref().is_none_or(|first| time_key(&violation) < time_key(first)) {
            self.first = Some(violation.clone());
        }
        // Room for more than are listed, so that the earliest are likely among them.
        if self.violations.len() < 10 * Verdict::MAX_VIOLATIONS {
            self.violations.push(violation);
        }
    }

    /// The verdict.
    pub(super) fn conclude(mut self, min_clearance: Option<Clearance>, metrics: Option<Figures>) -> Verdict {
        self.violations.sort_by(|a, b| time_key(a).total_cmp(&time_key(b)));
        self.violations.truncate(Verdict::MAX_VIOLATIONS);
        Verdict {
            valid: self.count == 0,
            first: self.first,
            worst: self.worst,
            violations: self.violations,
            violation_count: self.count,
            min_clearance,
            metrics,
        }
    }
}
