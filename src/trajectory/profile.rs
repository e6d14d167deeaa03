//! Motion along one straight piece: speeds by phases of constant acceleration, and the time of
//! rest-to-rest motions.

use smallvec::SmallVec;

use crate::kinematics::JointLimits;

/// The shortest phase that is ever made (s): a little over the spacing that FORMAT asks for, so
/// that rounding of times cannot undercut it.
pub(super) const SHORTEST_PHASE_S: f64 = 1.0001e-3;

/// What a straight piece allows: greatest speed and acceleration along it, in its own unit of
/// length per second.
#[derive(Debug, Clone, Copy)]
pub(super) struct Along {
    pub(super) speed: f64,
    pub(super) acceleration: f64,
}

/// A phase of constant acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phase {
    pub(super) duration: f64,
    pub(super) end_speed: f64,
}

/// The phases of a piece, in order.
pub(super) type Phases = SmallVec<[Phase; 3]>;

/// The least time (s) from `start` to `end` (speeds) over `length`: accelerate, cruise, brake.
/// Any phase may be as short as it likes. The end speeds must be reachable from each other.
pub(super) fn travel_time(start: f64, end: f64, length: f64, along: Along) -> f64 {
    let Along { speed, acceleration } = along;
    let squares = 0.5 * (start * start + end * end);
    let peak = (acceleration * length + squares).max(0.0).sqrt();
    if peak <= speed {
        (2.0 * peak - start - end) / acceleration
    } else {
        let ramps = (2.0 * speed - start - end) / acceleration;
        ramps + (length - (speed * speed - squares) / acceleration) / speed
    }
}

/// The least time (s) from rest to rest over `distance` under the speed and acceleration given.
fn rest_to_rest(distance: f64, speed: f64, acceleration: f64) -> f64 {
    travel_time(0.0, 0.0, distance, Along { speed, acceleration })
}

/// The least time (s) in which joints with these `limits` can go from rest at `from` to rest at
/// `to`: the slowest joint's own. No trajectory between the two is shorter.
pub fn minimum_time(from: &[f64], to: &[f64], limits: &[JointLimits]) -> f64 {
    let joints = from.iter().zip(to).zip(limits);
    joints.map(|((a, b), l)| rest_to_rest((b - a).abs(), l.velocity, l.acceleration)).fold(0.0, f64::max)
}

/// The phases from `start` to `end` (speeds) over `length`, every one at least
/// [`SHORTEST_PHASE_S`] long: the fastest profile where its phases are long enough, else the
/// fastest of a few that trade acceleration for length of phase.
///
/// Expects what the corner pass guarantees: `length >= SHORTEST_PHASE_S * max(start, end)`,
/// positive, and |end^2 - start^2| <= 2 * acceleration * length.
pub(super) fn phases(start: f64, end: f64, length: f64, along: Along) -> Phases {
    let Along { speed, acceleration } = along;
    let least = SHORTEST_PHASE_S;
    let ramp = |from: f64, to: f64| (to - from).abs() / acceleration;
    let peak = (acceleration * length + 0.5 * (start * start + end * end)).sqrt();
    if peak <= speed {
        let (up, down) = (ramp(start, peak), ramp(peak, end));
        if up >= least && down >= least {
            return pieces(&[(up, peak), (down, end)]);
        }
    } else {
        let needed = |from: f64| if from == speed { 0.0 } else { ramp(from, speed).max(least) };
        let (up, down) = (needed(start), needed(end));
        let ramps = 0.5 * ((start + speed) * up + (speed + end) * down);
        let cruise = (length - ramps) / speed;
        if cruise >= least {
            return pieces(&[(up, speed), (cruise, speed), (down, end)]);
        }
        if cruise >= 0.0 && up > 0.0 && down > 0.0 {
            let factor = length / ramps;
            return pieces(&[(up * factor, speed), (down * factor, end)]);
        }
    }
    shortened(start, end, length, along)
}

