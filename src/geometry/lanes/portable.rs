//! Lanes as plain arrays: what the compiler makes of them is SSE2 on x86-64, NEON on ARM.

// Lanes are counted: the same index goes through several arrays at once.
#![allow(clippy::needless_range_loop)]

use std::ops::{Add, Mul, Neg, Sub};

use super::float8::{Bits8, Float8};

/// Eight f32 side by side; products and sums are rounded each for itself.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub struct Portable([f32; 8]);

/// Applies an expression to every lane.
macro_rules! each {
    ($lane:ident => $value:expr) => {{
        let mut out = [0.0_f32; 8];
        let mut $lane = 0;
        while $lane < 8 {
            out[$lane] = $value;
            $lane += 1;
        }
        Portable(out)
    }};
}

impl Add for Portable {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        each!(i => self.0[i] + other.0[i])
    }
}

impl Sub for Portable {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        each!(i => self.0[i] - other.0[i])
    }
}

impl Mul for Portable {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        each!(i => self.0[i] * other.0[i])
    }
}

impl Neg for Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        each!(i => -self.0[i])
    }
}

impl Float8 for Portable {
    type Mask = [u32; 8];

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 8])
    }

    #[inline(always)]
    fn load(values: &[f32; 8]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn store(self) -> [f32; 8] {
        self.0
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        each!(i => self.0[i] * factor.0[i] + term.0[i])
    }

    #[inline(always)]
    fn neg_mul_add(self, factor: Self, term: Self) -> Self {
        each!(i => term.0[i] - self.0[i] * factor.0[i])
    }

    #[inline(always)]
    fn div(self, divisor: Self) -> Self {
        each!(i => self.0[i] / divisor.0[i])
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        each!(i => self.0[i].sqrt())
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        each!(i => if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        each!(i => if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        each!(i => self.0[i].abs())
    }

    #[inline(always)]
    fn round(self) -> Self {
        // Adding and taking away 1.5 * 2^23 leaves the nearest whole number of what is less than 2^22.
        const SHIFT: f32 = 12_582_912.0;
        each!(i => (self.0[i] + SHIFT) - SHIFT)
    }

    #[inline(always)]
    fn less(self, other: Self) -> Self::Mask {
        let mut mask = [0; 8];
        for i in 0..8 {
            mask[i] = if self.0[i] < other.0[i] { u32::MAX } else { 0 };
        }
        mask
    }

    #[inline(always)]
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        let mut mask = [0; 8];
        for i in 0..8 {
            mask[i] = a[i] & b[i];
        }
        mask
    }

    #[inline(always)]
    fn bits(mask: Self::Mask) -> Bits8 {
        let mut bits = 0;
        for (i, lane) in mask.iter().enumerate() {
            bits |= ((lane & 1) as Bits8) << i;
        }
        bits
    }

    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        each!(i => f32::from_bits((yes.0[i].to_bits() & mask[i]) | (no.0[i].to_bits() & !mask[i])))
    }

    #[inline(always)]
    fn turn_quarters(quarters: Self, sine: Self, cosine: Self) -> (Self, Self) {
        let mut out = (sine, cosine);
        for i in 0..8 {
            let count = quarters.0[i] as i32;
            let swap = 0_u32.wrapping_sub((count & 1) as u32);
            let (s, c) = (sine.0[i].to_bits(), cosine.0[i].to_bits());
            let sine_sign = ((count & 2) as u32) << 30;
            let cosine_sign = ((count.wrapping_add(1) & 2) as u32) << 30;
            out.0.0[i] = f32::from_bits(((s & !swap) | (c & swap)) ^ sine_sign);
            out.1.0[i] = f32::from_bits(((c & !swap) | (s & swap)) ^ cosine_sign);
        }
        out
    }

    #[inline(always)]
    fn least(self) -> f32 {
        let mut least = self.0[0];
        for i in 1..8 {
            least = if self.0[i] < least { self.0[i] } else { least };
        }
        least
    }

    #[inline(always)]
    fn greatest(self) -> f32 {
        let mut greatest = self.0[0];
        for i in 1..8 {
            greatest = if self.0[i] > greatest { self.0[i] } else { greatest };
        }
        greatest
    }
}
