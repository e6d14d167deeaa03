//! What a run is given from outside: its deadline, its cancellation, its seed, and a place to say where
//! its time went; how threads share work, and how a file is marked as used.
//!
//! The only room of the core that may look at a clock.

mod control;
mod seed;
mod share;
mod spent;
mod touch;

pub use control::{CancelToken, Control, Deadline};
pub use seed::{Rng, Seed};
pub use share::share;
pub use spent::{Part, Spent};
pub use touch::touch;
