//! Where every object is over time, from the initial arrangement through the actions, and whether
//! each action fits what is there.
//!
//! An object follows its real pose: what it was in the tool frame when it was taken, not what the
//! plan states, so that nothing jumps within a tolerance.

use nalgebra::{Rotation3, UnitQuaternion};

use super::arms::Arms;
use super::gap::Frame;
use super::motion_limits::REST_SPEED;
use super::structure::SAME_TIME;
use super::verdict::{Report, Rule, beyond};
use crate::geometry::{Pose, Vec3};
use crate::plan::{Action, ActionKind, Plan};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::workcell::{ArmId, ObjectId, ObjectModel, RestFault, SurfaceId, Symmetry, rests_on};

/// How far a stated pose may be from the real one (m).
const POSITION_TOLERANCE: f64 = 1e-3;
/// How far it may be turned from it (rad): 0.5 degrees.
const ANGLE_TOLERANCE: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Who has an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Custody {
    /// It rests in the world.
    Resting {
        /// The object's frame in the world.
        frame: Frame,
        /// The surface under it.
        surface: SurfaceId,
    },
    /// An arm holds it.
    Held {
        /// The arm.
        arm: ArmId,
        /// The object's frame in the TCP frame.
        grip: Frame,
    },
}

/// Where one object is from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spell {
    /// Since when (s).
    pub from: f64,
    /// Where.
    pub custody: Custody,
}

/// An action that took effect, with the arms' tool frames at it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Event<'p> {
    pub action: &'p Action,
    /// Whether the state allowed it.
    pub effective: bool,
}

/// Where every object is over time.
#[derive(Debug, Clone)]
pub(super) struct Timeline<'p> {
    /// By object, in the order of time; never empty.
    pub spells: Vec<Vec<Spell>>,
    /// The actions in order.
    pub events: Vec<Event<'p>>,
}

impl Timeline<'_> {
    /// Where `object` is at `t`, the later of two at a change.
    pub(super) fn at(&self, object: usize, t: f64) -> Custody {
        let spells = &self.spells[object];
        let after = spells.partition_point(|spell| spell.from <= t);
        spells[after.saturating_sub(1)].custody
    }
}

/// The arms of an action: who has the object before or gives it, and who has it after.
pub(super) fn hands(kind: &ActionKind) -> [Option<ArmId>; 2] {
    match kind {
        ActionKind::Pick { arm, .. } | ActionKind::Place { arm, .. } => [Some(*arm), None],
        ActionKind::Handoff { arm, to_arm, .. } => [Some(*arm), Some(*to_arm)],
    }
}

/// The order of steps and times.
pub(super) fn check_steps(problem: &Problem, plan: &Plan, report: &mut Report) {
    let mut before: Option<&Action> = None;
    for (index, action) in plan.actions.iter().enumerate() {
        let last = before.map_or(0, |before| before.step);
        if action.step == 0 || action.step < last || action.step > last + 1 {
            let message = format!("action {index} is of step {} after step {last}", action.step);
            report.add(Rule::StepNumber, Some(action.t), &[], 0.0, message);
        } else if let Some(before) = before {
            let apart = action.t - before.t;
            if action.step == before.step && apart > SAME_TIME {
                let message = format!("actions of step {last} are {apart} s apart");
                report.add(Rule::StepTime, Some(action.t), &[], apart, message);
            } else if action.step != before.step && apart <= SAME_TIME {
                let message = format!("steps {last} and {} end at one time", action.step);
                report.add(Rule::StepTime, Some(action.t), &[], 0.0, message);
            }
        }
        before = Some(action);
    }
    for step in plan.actions.chunk_by(|a, b| a.step == b.step) {
        for (index, action) in step.iter().enumerate() {
            let earlier = &step[..index];
            let taken = |arm: &ArmId| earlier.iter().any(|before| hands(&before.kind).contains(&Some(*arm)));
            if let Some(arm) = hands(&action.kind).into_iter().flatten().find(taken) {
                let id = problem.workcell.arms[arm.0].id.as_str();
                let message = format!("the arm takes part in two actions of step {}", action.step);
                report.add(Rule::ArmTwiceInStep, Some(action.t), &[id], 0.0, message);
            }
            if earlier.iter().any(|before| before.object == action.object) {
                let id = problem.objects[action.object.0].id.as_str();
                let message = format!("the object takes part in two actions of step {}", action.step);
                report.add(Rule::ObjectTwiceInStep, Some(action.t), &[id], 0.0, message);
            }
        }
    }
}

