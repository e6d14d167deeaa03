//! Arms as immutable kinematic models: forward kinematics, Jacobian, inverse kinematics.
//!
//! A model knows its own chain only, in the frame of its root link; where the arm stands is the
//! workcell's business. Models come from URDF text, the user's or the [`library`]'s.

mod chain;
mod inverse;
mod jacobian;
mod lever;
mod library;
mod model;
mod moving_frames;
mod sine;
mod srdf;
mod turns;
mod urdf;
mod xml;

pub use inverse::InverseMethod;
pub use lever::{Lever, Reach};
pub use library::{LibraryRobot, library, library_names};
pub use model::{ArmModel, Config, Joint, JointLimits, Link, LinkMotion};
pub use moving_frames::{Frame8, Frames8, MovingFrames};
pub use srdf::{SrdfError, disabled_link_pairs};
pub use urdf::{
    LimitFault, MAX_MESH_BYTES, MeshError, MeshFilled, MeshPieces, MeshResolver, NoMeshes, UrdfError,
    UrdfSize, UrdfWarning, read_mesh,
};
pub use xml::{MAX_XML_BYTES, MAX_XML_NODES, XmlError};
