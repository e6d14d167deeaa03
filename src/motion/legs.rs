//! One arm's way through a step as timed curves: leave, travel, approach.

use crate::collision::{CollisionWorld, Resting};
use crate::kinematics::Config;
use crate::trajectory::{Curve, CurveTable, time_path};
use crate::transition::Line;
use crate::workcell::{Arm, ArmId};

use super::task::{ArmGoal, ArmTask, Departure};
use super::timed::{CurveMotion, Window, pieces};

/// Greatest deviations (rad or m) where a corner of the free path is rounded, in the order in which they are tried; 0 is a stop.
pub(super) const ROUNDINGS: [f64; 3] = [0.12, 0.02, 0.0];

/// Greatest deviation (rad or m) at the waypoints within a straight line.
const LINE_TOLERANCE: f64 = 0.001;

/// How much earlier (m) than the required distance an exemption ends.
const EXEMPTION_MARGIN: f64 = 0.001;

/// By how much (m) more than a distance the TCP may be away where it is said to have gone so far; little beside
/// [`EXEMPTION_MARGIN`].
const NEAR_ENOUGH: f64 = 1e-5;

/// A timed curve from 0 on, with its windows.
#[derive(Debug, Clone)]
pub(super) struct Leg {
    pub(super) curve: Curve,
    pub(super) windows: Vec<Window>,
    /// When the departure line's required distance is behind the arm (s).
    pub(super) departed: f64,
    /// When the approach line's required distance begins (s), where there is one.
    pub(super) approaching: Option<f64>,
}

/// An arm's legs.
#[derive(Debug, Clone)]
pub(super) struct Legs {
    /// The whole way in one flow.
    pub(super) through: Leg,
    /// The same with a rest before the approach, for an arm that must await a giver.
    pub(super) split: Option<(Leg, Leg)>,
}

/// Times the way of an arm whose free path is `path` (from the end of the departure line, or the
/// start, to the far end of the approach line, or the contact), and certifies it against what
/// stands still; `None` when that fails even with stops at all corners.
pub(super) fn time_legs(
    world: &CollisionWorld,
    id: ArmId,
    arm: &Arm,
    task: &ArmTask,
    path: &[Config],
    resting: &Resting,
) -> Option<Legs> {
    let gated = matches!(&task.goal, ArmGoal::Contact { after: Some(_), approach: Some(_), .. });
    for tolerance in ROUNDINGS {
        let way = Way::new(task, path, tolerance);
        let Some(through) = way.leg(arm, task, true, true) else { continue };
        if !is_free(world, id, task, &through, resting) {
            continue;
        }
        let split = if gated {
            let before = way.leg(arm, task, true, false)?;
            let after = way.leg(arm, task, false, true)?;
            if !is_free(world, id, task, &before, resting) || !is_free(world, id, task, &after, resting) {
                continue;
            }
            Some((before, after))
        } else {
            None
        };
        return Some(Legs { through, split });
    }
    None
}

fn is_free(world: &CollisionWorld, id: ArmId, task: &ArmTask, leg: &Leg, resting: &Resting) -> bool {
    let curve = &leg.curve;
    let table = CurveTable::new(curve);
    pieces(&leg.windows, curve.start_time(), curve.end_time()).into_iter().all(|(from, to, exemption)| {
        let motion = CurveMotion { curve, table: &table, span: (from, to) };
        world.static_free(id, &motion, task.held.as_ref(), resting, exemption)
    })
}

/// The polyline of a way and its corner tolerances.
struct Way {
    waypoints: Vec<Config>,
    tolerances: Vec<f64>,
    /// Index of the first waypoint of the approach line.
    approach_start: usize,
}

impl Way {
    fn new(task: &ArmTask, path: &[Config], tolerance: f64) -> Self {
        let mut waypoints: Vec<Config> = Vec::new();
        let mut tolerances: Vec<f64> = Vec::new();
        if let Some(departure) = &task.departure {
            let corners = line_tolerances(&departure.line, tolerance);
            waypoints.extend(departure.line.waypoints.iter().cloned());
            tolerances.extend(corners);
        }
        let skip = usize::from(!waypoints.is_empty());
        for q in path.iter().skip(skip) {
            waypoints.push(q.clone());
            tolerances.push(tolerance);
        }
        let mut approach_start = waypoints.len().saturating_sub(1);
        if let ArmGoal::Contact { approach: Some(line), .. } = &task.goal {
            // The path ends where the line begins.
            waypoints.pop();
            tolerances.pop();
            approach_start = waypoints.len();
            waypoints.extend(line.inwards());
            let mut corners = line_tolerances(line, tolerance);
            corners.reverse();
            tolerances.extend(corners);
        }
        Self { waypoints, tolerances, approach_start }
    }

