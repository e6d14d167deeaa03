//! The SMART tree: Algorithm 1 of the paper, anytime.
//!
//! A vertex is (Q, tau): a composite configuration and the identifier of the sequence of actions
//! that led there. The names follow the paper: `select_mode` picks a tau, the guidance is asked
//! once for each, `sample_trans` grounds its next actions, `extend` plans the motion to them,
//! `modal_check` opens a new tau, `rewire` exchanges parents among vertices that differ in nothing but
//! their arms, `retrace` reads a plan off the tree.
//!
//! Probabilistic completeness rests on: [`Settings::goal_bias`] below 1 (every tau keeps a chance
//! of being selected), [`Settings::wander`] and [`Settings::stuck_wander`] above 0 (actions other than the
//! guided ones are tried, whatever they cost), transitions that keep being sampled, in holds in which none is
//! known too ([`Settings::fresh_transitions`] above 0), and roadmaps that keep growing ([`Settings::growth`]
//! above 0, with the PRM* degree), on which the composite search is complete. Asymptotic optimality in arc
//! length rests on the same, and on pruning by the incumbent's cost alone.
//!
//! Both are meant for the problem as the mode graph of the run knows it: its edges and the places of its
//! regions were sampled once, and rules learnt from many failures (`clashes.rs`) stand for the run. A step's
//! motion is planned as a whole (`step.rs`), so that a tau has few vertices and no tree of its own; and a step ends when
//! all its actions do.

mod candidate;
mod chain;
mod clashes;
mod crowding;
mod finish;
mod forecast;
mod ground;
mod handoffs;
mod leg;
mod map;
mod meetings;
mod outline;
mod refine;
mod rests;
mod resume;
mod rewire;
mod select;
mod settings;
mod smart;
mod step;
#[cfg(test)]
mod tests;
mod tree;

pub use candidate::Candidate;
pub use map::Map;
pub use resume::NotResumed;
pub use settings::Settings;
pub use smart::{Report, Search};
