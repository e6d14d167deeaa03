//! Straight ways to and from grasps and releases, and who may move at a handoff.
//!
//! From the curve alone: going from an action's time backward (approach) or forward (retreat), the
//! tool stays near its line until it has come as far as the object asks for. The times between are
//! the window during which hand and object, or object and carrier, may touch.

use super::arms::Arms;
use super::custody::{Timeline, difference};
use super::gap::Frame;
use super::motion_limits::REST_SPEED;
use super::verdict::{Report, Rule, beyond};
use crate::geometry::Vec3;
use crate::plan::{Action, ActionKind};
use crate::problem::Problem;
use crate::workcell::{ArmId, ObjectId, ObstacleId, SurfaceId};

/// How far the TCP may be from its line (m).
const OFF_LINE: f64 = 5e-3;
/// How far it may be turned (rad): 3 degrees.
const TURNED: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Below these motions within half an interval the middle decides (m, rad).
const FINE_SHIFT: f64 = 1e-4;
const FINE_TURN: f64 = 1e-3;

/// The most intervals that one way may take; a way of this many is none.
const MAX_INTERVALS: usize = 100_000;

/// What may touch for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Touch {
    /// The hand of this arm and the object.
    Hand(ArmId),
    /// The carrier of a surface and the object.
    Carrier(ObstacleId),
}

/// A time during which an object may touch something.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// The object.
    pub object: ObjectId,
    /// What it may touch.
    pub touch: Touch,
    /// From (s).
    pub from: f64,
    /// To (s).
    pub to: f64,
}

/// Which way in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Before,
    After,
}

/// Where a straight way breaks.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bent {
    t: f64,
    off: f64,
    turn: f64,
    covered: f64,
}

/// Checks all approaches, retreats and handoffs; gives the windows.
pub(super) fn check(
    problem: &Problem,
    timeline: &Timeline<'_>,
    arms: &mut Arms,
    report: &mut Report,
) -> Vec<Window> {
    let mut judge = Ways { problem, arms, report, windows: Vec::new() };
    for event in timeline.events.iter().filter(|event| event.effective) {
        let action = event.action;
        let (object, t) = (action.object, action.t);
        match &action.kind {
            ActionKind::Pick { arm, surface, .. } => {
                let (tcp, normal, carrier) =
                    (judge.arms.tcp(*arm, t), judge.normal(*surface), judge.carrier(*surface));
                let from = judge.way(action, *arm, &tcp, -tool_axis(&tcp), Side::Before);
                judge.allow(object, Some(Touch::Hand(*arm)), from, t);
                let to = judge.way(action, *arm, &tcp, normal, Side::After);
                judge.allow(object, carrier, t, to);
            }
            ActionKind::Place { arm, surface, .. } => {
                let (tcp, normal, carrier) =
                    (judge.arms.tcp(*arm, t), judge.normal(*surface), judge.carrier(*surface));
                let from = judge.way(action, *arm, &tcp, normal, Side::Before);
                judge.allow(object, carrier, from, t);
                let to = judge.way(action, *arm, &tcp, -tool_axis(&tcp), Side::After);
                judge.allow(object, Some(Touch::Hand(*arm)), t, to);
            }
            ActionKind::Handoff { arm, to_arm, .. } => {
                let receiver = judge.arms.tcp(*to_arm, t);
                let from = judge.way(action, *to_arm, &receiver, -tool_axis(&receiver), Side::Before);
                judge.rests(Rule::GiverMoves, action, *arm, from, t);
                judge.allow(object, Some(Touch::Hand(*to_arm)), from, t);
                let giver = judge.arms.tcp(*arm, t);
                let to = judge.way(action, *arm, &giver, -tool_axis(&giver), Side::After);
                judge.rests(Rule::ReceiverMoves, action, *to_arm, t, to);
                judge.allow(object, Some(Touch::Hand(*arm)), t, to);
            }
        }
    }
    judge.windows
}

/// The approach direction of a TCP frame.
fn tool_axis(tcp: &Frame) -> Vec3 {
    tcp.rotation.column(2).into_owned()
}

struct Ways<'a> {
    problem: &'a Problem,
    arms: &'a mut Arms,
    report: &'a mut Report,
    windows: Vec<Window>,
}

