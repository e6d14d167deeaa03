//! What can be wrong with a URDF.

use super::mesh::{MeshError, MeshFilled};
use crate::kinematics::JointLimits;
use crate::kinematics::xml::XmlError;

/// Why a URDF did not become an arm.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UrdfError {
    /// The text is no acceptable XML.
    #[error(transparent)]
    Xml(#[from] XmlError),
    /// The root element is not `<robot>`.
    #[error("the root element is <{found}>, expected <robot>")]
    NotARobot {
        /// The root element's name.
        found: String,
    },
    /// An element lacks an attribute or a child that it must have.
    #[error("{place} has no {what}")]
    Missing {
        /// The element.
        place: String,
        /// What it lacks.
        what: &'static str,
    },
    /// A value that is not what is expected there.
    #[error("{place}: \"{text}\" is not {expected}")]
    BadValue {
        /// Element and attribute.
        place: String,
        /// The text that was found (cut short).
        text: String,
        /// What was expected.
        expected: &'static str,
    },
    /// More links or collision shapes than are taken.
    #[error("the robot has {count} {what}, at most {most} are taken; give a simpler model of it")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many are taken.
        most: usize,
    },
    /// Two readers of the same text differ.
    #[error(
        "{place}: two readers do not agree on its {what}; write it in the plainest way that the URDF format has"
    )]
    Disputed {
        /// The element.
        place: String,
        /// In what they differ.
        what: &'static str,
    },
    /// A number is NaN or infinite.
    #[error("{place}: \"{text}\" is not finite")]
    NotFinite {
        /// Element and attribute.
        place: String,
        /// The text that was found (cut short).
        text: String,
    },
    /// A number is beyond what an arm can have.
    #[error("{place}: {value} is beyond +-{limit}")]
    OutOfRange {
        /// Element and attribute.
        place: String,
        /// The number.
        value: f64,
        /// The greatest accepted magnitude.
        limit: f64,
    },
    /// A size that is zero or negative.
    #[error("{place}: size {value} must be positive")]
    SizeNotPositive {
        /// Element and attribute.
        place: String,
        /// The size (m).
        value: f64,
    },
    /// Two links or two joints have one name.
    #[error("two {kind} are named \"{name}\"")]
    DuplicateName {
        /// `links` or `joints`.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// A joint names a link that is not there.
    #[error("joint \"{joint}\" names link \"{link}\", which does not exist")]
    UnknownLink {
        /// The joint.
        joint: String,
        /// The link that it names.
        link: String,
    },
    /// There is no link to carry the tool.
    #[error("there is no link \"{name}\"; the closest names are {}", quoted(.closest))]
    NoSuchMountLink {
        /// The name that was asked for.
        name: String,
        /// The most similar link names.
        closest: Vec<String>,
    },
    /// There is no link at all.
    #[error("the robot has no link")]
    NoLinks,
    /// A link is the child of two joints.
    #[error("link \"{link}\" is the child of two joints, \"{first}\" and \"{second}\"")]
    TwoParents {
        /// The link.
        link: String,
        /// One joint.
        first: String,
        /// The other joint.
        second: String,
    },
    /// Several links have no parent.
    #[error("more than one link has no parent joint: {}", quoted(.roots))]
    SeveralRoots {
        /// Some of these links.
        roots: Vec<String>,
    },
    /// Links hang on each other in a circle.
    #[error("link \"{link}\" is part of a cycle of joints")]
    Cycle {
        /// A link of the cycle or below it.
        link: String,
    },
    /// The joint type cannot be used on the way to the mount link.
    #[error(
        "joint \"{joint}\" of type {kind} is on the way to the mount link; \
         only revolute, continuous, prismatic and fixed joints may be"
    )]
    UnsupportedJoint {
        /// The joint.
        joint: String,
        /// Its type.
        kind: &'static str,
    },
    /// A revolute or prismatic joint of the chain has no limit.
    #[error("joint \"{joint}\" has no <limit>")]
    NoLimit {
        /// The joint.
        joint: String,
    },
    /// Limits that cannot be.
    #[error("joint \"{joint}\": {fault}")]
    BadLimit {
        /// The joint.
        joint: String,
        /// What is wrong.
        fault: LimitFault,
    },
    /// A movable joint's axis is zero.
    #[error("joint \"{joint}\" has a zero axis")]
    ZeroAxis {
        /// The joint.
        joint: String,
    },
    /// A mimic joint follows a joint that is not there, or not movable.
    #[error("joint \"{joint}\" mimics \"{target}\", which is not a movable joint of this robot")]
    BadMimic {
        /// The joint.
        joint: String,
        /// The joint that it follows.
        target: String,
    },
    /// Mimic joints follow each other in a circle, or over more than 100 joints.
    #[error("joint \"{joint}\" mimics itself through others, or follows more than 100 joints")]
    MimicCycle {
        /// A joint of the circle.
        joint: String,
    },
    /// A value was given for a joint that is not there.
    #[error("there is no joint \"{name}\"; the closest names are {}", quoted(.closest))]
    UnknownHeldJoint {
        /// The name.
        name: String,
        /// The most similar joint names.
        closest: Vec<String>,
    },
    /// A value was given for a joint that cannot hold one: fixed, mimic, planar or floating.
    #[error("joint \"{name}\" cannot be held at a value: it is {kind}")]
    NotHoldable {
        /// The joint.
        name: String,
        /// What it is.
        kind: &'static str,
    },
    /// A value for a held joint is NaN, infinite or absurd.
    #[error("the value {value} for joint \"{name}\" is not usable")]
    BadHeldValue {
        /// The joint.
        name: String,
        /// The value.
        value: f64,
    },
    /// No movable joint leads to the mount link.
    #[error("no movable joint leads from the root to link \"{mount}\"")]
    NoMovableJoint {
        /// The mount link.
        mount: String,
    },
    /// A mesh could not be had or read.
    #[error("link \"{link}\", mesh \"{uri}\": {error}")]
    Mesh {
        /// The link.
        link: String,
        /// The mesh's URI (cut short).
        uri: String,
        /// What is wrong.
        error: MeshError,
    },
}

