//! One joint on one piece of a curve, as a cubic in the time since the piece's start.

/// `q0 + v0 t + c2 t^2 + c3 t^3` for t in `[0, h]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cubic {
    q0: f64,
    v0: f64,
    c2: f64,
    c3: f64,
}

impl Cubic {
    /// The cubic through `q0` at 0 and `q1` at `h` with velocities `v0` and `v1` there.
    #[inline]
    pub(super) fn hermite(q0: f64, v0: f64, q1: f64, v1: f64, h: f64) -> Self {
        let slope = (q1 - q0) / h;
        Self { q0, v0, c2: (3.0 * slope - 2.0 * v0 - v1) / h, c3: (v0 + v1 - 2.0 * slope) / (h * h) }
    }

    #[inline]
    pub(super) fn position(&self, t: f64) -> f64 {
        self.q0 + t * (self.v0 + t * (self.c2 + t * self.c3))
    }

    #[inline]
    pub(super) fn velocity(&self, t: f64) -> f64 {
        self.v0 + t * (2.0 * self.c2 + t * 3.0 * self.c3)
    }

    #[inline]
    pub(super) fn acceleration(&self, t: f64) -> f64 {
        2.0 * self.c2 + 6.0 * self.c3 * t
    }

    /// Least and greatest position on `[from, to]`.
    pub(super) fn position_range(&self, from: f64, to: f64) -> (f64, f64) {
        let (a, b) = (self.position(from), self.position(to));
        let mut range = (a.min(b), a.max(b));
        for zero in self.standstills() {
            if zero > from && zero < to {
                let at = self.position(zero);
                range = (range.0.min(at), range.1.max(at));
            }
        }
        range
    }

    /// The real zeros of the velocity wherever they are; not finite where there is none.
    #[inline]
    pub(super) fn standstills(&self) -> [f64; 2] {
        // v0 + 2 c2 t + 3 c3 t^2, by the form that stays exact as c3 goes to zero.
        let discriminant = self.c2 * self.c2 - 3.0 * self.c3 * self.v0;
        let sum = -(self.c2 + discriminant.sqrt().copysign(self.c2));
        [sum / (3.0 * self.c3), self.v0 / sum]
    }

    /// Greatest |velocity| on `[from, to]`.
    #[inline]
    pub(super) fn max_speed(&self, from: f64, to: f64) -> f64 {
        let ends = self.velocity(from).abs().max(self.velocity(to).abs());
        let turn = -self.c2 / (3.0 * self.c3);
        if turn > from && turn < to { ends.max(self.velocity(turn).abs()) } else { ends }
    }

    /// Greatest |acceleration| on `[from, to]`.
    pub(super) fn max_acceleration(&self, from: f64, to: f64) -> f64 {
        self.acceleration(from).abs().max(self.acceleration(to).abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ends_are_met(q0 in -3.0..3.0, v0 in -2.0..2.0, q1 in -3.0..3.0, v1 in -2.0..2.0, h in 0.001..2.0) {
            let cubic = Cubic::hermite(q0, v0, q1, v1, h);
            prop_assert!((cubic.position(0.0) - q0).abs() < 1e-12);
            prop_assert!((cubic.position(h) - q1).abs() < 1e-11);
            prop_assert!((cubic.velocity(0.0) - v0).abs() < 1e-12);
            prop_assert!((cubic.velocity(h) - v1).abs() < 1e-8);
        }

        #[test]
        fn extremes_are_those_of_dense_samples(
            q0 in -3.0..3.0, v0 in -2.0..2.0, q1 in -3.0..3.0, v1 in -2.0..2.0, h in 0.1..2.0,
            a in 0.0..0.5, b in 0.5..1.0,
        ) {
            let cubic = Cubic::hermite(q0, v0, q1, v1, h);
            let (from, to) = (a * h, b * h);
            let (low, high) = cubic.position_range(from, to);
            let (speed, acceleration) = (cubic.max_speed(from, to), cubic.max_acceleration(from, to));
            let (mut least, mut most, mut fastest, mut hardest) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64, 0.0_f64);
            for k in 0..=2000 {
                let t = from + (to - from) * f64::from(k) / 2000.0;
                least = least.min(cubic.position(t));
                most = most.max(cubic.position(t));
                fastest = fastest.max(cubic.velocity(t).abs());
                hardest = hardest.max(cubic.acceleration(t).abs());
            }
            let step = (to - from) / 2000.0;
            prop_assert!(low <= least + 1e-9 && least - low <= speed * step + 1e-9);
            prop_assert!(high >= most - 1e-9 && high - most <= speed * step + 1e-9);
            prop_assert!(speed >= fastest - 1e-9 && speed - fastest <= acceleration * step + 1e-9);
            prop_assert!((acceleration - hardest).abs() < 1e-6 * (1.0 + hardest));
        }
    }
}
