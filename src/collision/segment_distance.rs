//! Distances between segments and boxes: the cores of capsules and boxes.

use crate::geometry::Vec3;

/// Squared distance (m^2) between the segments `p0 p1` and `q0 q1` (either may be a point).
///
/// Closest points of two segments by clamping the unconstrained minimiser (Ericson, Real-Time
/// Collision Detection, section 5.1.9).
#[inline]
pub fn segment_segment_squared(p0: &Vec3, p1: &Vec3, q0: &Vec3, q1: &Vec3) -> f64 {
    const TINY: f64 = 1e-18;
    let d1 = p1 - p0;
    let d2 = q1 - q0;
    let r = p0 - q0;
    let a = d1.norm_squared();
    let e = d2.norm_squared();
    let f = d2.dot(&r);
    let (s, t);
    if a <= TINY && e <= TINY {
        return r.norm_squared();
    }
    if a <= TINY {
        s = 0.0;
        t = (f / e).clamp(0.0, 1.0);
    } else {
        let c = d1.dot(&r);
        if e <= TINY {
            t = 0.0;
            s = (-c / a).clamp(0.0, 1.0);
        } else {
            let b = d1.dot(&d2);
            let denominator = a * e - b * b;
            let s_free =
                if denominator > TINY { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
            let t_free = (b * s_free + f) / e;
            if t_free < 0.0 {
                t = 0.0;
                s = (-c / a).clamp(0.0, 1.0);
            } else if t_free > 1.0 {
                t = 1.0;
                s = ((b - c) / a).clamp(0.0, 1.0);
            } else {
                t = t_free;
                s = s_free;
            }
        }
    }
    (r + d1 * s - d2 * t).norm_squared()
}

/// Distance (m) from the segment `p0 p1` to the axis-aligned box with half extents `half` around
/// the origin; 0 when they meet.
///
/// The squared distance along the segment is convex and piecewise quadratic; its derivative is
/// monotone and piecewise linear with breaks where the segment crosses a face's plane, so the
/// minimum lies between two neighbouring breaks.
#[inline]
pub fn segment_box(p0: &Vec3, p1: &Vec3, half: &Vec3) -> f64 {
    let d = p1 - p0;
    let mut breaks = [0.0_f64; 8];
    let mut count = 1;
    for i in 0..3 {
        if d[i].abs() > 1e-12 {
            for face in [-half[i], half[i]] {
                let t = (face - p0[i]) / d[i];
                if t > 0.0 && t < 1.0 {
                    breaks[count] = t;
                    count += 1;
                }
            }
        }
    }
    breaks[count] = 1.0;
    count += 1;
    breaks[..count].sort_unstable_by(f64::total_cmp);
    let excess = |t: f64| -> Vec3 {
        let p = p0 + d * t;
        Vec3::from_fn(|i, _| {
            if p[i] > half[i] {
                p[i] - half[i]
            } else if p[i] < -half[i] {
                p[i] + half[i]
            } else {
                0.0
            }
        })
    };
    let slope = |t: f64| excess(t).dot(&d);
    if slope(0.0) >= 0.0 {
        return excess(0.0).norm();
    }
    if slope(1.0) <= 0.0 {
        return excess(1.0).norm();
    }
    let mut low = (0.0, slope(0.0));
    for &t in &breaks[1..count] {
        let here = slope(t);
        if here >= 0.0 {
            // The derivative is linear between the two breaks.
            let span = here - low.1;
            let best = if span > 0.0 { low.0 + (t - low.0) * (-low.1 / span) } else { t };
            return excess(best).norm();
        }
        low = (t, here);
    }
    excess(1.0).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    fn point(rng: &mut crate::run::Rng) -> Vec3 {
        Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0))
    }

    #[test]
    fn segments_agree_with_dense_sampling() {
        let mut rng = crate::run::Seed(1).stream("segments");
        for _ in 0..200 {
            let [p0, p1, q0, q1] = std::array::from_fn(|_| point(&mut rng));
            let exact = segment_segment_squared(&p0, &p1, &q0, &q1).sqrt();
            let mut least = f64::INFINITY;
            for i in 0..=60 {
                let p = p0 + (p1 - p0) * (f64::from(i) / 60.0);
                for j in 0..=60 {
                    let q = q0 + (q1 - q0) * (f64::from(j) / 60.0);
                    least = least.min((p - q).norm());
                }
            }
            assert!(exact <= least + 1e-12 && least - exact < 0.05, "{exact} {least}");
        }
    }

    #[test]
    fn segment_against_box_agrees_with_dense_sampling() {
        let mut rng = crate::run::Seed(2).stream("boxes");
        for _ in 0..1000 {
            let (p0, p1) = (point(&mut rng), point(&mut rng));
            let half = Vec3::from_fn(|_, _| rng.random_range(0.01..0.5));
            let exact = segment_box(&p0, &p1, &half);
            let mut least = f64::INFINITY;
            for i in 0..=2000 {
                let p = p0 + (p1 - p0) * (f64::from(i) / 2000.0);
                let out = Vec3::from_fn(|k, _| (p[k].abs() - half[k]).max(0.0));
                least = least.min(out.norm());
            }
            assert!(exact <= least + 1e-9 && least - exact < 2e-3, "{exact} {least}");
        }
    }
}
