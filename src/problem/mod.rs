//! A planning problem that has been validated: the workcell, the objects, where they are, where
//! they shall go, and the options of the run.
//!
//! A [`Problem`] can only be made by validation (`wire::problem`), so whoever holds one may rely
//! on it: ids resolve, poses are finite, objects rest, homes are free of collision.

mod options;

pub use options::{GuidanceKind, Objective, Options, Schedule, Stop};

use std::sync::Arc;

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::workcell::{ArmBody, ArmId, ObjectId, ObjectModel, ObstacleId, SurfaceId, Workcell};

/// Where an object is at the start.
#[derive(Debug, Clone)]
pub enum InitialPlacement {
    /// At rest on a surface.
    Resting {
        /// The object's frame in the world.
        pose: Pose,
        /// The surface under it.
        surface: SurfaceId,
    },
    /// In an arm's hand.
    Held {
        /// The arm.
        arm: ArmId,
        /// The object's frame in the TCP frame.
        object_in_tcp: Pose,
    },
}

/// Where an object shall be in the end.
#[derive(Debug, Clone)]
pub enum GoalPlacement {
    /// At this pose, up to the object's symmetry.
    Pose {
        /// The object's frame in the world.
        pose: Pose,
        /// The surface under it.
        surface: SurfaceId,
    },
    /// At rest anywhere on this surface.
    Surface(SurfaceId),
    /// At rest on any surface, in nobody's hand.
    Anywhere,
}

/// What an object may touch for good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ContactPartner {
    /// A body of an arm.
    Arm(ArmId, ArmBody),
    /// An obstacle.
    Obstacle(ObstacleId),
    /// Another object.
    Object(ObjectId),
}

/// A validated problem.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Its name; may be empty.
    pub name: String,
    /// `sha256:...` over the canonical document, FORMAT "problem_digest".
    pub digest: String,
    /// The same over the workcell alone, under which what is compiled of it is kept. Where an arm's start stands in for its
    /// home, what is compiled depends on that too, and so does this.
    pub workcell_digest: String,
    /// The workcell.
    pub workcell: Arc<Workcell>,
    /// The objects, in the document's order.
    pub objects: Vec<ObjectModel>,
    /// Where each object is, by object.
    pub initial: Vec<InitialPlacement>,
    /// Where each object shall go, by object.
    pub goal: Vec<GoalPlacement>,
    /// Where each arm starts, by arm.
    pub initial_joints: Vec<Config>,
    /// Pairs of which one is an object that `allowed_contacts` exempts, sorted. A pair of objects
    /// stands once, the lower id first.
    pub allowed_object_contacts: Vec<(ObjectId, ContactPartner)>,
    /// Options of the run.
    pub options: Options,
}

impl Problem {
    /// Whether `allowed_contacts` lets the object touch `partner` for good.
    pub fn may_touch(&self, object: ObjectId, partner: ContactPartner) -> bool {
        let pair = match partner {
            ContactPartner::Object(other) if other < object => (other, ContactPartner::Object(object)),
            _ => (object, partner),
        };
        self.allowed_object_contacts.binary_search(&pair).is_ok()
    }
}