/// Follows the objects through the actions.
pub(super) fn follow<'p>(
    problem: &Problem,
    plan: &'p Plan,
    arms: &mut Arms,
    report: &mut Report,
) -> Timeline<'p> {
    let mut spells: Vec<Vec<Spell>> = Vec::with_capacity(problem.objects.len());
    for placement in &problem.initial {
        let custody = match placement {
            InitialPlacement::Resting { pose, surface } => {
                Custody::Resting { frame: Frame::of(pose), surface: *surface }
            }
            InitialPlacement::Held { arm, object_in_tcp } => {
                Custody::Held { arm: *arm, grip: Frame::of(object_in_tcp) }
            }
        };
        spells.push(vec![Spell { from: 0.0, custody }]);
    }
    let mut state = State { problem, spells, arms, report };
    let mut events = Vec::with_capacity(plan.actions.len());
    for step in plan.actions.chunk_by(|a, b| a.step == b.step) {
        state.check_capacity(step);
        for action in step {
            state.check_rest(action);
            let effective = state.apply(action);
            events.push(Event { action, effective });
        }
    }
    let State { spells, .. } = state;
    Timeline { spells, events }
}

struct State<'a> {
    problem: &'a Problem,
    spells: Vec<Vec<Spell>>,
    arms: &'a mut Arms,
    report: &'a mut Report,
}

