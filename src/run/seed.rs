//! Seeds and named random streams.

use rand::SeedableRng;

/// The generator that every random choice uses.
pub type Rng = rand_pcg::Pcg64Mcg;

/// The seed of a run. Every user of randomness draws from its own named stream, so that adding
/// one draw in one place does not change what happens elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(pub u64);

impl Seed {
    /// The stream called `name`: the same seed and name give the same numbers, on every machine.
    pub fn stream(&self, name: &str) -> Rng {
        // FNV-1a, offset basis and prime for 64 bits.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64 ^ self.0.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        for byte in name.bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
        Rng::seed_from_u64(hash)
    }

    /// A seed that depends on all of `numbers` and their order.
    pub fn mixed(numbers: impl IntoIterator<Item = u64>) -> Self {
        // Multiplying by an odd number and turning keeps every bit's part in the result.
        let mix =
            |hash: u64, number: u64| (hash ^ number).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
        Self(numbers.into_iter().fold(0x243f_6a88_85a3_08d3, mix))
    }

    /// The seed of a numbered part of the run, such as one worker thread.
    pub fn part(&self, index: u64) -> Self {
        Self(self.0 ^ index.wrapping_mul(0xd1b5_4a32_d192_ed03))
    }
}
