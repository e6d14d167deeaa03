//! Laws of timed curves, and comparison with a numeric time-optimal reference.

mod curve_laws;
mod phase_plane;
mod time_path_laws;

use proptest::prelude::*;

use crate::kinematics::{Config, JointLimits};

use super::time_path;

/// A path with its tolerances and limits.
#[derive(Debug, Clone)]
struct Case {
    path: Vec<Config>,
    tolerances: Vec<f64>,
    limits: Vec<JointLimits>,
}

impl Case {
    fn curve(&self) -> super::Curve {
        time_path(&self.path, &self.tolerances, &self.limits).unwrap()
    }
}

fn limits(velocity: f64, acceleration: f64) -> JointLimits {
    JointLimits { lower: f64::NEG_INFINITY, upper: f64::INFINITY, velocity, acceleration }
}

fn iiwa_limits() -> Vec<JointLimits> {
    let velocity = [85.0_f64, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0];
    let acceleration = [8.57, 8.57, 8.74, 11.36, 12.23, 15.72, 15.72];
    velocity.iter().zip(acceleration).map(|(v, a)| limits(v.to_radians(), a)).collect()
}

/// How the next waypoint follows from the ones before.
#[derive(Debug, Clone)]
enum Move {
    Anywhere(Vec<f64>),
    Near(Vec<f64>, f64),
    Same,
    StraightOn(f64),
    Back(f64),
}

fn moves(joints: usize) -> impl Strategy<Value = Move> {
    let vector = || prop::collection::vec(-2.0..2.0_f64, joints);
    prop_oneof![
        4 => vector().prop_map(Move::Anywhere),
        3 => (vector(), -8.0..-1.0_f64).prop_map(|(v, e)| Move::Near(v, 10.0_f64.powf(e))),
        1 => Just(Move::Same),
        2 => (-6.0..0.3_f64).prop_map(|e| Move::StraightOn(10.0_f64.powf(e))),
        1 => (-6.0..0.0_f64).prop_map(|e| Move::Back(10.0_f64.powf(e))),
    ]
}

/// Paths of all sorts: few and many joints and waypoints, repeated and nearly repeated waypoints,
/// straight runs, reversals, tolerances from none to wide, joints of very different limits.
fn cases() -> impl Strategy<Value = Case> {
    (1..10_usize, 0..12_usize).prop_flat_map(|(joints, count)| {
        let tolerance = prop_oneof![
            1 => Just(0.0),
            4 => (-5.0..-0.3_f64).prop_map(|e| 10.0_f64.powf(e)),
        ];
        let limit =
            (-1.0..1.3_f64, -0.5..2.0_f64).prop_map(|(v, a)| limits(10.0_f64.powf(v), 10.0_f64.powf(a)));
        (
            prop::collection::vec(-2.0..2.0_f64, joints),
            prop::collection::vec(moves(joints), count),
            prop::collection::vec(tolerance, count + 1),
            prop::collection::vec(limit, joints),
        )
            .prop_map(|(first, moves, tolerances, limits)| {
                let mut path: Vec<Config> = vec![first.into_iter().collect()];
                for step in moves {
                    let last = path[path.len() - 1].clone();
                    let before = path[path.len().saturating_sub(2)].clone();
                    let along = |scale: f64| -> Config {
                        last.iter().zip(&before).map(|(l, b)| l + scale * (l - b)).collect()
                    };
                    path.push(match step {
                        Move::Anywhere(v) => v.into_iter().collect(),
                        Move::Near(v, scale) => last.iter().zip(v).map(|(l, x)| l + scale * x).collect(),
                        Move::Same => last,
                        Move::StraightOn(scale) => along(scale),
                        Move::Back(scale) => along(-scale),
                    });
                }
                Case { path, tolerances, limits }
            })
    })
}
