//! What holds for curves and their bounds.

use proptest::prelude::*;

use super::{cases, limits};
use crate::kinematics::{Config, JointLimits};
use crate::plan::ArmTrajectory;
use crate::trajectory::{Curve, CurveError, CurvePoint, LimitKind};

/// Any curve, cubic pieces and moving ends included.
fn curves() -> impl Strategy<Value = Curve> {
    (1..5_usize, 2..7_usize).prop_flat_map(|(joints, count)| {
        let values = || prop::collection::vec(prop::collection::vec(-2.0..2.0_f64, joints), count);
        (values(), values(), prop::collection::vec(0.01..1.0_f64, count)).prop_map(|(q, qd, steps)| {
            let mut t = -0.3;
            let points = q.into_iter().zip(qd).zip(steps).map(|((q, qd), step)| {
                t += step;
                CurvePoint { t, q: q.into_iter().collect(), qd: qd.into_iter().collect() }
            });
            Curve::new(points.collect()).unwrap()
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn bounds_hold_and_are_reached(curve in curves(), a in 0.0..1.0_f64, b in 0.0..1.0_f64) {
        let (t0, t1) = (
            curve.start_time() + a.min(b) * curve.duration(),
            curve.start_time() + a.max(b) * curve.duration(),
        );
        let displacement = curve.displacement_bounds(t0, t1);
        let from_start = curve.displacement_from(t0, t0, t1);
        let start = curve.position_at(t0);
        for joint in 0..curve.joints() {
            let speed = curve.max_speed(joint, t0, t1);
            let (low, high) = curve.joint_range(joint, t0, t1);
            let (mut least, mut most, mut fastest) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
            for k in 0..=3000 {
                let (q, qd) = curve.state_at(t0 + (t1 - t0) * f64::from(k) / 3000.0);
                least = least.min(q[joint]);
                most = most.max(q[joint]);
                fastest = fastest.max(qd[joint].abs());
            }
            prop_assert!(low <= least + 1e-9 && high >= most - 1e-9 && speed >= fastest - 1e-9);
            let step = (t1 - t0) / 3000.0;
            prop_assert!(least - low <= speed * step + 1e-9 && high - most <= speed * step + 1e-9);
            prop_assert!((displacement[joint] - (high - low)).abs() < 1e-12);
            let farthest = (high - start[joint]).max(start[joint] - low);
            prop_assert!((from_start[joint] - farthest).abs() < 1e-9);
        }
    }

    #[test]
    fn arc_length_is_that_of_a_fine_chain(curve in curves()) {
        let count = 20_000;
        let mut before = curve.first().q.clone();
        let mut chain = 0.0;
        for k in 1..=count {
            let q = curve.position_at(curve.start_time() + curve.duration() * f64::from(k) / f64::from(count));
            chain += q.iter().zip(&before).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
            before = q;
        }
        prop_assert!((curve.arc_length() - chain).abs() < 1e-4 * (1.0 + chain));
    }

    #[test]
    fn stretching_keeps_the_path_and_lowers_the_speed(case in cases(), factor in 1.0..4.0_f64) {
        let curve = case.curve();
        let duration = curve.duration() * factor;
        let slow = curve.clone().stretched_to(duration);
        prop_assert!((slow.duration() - duration).abs() < 1e-9);
        prop_assert!(slow.is_spaced());
        prop_assert!(slow.within_limits(&case.limits).is_ok());
        prop_assert!((slow.arc_length() - curve.arc_length()).abs() < 1e-7);
        for k in 0..=50 {
            let t = f64::from(k) / 50.0;
            let (q, qd) = curve.state_at(t * curve.duration());
            let (p, pd) = slow.state_at(t * duration);
            for joint in 0..curve.joints() {
                prop_assert!((q[joint] - p[joint]).abs() < 1e-8);
                prop_assert!((qd[joint] - pd[joint] * factor).abs() < 1e-6 * (1.0 + qd[joint].abs()));
            }
        }
        prop_assert_eq!(curve.clone().stretched_to(0.5 * curve.duration()), curve);
    }

    #[test]
    fn straight_ways_are_as_long_as_they_are(
        way in prop::collection::vec(-1.0..1.0_f64, 1..5), paces in prop::array::uniform2(-1.0..5.0_f64),
        aside in prop::sample::select(vec![0.0, 1e-9, 1e-3]), time in 0.05..2.0_f64,
    ) {
        let point = |t: f64, part: f64, pace: f64| CurvePoint {
            t,
            q: way.iter().map(|d| 0.3 + d * part).collect(),
            qd: way.iter().enumerate().map(|(k, d)| (d * pace + if k == 0 { aside } else { 0.0 }) / time).collect(),
        };
        let curve = Curve::new(vec![point(0.0, 0.0, paces[0]), point(time, 1.0, paces[1])]).unwrap();
        // Backwards too, and beyond the end and back, each part for itself.
        let count = 4000;
        let at = |k: i32| curve.position_at(time * f64::from(k) / f64::from(count));
        let step = |k: i32| at(k).iter().zip(&at(k - 1)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let chain: f64 = (1..=count).map(step).sum();
        let length = curve.arc_length();
        prop_assert!((length - chain).abs() < 1e-5 * (1.0 + chain), "{length} {chain}");
        if aside == 0.0 && paces.iter().all(|pace| (0.0..=3.0).contains(pace)) {
            let straight = way.iter().map(|d| d * d).sum::<f64>().sqrt();
            prop_assert!((length - straight).abs() < 1e-12);
        }
    }

    #[test]
    fn positions_are_those_of_states(curve in curves(), x in -0.2..1.2_f64) {
        let t = curve.start_time() + x * curve.duration();
        prop_assert_eq!(curve.position_at(t), curve.state_at(t).0);
        for point in curve.points() {
            prop_assert_eq!(curve.position_at(point.t), curve.state_at(point.t).0);
        }
    }

    #[test]
    fn selected_joints_move_as_before(curve in curves(), x in 0.0..1.0_f64) {
        let t = curve.start_time() + x * curve.duration();
        let whole = curve.state_at(t);
        for joint in 0..curve.joints() {
            let (q, qd) = curve.select(joint..joint + 1).state_at(t);
            prop_assert_eq!((q[0], qd[0]), (whole.0[joint], whole.1[joint]));
        }
    }

    #[test]
    fn trajectory_tells_the_acceleration_after_each_point(case in cases()) {
        let curve = case.curve();
        let trajectory = ArmTrajectory::from(&curve);
        prop_assert_eq!(trajectory.points.len(), curve.points().len());
        for (segment, pair) in trajectory.points.windows(2).enumerate() {
            let dt = 1e-3 * (pair[1].t - pair[0].t);
            let (q, _) = curve.state_at(pair[0].t + dt);
            for joint in 0..curve.joints() {
                let point = &pair[0];
                let expected = point.q[joint] + dt * point.qd[joint] + 0.5 * dt * dt * point.qdd[joint];
                prop_assert!((q[joint] - expected).abs() < 1e-12, "segment {}", segment);
            }
        }
        prop_assert!(trajectory.points.last().is_some_and(|p| p.qdd.iter().all(|a| *a == 0.0)));
    }
}

fn config(values: &[f64]) -> Config {
    values.iter().copied().collect()
}

#[test]
fn appending_joins_clocks_and_refuses_gaps() {
    let a = config(&[0.0, 1.0]);
    let mut curve = Curve::rest(&a, 0.5).shifted(2.0);
    curve.append(&Curve::rest(&a, 0.25).shifted(-7.0)).unwrap();
    assert_eq!((curve.start_time(), curve.end_time(), curve.segments()), (2.0, 2.75, 2));
    let before = curve.clone();
    let gap = curve.append(&Curve::rest(&config(&[0.0, 1.1]), 0.5));
    assert!(matches!(gap, Err(CurveError::Junction { joint: 1, .. })));
    assert!(matches!(curve.append(&Curve::rest(&config(&[0.0]), 0.5)), Err(CurveError::Joints { .. })));
    assert_eq!(curve, before);
}

#[test]
fn resting_and_waiting_keep_the_spacing() {
    let q = config(&[0.2]);
    assert_eq!(Curve::rest(&q, 0.0).segments(), 0);
    assert!(Curve::rest(&q, 1e-5).is_spaced());
    let mut curve = Curve::rest(&q, 0.3);
    curve.wait_until(0.3);
    assert_eq!(curve.segments(), 1);
    curve.wait_until(0.3001);
    assert!(curve.is_spaced() && curve.segments() == 2);
    assert_eq!(Curve::rest(&q, 0.0).stretched_to(0.4).duration(), 0.4);
    assert_eq!(curve.state_at(9.0), (q.clone(), config(&[0.0])));
    assert_eq!(curve.state_at(-9.0), (q, config(&[0.0])));
}

#[test]
fn malformed_points_are_refused() {
    let point = |t: f64, q: &[f64]| CurvePoint { t, q: config(q), qd: config(&vec![0.0; q.len()]) };
    assert_eq!(Curve::new(Vec::new()), Err(CurveError::Empty));
    let joints = Curve::new(vec![point(0.0, &[0.0]), point(1.0, &[0.0, 1.0])]);
    assert_eq!(joints, Err(CurveError::Joints { index: 1 }));
    let order = Curve::new(vec![point(0.0, &[0.0]), point(0.0, &[0.0])]);
    assert_eq!(order, Err(CurveError::Order { index: 1 }));
    assert_eq!(Curve::new(vec![point(0.0, &[f64::NAN])]), Err(CurveError::Order { index: 0 }));
}

/// One curve per limit that breaks it between its points only.
#[test]
fn limits_are_checked_between_the_points() {
    let point = |t: f64, q: f64, qd: f64| CurvePoint { t, q: config(&[q]), qd: config(&[qd]) };
    let check = |points: Vec<CurvePoint>, limits: JointLimits| {
        Curve::new(points).unwrap().within_limits(&[limits]).err().map(|e| (e.kind, e.value))
    };
    // q = t (1 - t): top 0.25 at 0.5.
    let hill = || vec![point(0.0, 0.0, 1.0), point(1.0, 0.0, -1.0)];
    let position = |upper| JointLimits { lower: -1.0, upper, velocity: 2.0, acceleration: 3.0 };
    assert_eq!(check(hill(), position(0.2499)), Some((LimitKind::Position, 0.25)));
    assert_eq!(check(hill(), position(0.25)), None);
    let low = JointLimits { lower: 0.0001, upper: 1.0, ..position(1.0) };
    assert!(matches!(check(hill(), low), Some((LimitKind::Position, _))));
    // q = 3 t^2 - 2 t^3: speed 1.5 halfway, acceleration 6 at the ends.
    let smooth = || vec![point(0.0, 0.0, 0.0), point(1.0, 1.0, 0.0)];
    assert!(
        matches!(check(smooth(), limits(1.4997, 7.0)), Some((LimitKind::Velocity, v)) if (v - 1.5).abs() < 1e-12)
    );
    assert!(
        matches!(check(smooth(), limits(1.6, 5.99)), Some((LimitKind::Acceleration, a)) if (a - 6.0).abs() < 1e-12)
    );
    assert_eq!(check(smooth(), limits(1.5, 6.0)), None);
    assert!(check(smooth(), limits(f64::NAN, 6.0)).is_some());
}