    /// Times the part before the approach, the approach, or both.
    fn leg(&self, arm: &Arm, task: &ArmTask, before: bool, approach: bool) -> Option<Leg> {
        let from = if before { 0 } else { self.approach_start };
        let to = if approach { self.waypoints.len() } else { self.approach_start + 1 };
        let waypoints = self.waypoints.get(from..to)?;
        let curve = time_path(waypoints, self.tolerances.get(from..to)?, &arm.limits).ok()?;
        let departure = task.departure.as_ref().filter(|_| before);
        let goal = Some(&task.goal).filter(|_| approach);
        let Ends { windows, departed, approaching } = Ends::new(arm, departure, goal, &curve);
        Some(Leg { curve, windows, departed: departed.unwrap_or(0.0), approaching })
    }
}

/// When an arm's contacts are exempt on a curve from 0 on that begins with the line of `departure`
/// and ends with that of `goal`.
pub fn windows(
    arm: &Arm,
    departure: Option<&Departure>,
    goal: Option<&ArmGoal>,
    curve: &Curve,
) -> Vec<Window> {
    Ends::new(arm, departure, goal, curve).windows
}

/// The lines at both ends of a curve from 0 on.
struct Ends {
    /// When the contacts there are exempt.
    windows: Vec<Window>,
    /// When the departure line's required distance is behind the arm (s).
    departed: Option<f64>,
    /// When the approach line's required distance begins (s).
    approaching: Option<f64>,
}

impl Ends {
    fn new(arm: &Arm, departure: Option<&Departure>, goal: Option<&ArmGoal>, curve: &Curve) -> Self {
        let mut windows: Vec<Window> = Vec::new();
        let mut departed = None;
        if let Some(departure) = departure {
            let distance = departure.line.distance;
            let [to, whole] = leaves(arm, curve, [distance - EXEMPTION_MARGIN, distance], false);
            windows.push(Window { from: 0.0, to, exemption: departure.exemption });
            departed = Some(whole);
        }
        let mut approaching = None;
        if let Some(ArmGoal::Contact { approach: Some(line), exemption, .. }) = goal {
            let end = curve.end_time();
            let distances = [line.distance - EXEMPTION_MARGIN, line.distance + EXEMPTION_MARGIN];
            let [from, whole] = leaves(arm, curve, distances, true).map(|before| end - before);
            let from = windows.last().map_or(from, |window| from.max(window.to));
            windows.push(Window { from, to: end, exemption: *exemption });
            approaching = Some(whole);
        }
        Self { windows, departed, approaching }
    }
}

/// Corner tolerances of a line's waypoints from the contact outwards: tight along the required
/// distance, free at the far end when that lies beyond it, and a stop otherwise.
fn line_tolerances(line: &Line, free: f64) -> Vec<f64> {
    let count = line.waypoints.len();
    let runs_out = line.runs_out();
    (0..count)
        .map(|i| {
            if i + 1 < count {
                LINE_TOLERANCE
            } else if runs_out {
                free
            } else {
                0.0
            }
        })
        .collect()
}

/// After how long (s) the TCP is first so far (m) away from where the curve starts, for two ascending distances, or the
/// same backwards from its end; where it never is, the duration of the curve.
fn leaves(arm: &Arm, curve: &Curve, distances: [f64; 2], backwards: bool) -> [f64; 2] {
    let points = curve.points();
    let last = points.len() - 1;
    let time =
        |elapsed: f64| if backwards { curve.end_time() - elapsed } else { curve.start_time() + elapsed };
    let elapsed = |t: f64| if backwards { curve.end_time() - t } else { t - curve.start_time() };
    let point = |number: usize| &points[if backwards { last - number } else { number }];
    let start = arm.tcp_position(&point(0).q);
    let away = |q: &[f64]| (arm.tcp_position(q) - start).norm();
    let mut found = [curve.duration(); 2];
    let mut next = 0;
    while next < distances.len() && distances[next] <= 0.0 {
        found[next] = 0.0;
        next += 1;
    }
    let mut before = (0.0, 0.0);
    for point in (1..=last).map(point) {
        let here = (elapsed(point.t), away(&point.q));
        while next < distances.len() && here.1 >= distances[next] {
            let beyond = |(t, apart): (f64, f64)| (t, apart - distances[next]);
            let value = |at: f64| away(&curve.position_at(time(at))) - distances[next];
            found[next] = crossing(beyond(before), beyond(here), value);
            next += 1;
        }
        if next == distances.len() {
            break;
        }
        before = here;
    }
    found
}

