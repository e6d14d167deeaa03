//! A cylinder beside a capsule: along the capsule's axis the distance from the cylinder is convex.

use crate::geometry::{Pose, Vec3};

/// How closely (m) a distance is worked out.
const CLOSE: f64 = 1e-8;

/// Rounds after which what is known is said: a bound that is lower by what is still open.
const ROUNDS: usize = 40;

/// A lower bound (m) on the distance between a cylinder and a capsule. It is at least `need`, or short of that distance by
/// [`CLOSE`] at most; some negative value where they overlap. The cylinder is given by its frame (its axis is z), its radius
/// and half its length (m), the capsule by the ends of its axis and its radius (m).
///
/// Between two points of the axis, nearest to the cylinder is what lies between, where the distances fall from both: no nearer
/// than where the tangents there meet.
pub(super) fn cylinder_capsule(
    (frame, radius, half_length): (&Pose, f64, f64),
    (a, b, capsule_radius): (&Vec3, &Vec3, f64),
    need: f64,
) -> f64 {
    let to_cylinder = frame.rotation.inverse();
    let start = to_cylinder * (a - frame.translation.vector);
    let along = to_cylinder * (b - a);
    // The distance (m) of the point a part `t` along the axis, and how it grows.
    let look = |t: f64| {
        let p = start + along * t;
        let from_axis = (p.x * p.x + p.y * p.y).sqrt();
        let (beside, beyond) = (from_axis - radius, p.z.abs() - half_length);
        let outwards = || (p.x * along.x + p.y * along.y) / from_axis;
        let upwards = along.z * p.z.signum();
        match (beside > 0.0, beyond > 0.0) {
            (false, false) => (0.0, 0.0),
            (true, false) => (beside, outwards()),
            (false, true) => (beyond, upwards),
            (true, true) => {
                let distance = (beside * beside + beyond * beyond).sqrt();
                (distance, (beside * outwards() + beyond * upwards) / distance)
            }
        }
    };
    let (mut low, mut high) = ((0.0, look(0.0)), (1.0, look(1.0)));
    let nearer = if low.1.0 < high.1.0 { low.1.0 } else { high.1.0 };
    // Where the nearest point is an end, or an end overlaps.
    if nearer <= 0.0 || low.1.1 >= 0.0 || high.1.1 <= 0.0 {
        return if nearer <= 0.0 { f64::NEG_INFINITY } else { nearer - capsule_radius };
    }
    let mut bound = 0.0;
    for round in 0..ROUNDS {
        let ((x0, (f0, s0)), (x1, (f1, s1))) = (low, high);
        let meet = (f1 - f0 + s0 * x0 - s1 * x1) / (s0 - s1);
        bound = f0 + s0 * (meet - x0);
        if bound - capsule_radius >= need {
            break;
        }
        // Half way every few rounds, so that one end does not stay for long.
        let t = if round % 4 == 3 { (x0 + x1) / 2.0 } else { meet.clamp(x0, x1) };
        let (distance, slope) = look(t);
        if distance <= 0.0 {
            return f64::NEG_INFINITY;
        }
        if distance < capsule_radius || slope == 0.0 {
            return distance - capsule_radius;
        }
        if distance - bound <= CLOSE {
            break;
        }
        if slope < 0.0 {
            low = (t, (distance, slope));
        } else {
            high = (t, (distance, slope));
        }
    }
    bound.max(0.0) - capsule_radius
}
