//! Lanes in one AVX2 register, with fused multiply-add. The crate's second place for `unsafe`.
//!
//! Soundness: [`Avx2`] is known to this folder only, and the only thing that is ever
//! instantiated with it is a kernel in [`run`], whose caller has found both features. So every
//! call of an intrinsic happens on a processor that has it. All methods are `#[inline(always)]`:
//! they end up in [`run_with_features`], where the features are switched on.
#![allow(unsafe_code)]
#![cfg(target_arch = "x86_64")]

use core::arch::x86_64::*;
use std::ops::{Add, Mul, Neg, Sub};

use super::dispatch::Kernel;
use super::float8::{Bits8, Float8};

/// Eight f32 in one register.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256);

/// Proof that the processor has AVX2 and FMA.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Available(());

/// Looks whether the processor has what [`run`] asks for.
pub(super) fn available() -> Option<Available> {
    let found = std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
    found.then_some(Available(()))
}

/// Runs `kernel`.
#[inline]
pub(super) fn run<K: Kernel>(kernel: K, _proof: Available) -> K::Output {
    // SAFETY: the proof says that the processor has the features.
    unsafe { run_with_features(kernel) }
}

#[target_feature(enable = "avx2,fma")]
fn run_with_features<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

// SAFETY of every intrinsic below: see the head of the file.
impl Add for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(unsafe { _mm256_add_ps(self.0, other.0) })
    }
}

impl Sub for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
}

impl Mul for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
}

impl Neg for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
}

impl Float8 for Avx2 {
    type Mask = __m256;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    fn load(values: &[f32; 8]) -> Self {
        // SAFETY: the array holds eight f32; no alignment is asked for.
        Self(unsafe { _mm256_loadu_ps(values.as_ptr()) })
    }

    #[inline(always)]
    fn store(self) -> [f32; 8] {
        let mut out = [0.0; 8];
        // SAFETY: the array holds eight f32; no alignment is asked for.
        unsafe { _mm256_storeu_ps(out.as_mut_ptr(), self.0) };
        out
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, term.0) })
    }

    #[inline(always)]
    fn neg_mul_add(self, factor: Self, term: Self) -> Self {
        Self(unsafe { _mm256_fnmadd_ps(self.0, factor.0, term.0) })
    }

    #[inline(always)]
    fn div(self, divisor: Self) -> Self {
        Self(unsafe { _mm256_div_ps(self.0, divisor.0) })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(unsafe { _mm256_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(unsafe { _mm256_max_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }

    #[inline(always)]
    fn round(self) -> Self {
        Self(unsafe { _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0) })
    }

    #[inline(always)]
    fn less(self, other: Self) -> Self::Mask {
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { _mm256_and_ps(a, b) }
    }

    #[inline(always)]
    fn bits(mask: Self::Mask) -> Bits8 {
        (unsafe { _mm256_movemask_ps(mask) }) as Bits8
    }

    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm256_blendv_ps(no.0, yes.0, mask) })
    }

    #[inline(always)]
    fn turn_quarters(quarters: Self, sine: Self, cosine: Self) -> (Self, Self) {
        unsafe {
            let count = _mm256_cvtps_epi32(quarters.0);
            let swap = _mm256_castsi256_ps(_mm256_slli_epi32::<31>(count));
            let two = _mm256_set1_epi32(2);
            let sine_sign = _mm256_slli_epi32::<30>(_mm256_and_si256(count, two));
            let after = _mm256_add_epi32(count, _mm256_set1_epi32(1));
            let cosine_sign = _mm256_slli_epi32::<30>(_mm256_and_si256(after, two));
            let turned_sine = _mm256_blendv_ps(sine.0, cosine.0, swap);
            let turned_cosine = _mm256_blendv_ps(cosine.0, sine.0, swap);
            (
                Self(_mm256_xor_ps(turned_sine, _mm256_castsi256_ps(sine_sign))),
                Self(_mm256_xor_ps(turned_cosine, _mm256_castsi256_ps(cosine_sign))),
            )
        }
    }

    #[inline(always)]
    fn least(self) -> f32 {
        unsafe {
            let four = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
        }
    }

    #[inline(always)]
    fn greatest(self) -> f32 {
        unsafe {
            let four = _mm_max_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_movehdup_ps(two)))
        }
    }
}