impl State<'_> {
    fn object(&self, id: ObjectId) -> &ObjectModel {
        &self.problem.objects[id.0]
    }

    fn custody(&self, id: ObjectId) -> Option<Custody> {
        self.spells[id.0].last().map(|spell| spell.custody)
    }

    /// What the arm holds.
    fn held_by(&self, arm: ArmId) -> Option<ObjectId> {
        (0..self.spells.len()).map(ObjectId).find(
            |&object| matches!(self.custody(object), Some(Custody::Held { arm: holder, .. }) if holder == arm),
        )
    }

    /// Reports a violation of an action.
    fn fault(&mut self, rule: Rule, action: &Action, arm: ArmId, amount: f64, message: String) {
        let problem = self.problem;
        let bodies = [problem.workcell.arms[arm.0].id.as_str(), problem.objects[action.object.0].id.as_str()];
        self.report.add(rule, Some(action.t), &bodies, amount, message);
    }

    /// What stands on a surface before the step plus what enters, against its stated capacity.
    fn check_capacity(&mut self, step: &[Action]) {
        for (index, surface) in self.problem.workcell.surfaces.iter().enumerate() {
            let Some(capacity) = surface.capacity else { continue };
            let entering = step
                .iter()
                .filter(|a| matches!(a.kind, ActionKind::Place { surface, .. } if surface.0 == index))
                .count();
            let standing = (0..self.spells.len())
                .filter(|&object| {
                    matches!(self.custody(ObjectId(object)),
                        Some(Custody::Resting { surface, .. }) if surface.0 == index)
                })
                .count();
            if entering > 0 && standing + entering > capacity {
                let message = format!(
                    "{standing} objects stand there and {entering} enter; its capacity is {capacity}"
                );
                let over = (standing + entering - capacity) as f64;
                self.report.add(Rule::Capacity, step.first().map(|a| a.t), &[&surface.id], over, message);
            }
        }
    }

    /// The arms of an action rest at it, and while their grippers work.
    fn check_rest(&mut self, action: &Action) {
        let arms = || hands(&action.kind).into_iter().flatten();
        let dwell = arms().map(|arm| self.problem.workcell.arms[arm.0].tool.grasp_time).fold(0.0, f64::max);
        let end = self.arms.duration();
        for arm in arms() {
            let peak = self.arms.peak_speed(arm, action.t, action.t);
            if beyond(peak.value, REST_SPEED) {
                let message = format!("a joint moves at {:.3e} when the action happens", peak.value);
                self.fault(Rule::RestAtAction, action, arm, peak.value, message);
                continue;
            }
            if dwell <= 0.0 {
                continue;
            }
            let peak = self.arms.peak_speed(arm, action.t, (action.t + dwell).min(end));
            if beyond(peak.value, REST_SPEED) || action.t + dwell > end + SAME_TIME {
                let message = format!("the arm must rest for {dwell} s after the action");
                self.fault(Rule::Dwell, action, arm, peak.value, message);
            }
        }
    }

    /// Lets an action take effect where the state allows it.
    fn apply(&mut self, action: &Action) -> bool {
        match &action.kind {
            ActionKind::Pick { arm, object_in_tcp, surface } => {
                let resting = match self.custody(action.object) {
                    Some(Custody::Resting { frame, surface: under }) if under == *surface => frame,
                    other => {
                        let message = match other {
                            Some(Custody::Held { .. }) => "the object is in a hand".to_owned(),
                            _ => "the object stands on another surface".to_owned(),
                        };
                        self.fault(Rule::PickState, action, *arm, 0.0, message);
                        return false;
                    }
                };
                if !self.check_empty(action, *arm) {
                    return false;
                }
                let grip = self.arms.tcp(*arm, action.t).inverse().compose(&resting);
                self.check_grasp(action, *arm, object_in_tcp, &grip);
                self.hold(action, *arm, grip);
                true
            }
            ActionKind::Place { arm, object_in_tcp, object_pose, surface } => {
                let Some(grip) = self.check_held(action, *arm, object_in_tcp) else { return false };
                let frame = self.arms.tcp(*arm, action.t).compose(&grip);
                let (off, turn) = difference(&Frame::of(object_pose), &frame);
                if !within(off, turn) {
                    let message = format!(
                        "object_pose is {:.2} mm and {:.2} degrees away from the real pose",
                        off * 1e3,
                        turn.to_degrees()
                    );
                    self.fault(Rule::PlacePose, action, *arm, off, message);
                }
                let surfaces = &self.problem.workcell.surfaces;
                let under = &surfaces[surface.0];
                let shapes = &self.object(action.object).shapes;
                let too = surfaces
                    .iter()
                    .find(|other| other.id != under.id && rests_on(shapes, &frame.to_pose(), other).is_ok());
                if let Some(too) = too {
                    let message = format!("the object rests on {} and {} at once", under.id, too.id);
                    self.fault(Rule::Resting, action, *arm, 0.0, message);
                }
                if let Err(fault) = rests_on(&self.object(action.object).shapes, &frame.to_pose(), under) {
                    let why = match fault {
                        RestFault::Height(height) if height > 0.0 => "it floats",
                        RestFault::Height(_) => "it sinks in",
                        RestFault::Outside(_) => "it stands over the rim",
                        RestFault::Topples(_) => "its centre is not above the points that touch",
                    };
                    let message = format!(
                        "the object does not rest on {}: {why} by {:.2} mm",
                        under.id,
                        fault.by() * 1e3
                    );
                    self.fault(Rule::Resting, action, *arm, fault.by(), message);
                }
                let custody = Custody::Resting { frame, surface: *surface };
                self.spells[action.object.0].push(Spell { from: action.t, custody });
                true
            }
            ActionKind::Handoff { arm, to_arm, object_in_tcp, to_object_in_tcp } => {
                let Some(grip) = self.check_held(action, *arm, object_in_tcp) else { return false };
                if !self.check_empty(action, *to_arm) {
                    return false;
                }
                let frame = self.arms.tcp(*arm, action.t).compose(&grip);
                let grip = self.arms.tcp(*to_arm, action.t).inverse().compose(&frame);
                self.check_grasp(action, *to_arm, to_object_in_tcp, &grip);
                self.hold(action, *to_arm, grip);
                true
            }
        }
    }

    fn hold(&mut self, action: &Action, arm: ArmId, grip: Frame) {
        let custody = Custody::Held { arm, grip };
        self.spells[action.object.0].push(Spell { from: action.t, custody });
    }

    /// The hand of who takes an object is empty.
    fn check_empty(&mut self, action: &Action, arm: ArmId) -> bool {
        let Some(held) = self.held_by(arm) else { return true };
        let message = format!("the arm already holds {}", self.object(held).id);
        self.fault(Rule::HandFull, action, arm, 0.0, message);
        false
    }

    /// Who releases an object holds it, at the stated pose. Gives the real pose in the TCP frame.
    fn check_held(&mut self, action: &Action, arm: ArmId, stated: &Pose) -> Option<Frame> {
        let Some(Custody::Held { arm: holder, grip }) = self
            .custody(action.object)
            .filter(|custody| matches!(custody, Custody::Held { arm: holder, .. } if *holder == arm))
        else {
            self.fault(Rule::HandEmpty, action, arm, 0.0, "the arm does not hold the object".to_owned());
            return None;
        };
        debug_assert_eq!(holder, arm);
        self.check_stated(action, arm, stated, &grip);
        Some(grip)
    }

    /// The stated pose in the TCP frame is the real one.
    fn check_stated(&mut self, action: &Action, arm: ArmId, stated: &Pose, real: &Frame) -> bool {
        let (off, turn) = difference(&Frame::of(stated), real);
        if within(off, turn) {
            return true;
        }
        let message = format!(
            "the stated pose in the tool frame is {:.2} mm and {:.2} degrees away from the real one",
            off * 1e3,
            turn.to_degrees()
        );
        self.fault(Rule::GraspPose, action, arm, off, message);
        false
    }

    /// The stated pose in the TCP frame is the real one, and one of the object's grasps.
    fn check_grasp(&mut self, action: &Action, arm: ArmId, stated: &Pose, real: &Frame) {
        if !self.check_stated(action, arm, stated, real) {
            return;
        }
        let stated = Frame::of(stated);
        let opening = self.problem.workcell.arms[arm.0].tool.max_opening;
        let mut nearest = (f64::INFINITY, f64::INFINITY);
        for grasp in self.object(action.object).grasps.iter().filter(|grasp| grasp.fits(opening)) {
            let (off, turn) = difference(&Frame::of(&grasp.object_in_tcp), &stated);
            if within(off, turn) {
                return;
            }
            if off + 0.1 * turn < nearest.0 + 0.1 * nearest.1 {
                nearest = (off, turn);
            }
        }
        let message = format!(
            "this is none of the object's grasps that fit the gripper; the nearest is {:.2} mm and {:.2} degrees away",
            nearest.0 * 1e3,
            nearest.1.to_degrees()
        );
        self.fault(Rule::UnknownGrasp, action, arm, nearest.0, message);
    }
}

