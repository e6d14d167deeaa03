//! A numeric time-optimal reference: the phase plane of a given path on a fine grid, by
//! controllable sets (Pham and Pham, "A new approach to time-optimal path parameterization based
//! on reachability analysis", 2018).

use rand::Rng as _;

use super::{Case, iiwa_limits};
use crate::kinematics::{Config, JointLimits};
use crate::run::Seed;
use crate::trajectory::Curve;

/// Path derivatives by arc length in the middle of a grid cell.
struct Cell {
    first: Vec<f64>,
    second: Vec<f64>,
}

/// Greatest squared path speed under the velocity limits.
fn speed_cap(cell: &Cell, limits: &[JointLimits]) -> f64 {
    let joints = cell.first.iter().zip(limits);
    joints.map(|(d, l)| (l.velocity / d.abs().max(1e-12)).powi(2)).fold(f64::INFINITY, f64::min)
}

/// The path accelerations that the joints allow at squared path speed `x`.
fn accelerations(cell: &Cell, limits: &[JointLimits], x: f64) -> (f64, f64) {
    let mut range = (f64::NEG_INFINITY, f64::INFINITY);
    for ((d, c), l) in cell.first.iter().zip(&cell.second).zip(limits) {
        if d.abs() < 1e-9 {
            if (c * x).abs() > l.acceleration {
                return (1.0, -1.0);
            }
            continue;
        }
        let (a, b) = ((-l.acceleration - c * x) / d, (l.acceleration - c * x) / d);
        range = (range.0.max(a.min(b)), range.1.min(a.max(b)));
    }
    range
}

/// The least time along the geometric path of `curve`, from rest to rest.
fn least_time(curve: &Curve, limits: &[JointLimits], count: usize) -> f64 {
    let length = curve.arc_length();
    let step = length / count as f64;
    // Times of the cell middles, by walking the curve finely.
    let mut cells = Vec::with_capacity(count);
    let fine = 40 * count;
    let mut walked = 0.0;
    for k in 0..fine {
        let t = curve.start_time() + curve.duration() * (k as f64 + 0.5) / fine as f64;
        let (_, qd) = curve.state_at(t);
        let speed = qd.iter().map(|v| v * v).sum::<f64>().sqrt();
        walked += speed * curve.duration() / fine as f64;
        while cells.len() < count && walked >= (cells.len() as f64 + 0.5) * step {
            let qdd = curve.acceleration_after(curve.segment_at(t));
            let first: Vec<f64> = qd.iter().map(|v| v / speed).collect();
            let along: f64 = first.iter().zip(&qdd).map(|(d, a)| d * a).sum();
            let second = first.iter().zip(&qdd).map(|(d, a)| (a - along * d) / (speed * speed)).collect();
            cells.push(Cell { first, second });
        }
    }
    // Backward: the greatest squared speed at each node from which rest can be reached.
    let mut most = vec![0.0; cells.len() + 1];
    for (index, cell) in cells.iter().enumerate().rev() {
        let ahead: f64 = most[index + 1];
        let can = |x: f64| {
            let (low, high) = accelerations(cell, limits, x);
            low <= high && x + 2.0 * step * low <= ahead && x + 2.0 * step * high >= 0.0
        };
        let (mut good, mut bad) = (0.0, speed_cap(cell, limits));
        if can(bad) {
            good = bad;
        }
        for _ in 0..60 {
            let middle = 0.5 * (good + bad);
            if can(middle) { good = middle } else { bad = middle }
        }
        most[index] = good;
    }
    // Forward: as fast as possible within these.
    let mut x: f64 = 0.0;
    let mut time = 0.0;
    for (index, cell) in cells.iter().enumerate() {
        let (_, high) = accelerations(cell, limits, x);
        let next = (x + 2.0 * step * high).clamp(0.0, most[index + 1].min(speed_cap(cell, limits)));
        time += 2.0 * step / (x.sqrt() + next.sqrt());
        x = next;
    }
    time
}

fn random_case(index: u64, count: usize, tolerance: f64, spread: f64) -> Case {
    let mut rng = Seed(11).part(index).stream("phase plane");
    let mut q: Config = (0..7).map(|_| rng.random_range(-1.0..1.0)).collect();
    let mut path = vec![q.clone()];
    for _ in 1..count {
        for x in &mut q {
            *x += spread * rng.random_range(-1.0..1.0);
        }
        path.push(q.clone());
    }
    Case { path, tolerances: vec![tolerance; count], limits: iiwa_limits() }
}

/// A two-waypoint path has a closed form: the reference must agree with it.
#[test]
fn reference_agrees_with_the_closed_form() {
    for index in 0..5 {
        let case = random_case(index, 2, 0.0, 1.5);
        let curve = case.curve();
        let reference = least_time(&curve, &case.limits, 2000);
        assert!((curve.duration() / reference - 1.0).abs() < 5e-3, "{} {reference}", curve.duration());
    }
}

/// The timing loses little against the fastest motion along its own geometric path.
#[test]
fn timing_is_close_to_time_optimal() {
    for (count, tolerance, spread) in
        [(3, 0.1, 1.0), (6, 0.1, 1.0), (6, 0.02, 1.0), (12, 0.1, 0.5), (20, 0.05, 0.3)]
    {
        let mut ratios = Vec::new();
        for index in 0..8 {
            let case = random_case(index, count, tolerance, spread);
            let curve = case.curve();
            ratios.push(curve.duration() / least_time(&curve, &case.limits, 1500));
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let worst = ratios.iter().fold(0.0_f64, |a, b| a.max(*b));
        assert!(ratios.iter().all(|r| *r > 0.99), "faster than the optimum: {ratios:?}");
        assert!(mean < 1.02 && worst < 1.1, "mean {mean}, worst {worst}");
    }
}
