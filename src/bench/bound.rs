//! How short a plan could be at best.

use crate::kinematics::Config;
use crate::plan::{ActionKind, ArmTrajectory, Plan};
use crate::trajectory::{Curve, CurvePoint, minimum_time};
use crate::workcell::{ArmId, Workcell};

/// An arm rests when no joint is faster than this (rad/s or m/s), FORMAT "Plan".
const RESTING_SPEED: f64 = 1e-3;

/// The least duration (s) of any plan whose arms rest in the same configurations at the ends of
/// the same steps as they do in `plan`, obstacles and other arms left out of account.
///
/// From one end of a step at which an arm rests to the next one at which it does, it needs at least
/// its slowest joint's time from rest to rest, after the gripper's time if it took part in an action.
/// Steps wait for their slowest arm; the longest way through them all is the bound. `None` when the plan does
/// not fit the workcell.
pub fn duration_lower_bound(workcell: &Workcell, plan: &Plan) -> Option<f64> {
    let mut ends: Vec<f64> = vec![0.0];
    ends.extend(plan.actions.iter().map(|action| action.t));
    ends.push(plan.metrics.duration_s);
    ends.dedup();
    let curves: Vec<Curve> = plan.arms.iter().map(curve).collect::<Option<_>>()?;
    if curves.len() != workcell.arms.len() {
        return None;
    }
    // Per arm: the last rest's place in `ends`, and the joints there.
    let mut rests: Vec<(usize, Config)> = curves.iter().map(|curve| (0, curve.first().q.clone())).collect();
    let mut earliest = vec![0.0; ends.len()];
    for (index, &t) in ends.iter().enumerate().skip(1) {
        let mut at: f64 = earliest[index - 1];
        let last = index + 1 == ends.len();
        let mut arrivals = Vec::new();
        for (arm, curve) in curves.iter().enumerate() {
            let (q, qd) = curve.state_at(t);
            if last || qd.iter().all(|speed| speed.abs() < RESTING_SPEED) {
                let (before, from) = &rests[arm];
                let model = workcell.arms.get(arm)?;
                let dwell = dwell(workcell, plan, ArmId(arm), ends[*before]);
                at = at.max(earliest[*before] + dwell + minimum_time(from, &q, &model.limits));
                arrivals.push((arm, q));
            }
        }
        earliest[index] = at;
        for (arm, q) in arrivals {
            rests[arm] = (index, q);
        }
    }
    earliest.last().copied()
}

/// How long `arm` must dwell after what it does at `t` (s).
fn dwell(workcell: &Workcell, plan: &Plan, arm: ArmId, t: f64) -> f64 {
    let takes = |arm: ArmId| workcell.arms.get(arm.0).map_or(0.0, |arm| arm.tool.grasp_time);
    let here = plan.actions.iter().filter(|action| action.t == t);
    here.map(|action| match &action.kind {
        ActionKind::Pick { arm: by, .. } | ActionKind::Place { arm: by, .. } if *by == arm => takes(arm),
        ActionKind::Handoff { arm: giver, to_arm, .. } if *giver == arm || *to_arm == arm => {
            takes(*giver).max(takes(*to_arm))
        }
        _ => 0.0,
    })
    .fold(0.0, f64::max)
}

fn curve(arm: &ArmTrajectory) -> Option<Curve> {
    let points = arm.points.iter().map(|point| CurvePoint {
        t: point.t,
        q: Config::from_slice(&point.q),
        qd: Config::from_slice(&point.qd),
    });
    Curve::new(points.collect()).ok()
}