/// Whether every object is where it shall be in the end.
pub(super) fn check_goal(problem: &Problem, timeline: &Timeline<'_>, end: f64, report: &mut Report) {
    for (index, (object, goal)) in problem.objects.iter().zip(&problem.goal).enumerate() {
        let Some(last) = timeline.spells[index].last() else { continue };
        let mut fault = |amount: f64, message: String| {
            report.add(Rule::Goal, Some(end), &[&object.id], amount, message);
        };
        let Custody::Resting { frame, surface } = last.custody else {
            fault(0.0, "the object is in a hand at the end".to_owned());
            continue;
        };
        match goal {
            GoalPlacement::Anywhere => {}
            GoalPlacement::Surface(wanted) if *wanted == surface => {}
            GoalPlacement::Surface(wanted) => {
                let name = |id: SurfaceId| problem.workcell.surfaces.get(id.0).map_or("?", |s| s.id.as_str());
                fault(0.0, format!("the object is on {} and shall be on {}", name(surface), name(*wanted)));
            }
            GoalPlacement::Pose { pose, .. } => {
                let wanted = Frame::of(pose);
                let off = (wanted.position - frame.position).norm();
                let turn = least_turn(object, &wanted, &frame);
                if !within(off, turn) {
                    let degrees = turn.to_degrees();
                    fault(
                        off,
                        format!("the object ends {:.2} mm and {degrees:.2} degrees off its goal", off * 1e3),
                    );
                }
            }
        }
    }
}

/// Position and angle between two frames (m, rad).
pub(super) fn difference(a: &Frame, b: &Frame) -> (f64, f64) {
    let relative = a.rotation.tr_mul(&b.rotation);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(relative)).angle();
    ((a.position - b.position).norm(), turn)
}

fn within(off: f64, turn: f64) -> bool {
    off <= POSITION_TOLERANCE && turn <= ANGLE_TOLERANCE
}

/// The angle (rad) from `wanted` to `frame`, the object's symmetry allowed for.
fn least_turn(object: &ObjectModel, wanted: &Frame, frame: &Frame) -> f64 {
    match object.symmetry {
        Symmetry::Sphere => 0.0,
        Symmetry::CylinderZ => {
            let (a, b) = (wanted.rotation * Vec3::z(), frame.rotation * Vec3::z());
            a.cross(&b).norm().atan2(a.dot(&b).abs())
        }
        Symmetry::None => difference(wanted, frame).1,
        Symmetry::Box => {
            let turned = object.symmetry_rotations.iter().map(|rotation| {
                let rotation = *rotation.to_rotation_matrix().matrix();
                let wanted = Frame { rotation: wanted.rotation * rotation, position: wanted.position };
                difference(&wanted, frame).1
            });
            turned.fold(difference(wanted, frame).1, f64::min)
        }
    }
}
