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

/// The first piece of time (s) from an action on.
const FIRST_PIECE: f64 = 0.05;

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
                judge.allow(object, Some(Touch::Hand(*arm)), from.far, t);
                let to = judge.way(action, *arm, &tcp, normal, Side::After);
                judge.allow(object, carrier, t, to.far);
            }
            ActionKind::Place { arm, surface, .. } => {
                let (tcp, normal, carrier) =
                    (judge.arms.tcp(*arm, t), judge.normal(*surface), judge.carrier(*surface));
                let from = judge.way(action, *arm, &tcp, normal, Side::Before);
                judge.allow(object, carrier, from.far, t);
                let to = judge.way(action, *arm, &tcp, -tool_axis(&tcp), Side::After);
                judge.allow(object, Some(Touch::Hand(*arm)), t, to.far);
            }
            ActionKind::Handoff { arm, to_arm, .. } => {
                let receiver = judge.arms.tcp(*to_arm, t);
                let from = judge.way(action, *to_arm, &receiver, -tool_axis(&receiver), Side::Before);
                judge.rests(Rule::GiverMoves, action, *arm, from.enough, t);
                judge.allow(object, Some(Touch::Hand(*to_arm)), from.far, t);
                let giver = judge.arms.tcp(*arm, t);
                let to = judge.way(action, *arm, &giver, -tool_axis(&giver), Side::After);
                judge.rests(Rule::ReceiverMoves, action, *to_arm, t, to.enough);
                judge.allow(object, Some(Touch::Hand(*arm)), t, to.far);
            }
        }
    }
    if judge.arms.exhausted() {
        let message = "the judge gave up on straight ways: too many points around too many actions";
        judge.report.add(Rule::TooLarge, None, &[], 0.0, message);
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

    /// Checks one straight way along `outward` from `contact`, and gives its times (where it breaks,
    /// if it does).
    fn way(&mut self, action: &Action, arm: ArmId, contact: &Frame, outward: Vec3, side: Side) -> Way {
        let object = &self.problem.objects[action.object.0];
        let (rule, length, name) = match side {
            Side::Before => (Rule::Approach, object.approach, "approach"),
            Side::After => (Rule::Retreat, object.retreat, "retreat"),
        };
        match follow_line(self.arms, arm, action.t, contact, &outward, length, side) {
            Ok(way) => way,
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
                Way { enough: bent.t, far: bent.t }
            }
        }
    }

    /// An arm rests from one time to another.
    fn rests(&mut self, rule: Rule, action: &Action, arm: ArmId, from: f64, to: f64) {
        let peak = self.arms.peak_speed(arm, from, to);
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

/// The times of a straight way.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Way {
    /// When the TCP is within tolerance of the far end.
    enough: f64,
    /// When it is at the far end, or leaves the line for good before.
    far: f64,
}

/// The time from `t` to `end` in pieces that get longer and longer, those about `t` last.
fn pieces(t: f64, end: f64) -> Vec<(f64, f64)> {
    let (mut edges, mut reach) = (vec![t], FIRST_PIECE);
    while (end - t).abs() > reach {
        edges.push(t + reach * (end - t).signum());
        reach *= 2.0;
    }
    edges.push(end);
    edges.windows(2).rev().map(|edge| (edge[0].min(edge[1]), edge[0].max(edge[1]))).collect()
}

/// Follows the TCP from `t` on until it has come `length` along `outward`. It must not leave the
/// line before it is within tolerance of that.
///
/// Intervals are taken from `t` outward, longer and longer, and halved until the motion within them is small enough
/// to decide.
fn follow_line(
    arms: &mut Arms,
    arm: ArmId,
    t: f64,
    contact: &Frame,
    outward: &Vec3,
    length: f64,
    side: Side,
) -> Result<Way, Bent> {
    let end = if side == Side::Before { 0.0 } else { arms.duration() };
    let near_end = |a: f64, b: f64| if side == Side::Before { b } else { a };
    let mut enough = (length <= OFF_LINE).then_some(t);
    let mut covered = 0.0_f64;
    let mut open = pieces(t, end);
    while let Some((a, b)) = open.pop() {
        let goal = if enough.is_some() { length - FINE_SHIFT } else { length - OFF_LINE };
        let motion = arms.tool_motion(arm, a, b);
        let offset = motion.tcp.position - contact.position;
        let along = offset.dot(outward);
        let off = (offset - outward * along.clamp(0.0, length)).norm();
        let (_, turn) = difference(contact, &motion.tcp);
        let fine =
            (motion.shift <= FINE_SHIFT && motion.turn <= FINE_TURN) || b - a <= 1e-9 || arms.exhausted();
        let straight = off <= OFF_LINE && turn <= TURNED;
        if fine && along >= goal {
            match enough {
                Some(enough) => return Ok(Way { enough, far: near_end(a, b) }),
                None => enough = Some(near_end(a, b)),
            }
        }
        let not_there = along + motion.shift < goal || fine;
        let near = off + motion.shift <= OFF_LINE && turn + motion.turn <= TURNED;
        if not_there && (near || (fine && straight)) {
            covered = covered.max(along);
            continue;
        }
        if fine {
            let bent = Bent { t: 0.5 * (a + b), off, turn, covered };
            return enough.map(|enough| Way { enough, far: near_end(a, b) }).ok_or(bent);
        }
        let middle = 0.5 * (a + b);
        match side {
            Side::Before => open.extend([(a, middle), (middle, b)]),
            Side::After => open.extend([(middle, b), (a, middle)]),
        }
    }
    let bent = Bent { t: end, off: length - covered, turn: 0.0, covered };
    enough.map(|enough| Way { enough, far: end }).ok_or(bent)
}
