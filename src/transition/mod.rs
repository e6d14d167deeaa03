//! Grounded picks, places and handoffs: a grasp, a contact configuration, and the straight lines
//! before and after it (paper, section "Transition Sampler").
//!
//! A grounding is free of the static workcell, of the arm itself and of the object that it
//! handles; other objects and other arms are the motion's business, since they differ from step
//! to step.

mod contact;
mod contacts;
mod draws;
mod grains;
mod handoff;
mod hands;
mod line;
mod meeting_place;
mod memory;
mod reach;

pub use contact::{Contact, ContactKind, ContactQuery};
pub use contacts::Contacts;
pub use handoff::{HandoffContact, HandoffQuery, travel_time};
pub use line::{LINE_RUNOUT, Line};
pub use memory::ReachMemory;
pub use reach::SampledReach;

#[cfg(test)]
mod tests;
