//! Arms as immutable kinematic models: forward kinematics, Jacobian, inverse kinematics.
//!
//! A model knows its own chain only, in the frame of its root link; where the arm stands is the
//! workcell's business.

mod model;

pub use model::{ArmModel, Config, Joint, JointLimits, Link, LinkMotion};