/// The fastest profile of one or two phases in which a phase that would be too short takes
/// [`SHORTEST_PHASE_S`].
fn shortened(start: f64, end: f64, length: f64, along: Along) -> Phases {
    let Along { speed, acceleration } = along;
    let least = SHORTEST_PHASE_S;
    let mut best: Option<(f64, Phases)> = None;
    let mut offer = |profile: &[(f64, f64)]| {
        let total = profile.iter().map(|phase| phase.0).sum::<f64>();
        if total.is_finite() && best.as_ref().is_none_or(|(time, _)| total < *time) {
            best = Some((total, pieces(profile)));
        }
    };
    if start + end > 0.0 {
        offer(&[(2.0 * length / (start + end), end)]);
    }
    // Both phases of the least length.
    let middle = length / least - 0.5 * (start + end);
    let reach = acceleration * least * (1.0 + 1e-12);
    if (0.0..=speed).contains(&middle) && (middle - start).abs() <= reach && (middle - end).abs() <= reach {
        offer(&[(least, middle), (least, end)]);
    }
    // One phase of the least length, the other at full acceleration: p^2 + a h p = c.
    for (clamped, free) in [(start, end), (end, start)] {
        let half = 0.5 * acceleration * least;
        let square = half * half + free * free + 2.0 * acceleration * length - 2.0 * half * clamped;
        if square < 0.0 {
            continue;
        }
        let middle = square.sqrt() - half;
        let ramp = (middle - free) / acceleration;
        let fits = (0.0..=speed).contains(&middle) && (middle - clamped).abs() <= reach && ramp >= least;
        if fits && clamped == start {
            offer(&[(least, middle), (ramp, end)]);
        }
        if fits && clamped == end {
            offer(&[(ramp, middle), (least, end)]);
        }
    }
    best.map(|(_, phases)| phases).unwrap_or_default()
}

fn pieces(profile: &[(f64, f64)]) -> Phases {
    let kept = profile.iter().filter(|(duration, _)| *duration > 0.0);
    kept.map(|&(duration, end_speed)| Phase { duration, end_speed }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn length_of(start: f64, phases: &Phases) -> f64 {
        let mut from = start;
        let mut length = 0.0;
        for phase in phases {
            length += 0.5 * (from + phase.end_speed) * phase.duration;
            from = phase.end_speed;
        }
        length
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        /// Whatever the lengths and speeds, tiny ones included: phases are long enough, cover the
        /// length, end at the end speed, keep the limits, and lose little against the optimum.
        #[test]
        fn phases_keep_their_promises(
            exponent in -9.0..1.0_f64, a in 0.0..1.0_f64, b in 0.0..1.0_f64, still in 0..4,
            speed in 0.01..5.0_f64, acceleration in 0.1..50.0_f64,
        ) {
            let length = 10.0_f64.powf(exponent);
            let along = Along { speed, acceleration };
            let cap = speed.min(length / SHORTEST_PHASE_S);
            let mut start = if still & 1 == 0 { 0.0 } else { a * cap };
            let mut end = if still & 2 == 0 { 0.0 } else { b * cap };
            let most = 2.0 * acceleration * length;
            start = start.min((end * end + most).sqrt());
            end = end.min((start * start + most).sqrt());
            let phases = phases(start, end, length, along);
            prop_assert!(!phases.is_empty());
            prop_assert!((length_of(start, &phases) / length - 1.0).abs() < 1e-9);
            let mut from = start;
            for phase in &phases {
                prop_assert!(phase.duration >= SHORTEST_PHASE_S * (1.0 - 1e-9));
                prop_assert!(phase.end_speed >= 0.0 && phase.end_speed <= speed * (1.0 + 1e-12));
                prop_assert!((phase.end_speed - from).abs() <= acceleration * phase.duration * (1.0 + 1e-9));
                from = phase.end_speed;
            }
            prop_assert!((from - end).abs() < 1e-12);
            let total: f64 = phases.iter().map(|phase| phase.duration).sum();
            let ideal = travel_time(start, end, length, along);
            prop_assert!(total >= ideal - 1e-9);
            prop_assert!(total <= ideal + 4.0 * SHORTEST_PHASE_S, "{total} against {ideal}");
        }

        #[test]
        fn rest_to_rest_is_the_closed_form(d in 1e-3..3.0_f64, v in 0.1..3.0_f64, a in 0.5..20.0_f64) {
            let expected = if d >= v * v / a { d / v + v / a } else { 2.0 * (d / a).sqrt() };
            prop_assert!((rest_to_rest(d, v, a) - expected).abs() < 1e-12);
        }
    }
}
