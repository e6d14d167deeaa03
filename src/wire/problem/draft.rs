//! A problem half read: what could not be read is `None`, so that the rest is checked all the same.

use super::placement::{End, Placed, Start};
use super::statics::AllowedContacts;
use crate::kinematics::Config;
use crate::problem::Options;
use crate::workcell::{Arm, ObjectModel, Obstacle, ObstacleId, Surface, SurfaceId};

/// What has been read, in the document's order.
#[derive(Debug)]
pub struct Draft {
    /// Arms.
    pub arms: Vec<Option<Arm>>,
    /// By arm, whether its element has `home`.
    pub has_home: Vec<bool>,
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
    /// By arm, where it starts, and the JSON pointer of its entry in `initial_joints`.
    pub starts: Vec<Option<(Config, Option<String>)>>,
    /// Options.
    pub options: Options,
}

impl Draft {
    /// The obstacle that carries `surface`.
    pub fn carrier(&self, surface: SurfaceId) -> Option<ObstacleId> {
        self.surfaces.get(surface.0)?.as_ref()?.carrier
    }

    /// The JSON pointer of what decides an arm's home.
    pub fn home_pointer(&self, arm: usize) -> String {
        let home = if self.has_home.get(arm).copied().unwrap_or(false) { "/home" } else { "" };
        format!("/workcell/arms/{arm}{home}")
    }

    /// Whether an arm starts anywhere but at home.
    pub fn starts_elsewhere(&self, arm: usize) -> bool {
        match (self.arms.get(arm), self.starts.get(arm)) {
            (Some(Some(arm)), Some(Some((start, _)))) => *start != arm.home,
            _ => false,
        }
    }
}
