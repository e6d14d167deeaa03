//! What a run is given from outside: its deadline, its cancellation, its seed.
//!
//! The only room of the core that may look at a clock.

mod control;
mod seed;

pub use control::{CancelToken, Control, Deadline};
pub use seed::{Rng, Seed};
