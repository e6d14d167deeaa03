//! A problem half read: what could not be read is `None`, so that the rest is checked all the same.

use super::homes::StatedHomes;
use super::placement::{ArmStart, End, Placed, Start};
use super::statics::AllowedContacts;
use crate::kinematics::Config;
use crate::problem::Options;
use crate::workcell::{Arm, ObjectModel, Obstacle, ObstacleId, Surface, SurfaceId};

/// What has been read, in the document's order.
#[derive(Debug)]
pub struct Draft {
    /// Arms.
    pub arms: Vec<Option<Arm>>,
    /// What their elements say of their homes.
    pub homes: StatedHomes,
    /// By arm, whether nobody says where it starts.
    pub assumed: Vec<bool>,
    /// Obstacles.
    pub obstacles: Vec<Option<Obstacle>>,
    /// Surfaces.
    pub surfaces: Vec<Option<Surface>>,
    /// What may touch.
    pub allowed: AllowedContacts,
    /// Objects.
    pub objects: Vec<Option<ObjectModel>>,
    /// By object, where it is.
    pub initial: Vec<Option<Placed<Start>>>,
    /// By object, where it shall go.
    pub goal: Vec<Option<Placed<End>>>,
    /// By arm, where it starts.
    pub starts: Vec<Option<ArmStart>>,
    /// Options.
    pub options: Options,
}

impl Draft {
    /// The obstacle that carries `surface`.
    pub fn carrier(&self, surface: SurfaceId) -> Option<ObstacleId> {
        self.surfaces.get(surface.0)?.as_ref()?.carrier
    }

    /// Where an arm starts, if that is anywhere but at home.
    pub fn start_elsewhere(&self, arm: usize) -> Option<&Config> {
        match (self.arms.get(arm), self.starts.get(arm)) {
            (Some(Some(arm)), Some(Some((start, _)))) if *start != arm.home => Some(start),
            _ => None,
        }
    }
}
