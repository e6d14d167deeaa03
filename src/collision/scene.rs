//! What stands around the arms for one query: resting and held objects, and what is exempt.

use crate::geometry::Pose;
use crate::workcell::{ObjectId, ObstacleId};

/// An object in an arm's hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// Which object.
    pub object: ObjectId,
    /// Its frame in the TCP frame.
    pub object_in_tcp: Pose,
}

/// Contacts that are allowed for the duration of a motion, FORMAT "What may touch".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Exemption {
    /// The arm's hand may touch this object (resting, or in another arm's hand): it is within the
    /// approach or retreat of taking or releasing it.
    pub hand_with: Option<ObjectId>,
    /// The held object may touch this obstacle: the carrier of the surface that it leaves or
    /// comes to.
    pub held_with: Option<ObstacleId>,
}

/// The objects at rest.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Each object at rest and its frame in the world.
    pub resting: Vec<(ObjectId, Pose)>,
}
