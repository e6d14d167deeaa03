//! Straight lines of the TCP, as joint waypoints.

use smallvec::SmallVec;

use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::workcell::Arm;

/// How far (m) a line runs on beyond the required distance where the arm can, so that the corner
/// at its end may be rounded without leaving the line too early.
pub const LINE_RUNOUT: f64 = 0.02;

/// Greatest distance (m) between waypoints of a line.
const SPACING: f64 = 0.05;

/// Pieces that are longer (m) are halved where they are not straight enough.
const LEAST_HALVED: f64 = 0.02;

/// Greatest deviation (m) of the TCP from the line between two waypoints.
const GREATEST_SAG: f64 = 0.001;

/// Greatest deviation (rad) of the TCP's orientation between two waypoints.
const GREATEST_TURN: f64 = 0.01;

/// Greatest change (rad or m) of one joint between two waypoints.
const GREATEST_JOINT_STEP: f64 = 0.35;

/// A straight line of the TCP without turning, as joint waypoints that start at a contact.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Waypoints from the contact outwards; the first is the contact configuration.
    pub waypoints: Vec<Config>,
    /// The required distance (m): the line is followed at least this far.
    pub distance: f64,
    runs_out: bool,
}

impl Line {
    /// The line from the contact `q` along the unit vector `direction` (world) over `distance`
    /// (m), with the run-out where it can be had; `None` when the arm cannot follow it.
    pub fn follow(arm: &Arm, q: &[f64], direction: &Vec3, distance: f64) -> Option<Self> {
        let ray = Ray::new(arm, q, direction);
        let mut waypoints = vec![Config::from_slice(q)];
        let pieces = (distance / SPACING).ceil().max(1.0) as usize;
        let mut advance = |along: f64| {
            let previous = waypoints.last()?;
            let next = ray.step(along, previous)?;
            ray.is_kept(previous, &next).then(|| waypoints.push(next))
        };
        let mut before = 0.0;
        let mut ahead: SmallVec<[f64; 8]> =
            (1..=pieces).rev().map(|piece| distance * piece as f64 / pieces as f64).collect();
        while let Some(along) = ahead.pop() {
            if advance(along).is_some() {
                before = along;
            } else if along - before > LEAST_HALVED {
                ahead.extend([along, (before + along) / 2.0]);
            } else {
                return None;
            }
        }
        let last = waypoints.last()?.clone();
        let mut runs_out = false;
        if let Some(beyond) = ray.step(distance + LINE_RUNOUT, &last)
            && ray.is_kept(&last, &beyond)
        {
            waypoints.push(beyond);
            runs_out = true;
        }
        Some(Self { waypoints, distance, runs_out })
    }

    /// Whether the last waypoint lies beyond the required distance.
    pub fn runs_out(&self) -> bool {
        self.runs_out
    }

    /// The waypoints from the far end to the contact.
    pub fn inwards(&self) -> Vec<Config> {
        self.waypoints.iter().rev().cloned().collect()
    }
}

/// Where the TCP starts and which way it goes, in the arm's root frame.
struct Ray<'a> {
    arm: &'a Arm,
    /// The mount frame at the start.
    mount: Pose,
    /// The TCP's origin at the start (m).
    tcp: Vec3,
    /// Of unit length.
    direction: Vec3,
}

impl<'a> Ray<'a> {
    /// From the TCP at `q` along `direction` (world).
    fn new(arm: &'a Arm, q: &[f64], direction: &Vec3) -> Self {
        let mount = arm.model.mount_pose(q);
        let direction = arm.base.rotation.inverse_transform_vector(direction);
        Self { arm, mount, tcp: tcp(arm, &mount), direction }
    }

    /// The configuration that holds the TCP moved by `along` (m) from the start, continuing from `seed`.
    fn step(&self, along: f64, seed: &[f64]) -> Option<Config> {
        let mut mount = self.mount;
        mount.translation.vector += self.direction * along;
        self.arm.model.inverse_near(&self.arm.limits, &mount, seed, GREATEST_JOINT_STEP)
    }

    /// Whether the joint segment keeps the TCP on the ray. Between two configurations that are this near to
    /// each other it strays most in the middle, but for terms of third order.
    fn is_kept(&self, from: &[f64], to: &[f64]) -> bool {
        let q: Config = from.iter().zip(to).map(|(a, b)| (a + b) / 2.0).collect();
        let mount = self.arm.model.mount_pose(&q);
        let offset = tcp(self.arm, &mount) - self.tcp;
        let aside = offset - self.direction * offset.dot(&self.direction);
        // A small rotation's quaternion has half the angle for its vector.
        let turn = 2.0 * self.mount.rotation.rotation_to(&mount.rotation).vector().norm();
        aside.norm() < GREATEST_SAG && turn < GREATEST_TURN
    }
}

/// The TCP's origin (m) where the mount frame is at `mount`.
fn tcp(arm: &Arm, mount: &Pose) -> Vec3 {
    mount.rotation * arm.tool.tcp.translation.vector + mount.translation.vector
}