impl Ways<'_> {
    fn normal(&self, surface: SurfaceId) -> Vec3 {
        self.problem.workcell.surfaces[surface.0].normal()
    }

    fn carrier(&self, surface: SurfaceId) -> Option<Touch> {
        self.problem.workcell.surfaces[surface.0].carrier.map(Touch::Carrier)
    }

    fn allow(&mut self, object: ObjectId, touch: Option<Touch>, from: f64, to: f64) {
        self.windows.extend(touch.map(|touch| Window { object, touch, from, to }));
    }

    /// Checks one straight way along `outward` from `contact`, and gives the time at its far end
    /// (or where it breaks).
    fn way(&mut self, action: &Action, arm: ArmId, contact: &Frame, outward: Vec3, side: Side) -> f64 {
        let object = &self.problem.objects[action.object.0];
        let (rule, length, name) = match side {
            Side::Before => (Rule::Approach, object.approach, "approach"),
            Side::After => (Rule::Retreat, object.retreat, "retreat"),
        };
        match follow_line(self.arms, arm, action.t, contact, &outward, length, side) {
            Ok(t) => t,
            Err(bent) => {
                let bodies = [self.problem.workcell.arms[arm.0].id.as_str(), object.id.as_str()];
                let message = format!(
                    "{name} of the action at t={:.3} s: straight for {:.1} of {:.1} mm, then {:.1} mm and {:.1} degrees off",
                    action.t,
                    bent.covered.max(0.0) * 1e3,
                    length * 1e3,
                    bent.off * 1e3,
                    bent.turn.to_degrees()
                );
                self.report.add(rule, Some(bent.t), &bodies, bent.off, message);
                bent.t
            }
        }
    }

    /// An arm rests from one time to another.
    fn rests(&mut self, rule: Rule, action: &Action, arm: ArmId, from: f64, to: f64) {
        let peak = self.arms.curve(arm).peak_speed(from, to);
        if beyond(peak.value, REST_SPEED) {
            let object = &self.problem.objects[action.object.0];
            let bodies = [self.problem.workcell.arms[arm.0].id.as_str(), object.id.as_str()];
            let message = format!(
                "a joint moves at {:.3e} during the handoff at t={:.3} s, while the other arm {}",
                peak.value,
                action.t,
                if rule == Rule::GiverMoves { "approaches" } else { "retreats" }
            );
            self.report.add(rule, Some(peak.t), &bodies, peak.value, message);
        }
    }
}

/// Follows the TCP from `t` on until it has come within tolerance of `length` along `outward`.
/// Gives the time then; or where it leaves the line before, or that it never gets there.
///
/// Intervals are taken from `t` outward, and halved until the motion within them is small enough
/// to decide.
fn follow_line(
    arms: &mut Arms,
    arm: ArmId,
    t: f64,
    contact: &Frame,
    outward: &Vec3,
    length: f64,
    side: Side,
) -> Result<f64, Bent> {
    let goal = length - OFF_LINE;
    if goal <= 0.0 {
        return Ok(t);
    }
    let span = match side {
        Side::Before => (0.0, t),
        Side::After => (t, arms.duration()),
    };
    let mut covered = 0.0_f64;
    let mut open = vec![span];
    for _ in 0..MAX_INTERVALS {
        let Some((a, b)) = open.pop() else { break };
        let motion = arms.tool_motion(arm, a, b);
        let offset = motion.tcp.position - contact.position;
        let along = offset.dot(outward);
        let off = (offset - outward * along.clamp(0.0, length)).norm();
        let (_, turn) = difference(contact, &motion.tcp);
        let fine = (motion.shift <= FINE_SHIFT && motion.turn <= FINE_TURN) || b - a <= 1e-9;
        if fine && along >= goal {
            return Ok(if side == Side::Before { b } else { a });
        }
        let not_there = along + motion.shift < goal || fine;
        let near = off + motion.shift <= OFF_LINE && turn + motion.turn <= TURNED;
        if not_there && (near || (fine && off <= OFF_LINE && turn <= TURNED)) {
            covered = covered.max(along);
            continue;
        }
        if fine {
            return Err(Bent { t: 0.5 * (a + b), off, turn, covered });
        }
        let middle = 0.5 * (a + b);
        match side {
            Side::Before => open.extend([(a, middle), (middle, b)]),
            Side::After => open.extend([(middle, b), (a, middle)]),
        }
    }
    let end = if side == Side::Before { span.0 } else { span.1 };
    Err(Bent { t: end, off: length - covered, turn: 0.0, covered })
}