/// Where `value` ceases to be negative between `low`, where it is, and `high`, where it is not, each
/// with its value: a place where it is not, by less than [`NEAR_ENOUGH`] or within a nanosecond. Regula
/// falsi that halves the value of an end that stays twice (the Illinois method).
fn crossing(mut low: (f64, f64), mut high: (f64, f64), value: impl Fn(f64) -> f64) -> f64 {
    let (mut low_weight, mut high_weight) = (low.1, high.1);
    let mut last_was_high = None;
    for _ in 0..60 {
        if high.1 <= NEAR_ENOUGH || high.0 - low.0 <= 1e-9 {
            break;
        }
        let part = low_weight / (low_weight - high_weight);
        let middle = low.0 + part.clamp(1e-3, 1.0 - 1e-3) * (high.0 - low.0);
        let found = value(middle);
        if found >= 0.0 {
            high = (middle, found);
            high_weight = found;
            if last_was_high.replace(true) == Some(true) {
                low_weight *= 0.5;
            }
        } else {
            low = (middle, found);
            low_weight = found;
            if last_was_high.replace(false) == Some(false) {
                high_weight *= 0.5;
            }
        }
    }
    high.0
}

#[cfg(test)]
mod tests {
    use super::{NEAR_ENOUGH, crossing, leaves};
    use crate::kinematics::Config;
    use crate::scenario::{Family, generate};
    use crate::trajectory::{Curve, CurvePoint, time_path};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

    #[test]
    fn distances_are_left_behind_once_the_tcp_is_there() {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let arm = &problem.workcell.arms[0];
        let there: Config = arm.home.iter().map(|q| q + 0.3).collect();
        let moved = time_path(&[arm.home.clone(), there], &[0.0, 0.0], &arm.limits).unwrap();
        let mut curve = Curve::rest(&arm.home, 0.0);
        curve.wait_until(1.0);
        curve.append(&moved).unwrap();
        let end = curve.end_time();
        let mirrored = curve.points().iter().rev().map(|point| CurvePoint {
            t: end - point.t,
            q: point.q.clone(),
            qd: point.qd.iter().map(|speed| -speed).collect(),
        });
        let mirrored = Curve::new(mirrored.collect()).unwrap();
        let start = arm.tcp_position(&arm.home);
        for distances in [[-0.001, 0.0], [0.0, 0.0005], [0.0005, 0.001], [0.079, 0.08], [0.05, 90.0]] {
            let found = leaves(arm, &curve, distances, false);
            let backwards = leaves(arm, &mirrored, distances, true);
            for ((distance, at), back) in distances.into_iter().zip(found).zip(backwards) {
                assert!((at - back).abs() < 1e-6, "{distance}: {at} {back}");
                let away = (arm.tcp_position(&curve.position_at(at)) - start).norm();
                if distance <= 0.0 {
                    // There is nothing to leave, however long the arm waits.
                    assert_eq!((at, back), (0.0, 0.0));
                } else if distance < 1.0 {
                    assert!(away >= distance && away < distance + 2.0 * NEAR_ENOUGH, "{distance} {away}");
                } else {
                    assert_eq!(at, curve.duration());
                }
            }
        }
    }

    #[test]
    fn crossings_are_found_from_beyond() {
        let functions: [fn(f64) -> f64; 4] =
            [|t| t - 0.3, |t| t * t * t - 0.027, |t| (9.0 * (t - 0.3)).tanh(), |t| 1e-3 * (t - 0.3)];
        for value in functions {
            let (low, high) = ((0.0, value(0.0)), (1.0, value(1.0)));
            let found = crossing(low, high, value);
            assert!(value(found) >= 0.0 && found >= 0.3 - 1e-12, "{found}");
            assert!(value(found) <= NEAR_ENOUGH || found - 0.3 < 2e-9, "{found}");
        }
        // What jumps is narrowed down all the same.
        let step = |t: f64| if t < 0.7 { -1.0 } else { 5.0 };
        let found = crossing((0.0, -1.0), (1.0, 5.0), step);
        assert!((0.7..0.7 + 1e-6).contains(&found), "{found}");
    }
}