/// What is wrong with a joint's limits.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LimitFault {
    /// Lower above upper.
    #[error("the lower limit {lower} is above the upper limit {upper}")]
    Crossed {
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// A negative velocity or acceleration.
    #[error("the limit {value} of velocity or acceleration is negative")]
    Negative {
        /// The value.
        value: f64,
    },
}

impl LimitFault {
    /// What is wrong with `limits` that a URDF gives; a velocity or acceleration of 0 is none there.
    pub(super) fn of(limits: &JointLimits) -> Option<Self> {
        if limits.lower > limits.upper {
            return Some(Self::Crossed { lower: limits.lower, upper: limits.upper });
        }
        Self::negative(limits)
    }

    /// The first of velocity and acceleration that is negative.
    pub fn negative(limits: &JointLimits) -> Option<Self> {
        let value = [limits.velocity, limits.acceleration].into_iter().find(|value| *value < 0.0)?;
        Some(Self::Negative { value })
    }
}

/// Something that loading decided by itself and the user should know.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UrdfWarning {
    /// A mesh counts as more than it is.
    #[error("link \"{link}\": mesh \"{uri}\" {filled}")]
    MeshFilled {
        /// The link.
        link: String,
        /// The mesh's URI.
        uri: String,
        /// How.
        filled: MeshFilled,
    },
    /// The second reader does not read the text, so that nothing confirms the first.
    #[error("read by one of two readers only, the other says: {why}")]
    ReadOnce {
        /// What the second reader says (cut short).
        why: String,
    },
    /// A joint of the chain cannot move.
    #[error("joint \"{joint}\" has equal lower and upper limits and cannot move")]
    NoRange {
        /// The joint.
        joint: String,
    },
    /// A joint outside the chain stands beyond its limits.
    #[error("joint \"{joint}\" is held at {value}, outside its limits {lower} to {upper}")]
    HeldOutsideLimits {
        /// The joint.
        joint: String,
        /// Where it stands.
        value: f64,
        /// Its lower limit.
        lower: f64,
        /// Its upper limit.
        upper: f64,
    },
}

fn quoted(names: &[String]) -> String {
    if names.is_empty() {
        return "none".to_owned();
    }
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}
