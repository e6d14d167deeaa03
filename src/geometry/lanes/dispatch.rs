//! Which instructions the kernels use, decided when the program runs.

use super::float8::Float8;
use super::portable::Portable;

/// A computation over lanes.
pub trait Kernel {
    /// What it answers.
    type Output;

    /// Computes with lanes of type `F`. Implement as `#[inline(always)]`.
    fn run<F: Float8>(self) -> Self::Output;
}

/// What the kernels run on: made by [`InstructionSet::best`] and [`InstructionSet::portable`] only,
/// so whoever holds one may use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InstructionSet(Choice);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Choice {
    #[cfg(target_arch = "x86_64")]
    Avx2Fma(super::avx2::Available),
    Portable,
}

impl InstructionSet {
    /// The fastest one that this processor has. With `QUADRILLE_SIMD=sse2` in the environment the
    /// portable one, whatever the processor has.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::env::var_os("QUADRILLE_SIMD").is_none_or(|wish| wish != "sse2")
            && let Some(proof) = super::avx2::available()
        {
            return Self(Choice::Avx2Fma(proof));
        }
        Self::portable()
    }

    /// The one that every processor has.
    pub fn portable() -> Self {
        Self(Choice::Portable)
    }

    /// Its name, for tables and logs.
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Choice::Avx2Fma(_) => "avx2+fma",
            Choice::Portable if cfg!(target_arch = "x86_64") => "sse2",
            Choice::Portable => "portable",
        }
    }

    /// Runs `kernel`.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Choice::Avx2Fma(proof) => super::avx2::run(kernel, proof),
            Choice::Portable => kernel.run::<Portable>(),
        }
    }
}
