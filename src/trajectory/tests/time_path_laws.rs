//! What holds for every timed polyline.

use proptest::prelude::*;

use super::{Case, cases, iiwa_limits, limits};
use crate::kinematics::Config;
use crate::trajectory::{Curve, TimingError, minimum_time, time_path};

/// Distance (largest joint difference) from `q` to the straight segment from `a` to `b`: the
/// maximum of absolute values of linear functions is convex, so halving intervals by golden
/// section finds the least.
fn distance_to_segment(q: &Config, a: &Config, b: &Config) -> f64 {
    let at = |x: f64| {
        q.iter().zip(a.iter().zip(b)).map(|(q, (a, b))| (a + x * (b - a) - q).abs()).fold(0.0, f64::max)
    };
    let (mut low, mut high) = (0.0, 1.0);
    let golden = 0.618_033_988_749_894_9;
    for _ in 0..60 {
        let (x, y) = (high - golden * (high - low), low + golden * (high - low));
        if at(x) < at(y) { high = y } else { low = x }
    }
    at(0.5 * (low + high)).min(at(0.0)).min(at(1.0))
}

fn samples(curve: &Curve, per_segment: usize) -> Vec<f64> {
    let mut times = Vec::new();
    for pair in curve.points().windows(2) {
        times.extend(
            (0..per_segment).map(|k| pair[0].t + (pair[1].t - pair[0].t) * k as f64 / per_segment as f64),
        );
    }
    times.push(curve.end_time());
    times
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn starts_and_ends_at_rest_at_the_end_waypoints(case in cases()) {
        let curve = case.curve();
        prop_assert!(curve.rests_at_ends());
        let ends = [(curve.first(), &case.path[0]), (curve.last(), &case.path[case.path.len() - 1])];
        for (point, waypoint) in ends {
            for (a, b) in point.q.iter().zip(waypoint) {
                prop_assert!((a - b).abs() <= 1e-10);
            }
        }
    }

    #[test]
    fn limits_hold_and_points_are_spaced(case in cases()) {
        let curve = case.curve();
        prop_assert!(curve.is_spaced());
        // Much closer than FORMAT asks for.
        for segment in 0..curve.segments() {
            let speeds = curve.max_abs_speeds_on(segment..segment + 1);
            let accelerations = curve.acceleration_after(segment);
            for ((l, v), a) in case.limits.iter().zip(&speeds).zip(&accelerations) {
                prop_assert!(*v <= l.velocity * (1.0 + 1e-6));
                prop_assert!(a.abs() <= l.acceleration * (1.0 + 1e-5));
            }
        }
        prop_assert!(curve.within_limits(&case.limits).is_ok());
    }

    /// The emitted cubic is the quadratic that was meant: the second derivative at both ends of
    /// each piece is the difference of the velocities over its time.
    #[test]
    fn every_piece_is_quadratic(case in cases()) {
        let curve = case.curve();
        for (segment, pair) in curve.points().windows(2).enumerate() {
            let h = pair[1].t - pair[0].t;
            for joint in 0..curve.joints() {
                let (cubic, _) = curve.cubic(segment, joint);
                let mean = (pair[1].qd[joint] - pair[0].qd[joint]) / h;
                for t in [0.0, h] {
                    let slack = 1e-5 * case.limits[joint].acceleration;
                    prop_assert!((cubic.acceleration(t) - mean).abs() <= slack);
                }
            }
        }
    }

    #[test]
    fn curve_stays_within_the_tolerances(case in cases()) {
        let curve = case.curve();
        let count = case.path.len();
        if count < 2 {
            return Ok(());
        }
        let widest = case.tolerances.iter().take(count - 1).skip(1).fold(0.0_f64, |a, b| a.max(*b));
        for t in samples(&curve, 5) {
            let q = curve.position_at(t);
            let off = case.path.windows(2).map(|w| distance_to_segment(&q, &w[0], &w[1]));
            prop_assert!(off.fold(f64::INFINITY, f64::min) <= widest + 1e-8);
        }
        // Every waypoint is passed within its own tolerance, and those without one at rest.
        for (waypoint, tolerance) in case.path.iter().zip(&case.tolerances).take(count - 1).skip(1) {
            let passed = samples(&curve, 60).into_iter().map(|t| {
                let q = curve.position_at(t);
                q.iter().zip(waypoint).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
            });
            let near = passed.fold(f64::INFINITY, f64::min);
            if *tolerance == 0.0 {
                let hit = curve.points().iter().any(|p| {
                    p.qd.iter().all(|v| *v == 0.0)
                        && p.q.iter().zip(waypoint).all(|(a, b)| (a - b).abs() <= 1e-10)
                });
                prop_assert!(hit);
            } else {
                // The samples are at most this far apart.
                let step = curve.points().windows(2).enumerate().map(|(segment, w)| {
                    let speeds = curve.max_abs_speeds_on(segment..segment + 1);
                    speeds.iter().fold(0.0_f64, |a, b| a.max(*b)) * (w[1].t - w[0].t) / 60.0
                });
                prop_assert!(near <= tolerance + step.fold(0.0, f64::max) + 1e-8);
            }
        }
    }

    #[test]
    fn velocity_is_continuous(case in cases()) {
        let curve = case.curve();
        for segment in 1..curve.segments() {
            for joint in 0..curve.joints() {
                let (before, h) = curve.cubic(segment - 1, joint);
                let (after, _) = curve.cubic(segment, joint);
                prop_assert!((before.velocity(h) - after.velocity(0.0)).abs() < 1e-7);
                prop_assert!((before.position(h) - after.position(0.0)).abs() < 1e-10);
            }
        }
    }

    /// Two waypoints: the closed form, but for phases that are too short to be emitted.
    #[test]
    fn straight_path_takes_the_least_time(case in cases()) {
        if case.path.len() < 2 {
            return Ok(());
        }
        let ends = [case.path[0].clone(), case.path[1].clone()];
        let curve = time_path(&ends, &[0.0, 0.0], &case.limits).unwrap();
        let least = minimum_time(&ends[0], &ends[1], &case.limits);
        prop_assert!(curve.duration() >= least - 1e-9);
        if ends[0].iter().zip(&ends[1]).any(|(a, b)| (a - b).abs() > 1e-2) {
            // All joints follow one profile: compare with it.
            let speed = |l: &f64, d: f64| l / d;
            let (mut v, mut a) = (f64::INFINITY, f64::INFINITY);
            for ((x, y), l) in ends[0].iter().zip(&ends[1]).zip(&case.limits) {
                v = v.min(speed(&l.velocity, (x - y).abs()));
                a = a.min(speed(&l.acceleration, (x - y).abs()));
            }
            let expected = if v * v >= a { 2.0 / a.sqrt() } else { 1.0 / v + v / a };
            prop_assert!(curve.duration() >= expected - 1e-9);
            prop_assert!(curve.duration() <= expected + 2.1e-3);
            if v * v >= a && a.sqrt() < 900.0 {
                prop_assert!((curve.duration() - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn higher_limits_are_not_slower(case in cases(), v in 1.0..3.0_f64, a in 1.0..3.0_f64, joint in 0..10_usize) {
        let slow = case.curve().duration();
        let mut faster = case.clone();
        for l in &mut faster.limits {
            l.velocity *= v;
            l.acceleration *= a;
        }
        prop_assert!(faster.curve().duration() <= slow * 1.05 + 5e-3);
        let mut faster = case;
        let joint = joint % faster.limits.len();
        faster.limits[joint].velocity *= v;
        faster.limits[joint].acceleration *= a;
        // Where other joints move at other times, a corner that was blended may become a stop: two ramps
        // more, which take some 10 ms each however short the path is.
        prop_assert!(faster.curve().duration() <= slow * 1.1 + 2.5e-2, "{} after {slow}", faster.curve().duration());
    }

    #[test]
    fn blending_is_never_slower_than_stopping(case in cases()) {
        let stopping = Case { tolerances: vec![0.0; case.path.len()], ..case.clone() };
        prop_assert!(case.curve().duration() <= stopping.curve().duration() + 5e-3);
    }
}

#[test]
fn collinear_waypoints_cost_nothing() {
    let limits = iiwa_limits();
    let end: Config = [0.4, -0.7, 1.1, 0.3, -0.2, 0.9, 1.3].into_iter().collect();
    let fractions = [0.0, 0.1, 0.1001, 0.35, 0.7, 0.70001, 1.0];
    let path: Vec<Config> = fractions.iter().map(|f| end.iter().map(|x| f * x).collect()).collect();
    let whole = time_path(&[path[0].clone(), end.clone()], &[0.0; 2], &limits).unwrap();
    let dense = time_path(&path, &[1e-6; 7], &limits).unwrap();
    assert!((dense.duration() - whole.duration()).abs() < 1e-9);
}

#[test]
fn reversal_is_a_stop_on_the_waypoint() {
    let limits = vec![limits(1.0, 4.0); 2];
    let path: Vec<Config> =
        [[0.0, 0.0], [0.6, 0.3], [0.2, 0.1]].iter().map(|q| q.iter().copied().collect()).collect();
    let curve = time_path(&path, &[0.0, 0.1, 0.0], &limits).unwrap();
    let stop = curve.points().iter().find(|p| (p.q[0] - 0.6).abs() < 1e-12 && (p.q[1] - 0.3).abs() < 1e-12);
    assert!(stop.is_some_and(|p| p.qd.iter().all(|v| *v == 0.0)));
}

#[test]
fn a_single_waypoint_is_an_instant() {
    let q: Config = [0.3, 0.1].into_iter().collect();
    let limits = vec![limits(1.0, 4.0); 2];
    for count in 1..4 {
        let curve = time_path(&vec![q.clone(); count], &vec![0.1; count], &limits).unwrap();
        assert_eq!((curve.points().len(), curve.duration()), (1, 0.0));
        assert_eq!(curve.state_at(0.5).0, q);
    }
}

#[test]
fn wrong_arguments_are_told_apart() {
    let q: Config = [0.3, 0.1].into_iter().collect();
    let good = vec![limits(1.0, 4.0); 2];
    assert_eq!(time_path(&[], &[], &good), Err(TimingError::Empty));
    let tolerances = time_path(std::slice::from_ref(&q), &[], &good);
    assert_eq!(tolerances, Err(TimingError::Tolerances { waypoints: 1, tolerances: 0 }));
    let short: Config = [0.3].into_iter().collect();
    assert_eq!(time_path(&[q.clone(), short], &[0.0; 2], &good), Err(TimingError::Waypoint { index: 1 }));
    let nan: Config = [0.3, f64::NAN].into_iter().collect();
    assert_eq!(time_path(&[nan], &[0.0], &good), Err(TimingError::Waypoint { index: 0 }));
    let bad = vec![limits(1.0, 4.0), limits(1.0, 0.0)];
    assert_eq!(time_path(&[q], &[0.0], &bad), Err(TimingError::Limit { joint: 1 }));
}
