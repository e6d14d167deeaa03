//! What the graph asks of whoever can ground picks, places and handoffs.

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// Whether an object at rest is taken or put down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RestAction {
    /// The object rests and the arm takes it.
    Pick,
    /// The arm holds the object and puts it down.
    Place,
}

impl RestAction {
    /// `pick` or `place`.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Pick => "pick",
            Self::Place => "place",
        }
    }
}

/// One way to hold an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// Which of the object's grasps; `None` for a hold that is none of them, such as the one in
    /// which an object starts.
    pub grasp: Option<usize>,
    /// The object's frame in the TCP frame.
    pub object_in_tcp: Pose,
}

/// A pick or a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RestContact {
    /// Which of the two.
    pub action: RestAction,
    /// Who does it.
    pub arm: ArmId,
    /// With what.
    pub object: ObjectId,
    /// Where the object rests (world).
    pub pose: Pose,
    /// On what.
    pub surface: SurfaceId,
}

/// Two arms in the midst of a handoff: the proof that they can.
#[derive(Debug, Clone, PartialEq)]
pub struct HandoffWitness {
    /// The giver's joints.
    pub giver_q: Config,
    /// The receiver's joints.
    pub receiver_q: Config,
    /// How the giver holds the object.
    pub giver_hold: Hold,
    /// How the receiver holds it.
    pub receiver_hold: Hold,
}

impl HandoffWitness {
    /// The handoff backwards in time.
    pub fn reversed(&self) -> Self {
        Self {
            giver_q: self.receiver_q.clone(),
            receiver_q: self.giver_q.clone(),
            giver_hold: self.receiver_hold,
            receiver_hold: self.giver_hold,
        }
    }
}

/// Which arm reaches what: questions that inverse kinematics and collision checks answer.
///
/// An answer "no" may be a failure of sampling; an answer "yes" must come with a collision-free
/// configuration and straight lines before and after it. Other arms, and other objects but those
/// named, are left out of account, the static workcell is not. Answers must be deterministic for a given sequence
/// of questions.
pub trait Reach {
    /// Holds among the object's grasps by which `arm` may be able to do `action` with `object` at
    /// rest at `pose` (world) on `surface`: all by which it can, and perhaps some by which it
    /// cannot. Meant to be cheap.
    fn possible_holds(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> Vec<Hold>;

    /// Whether `arm` can do `action` in the given hold.
    fn has_hold(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
        hold: &Hold,
    ) -> bool;

    /// Whether there is any hold by which it can.
    fn reaches(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> bool {
        let possible = self.possible_holds(action, arm, object, pose, surface);
        possible.iter().any(|hold| self.has_hold(action, arm, object, pose, surface, hold))
    }

    /// Whether `arm` seems to be able to do `action`: an estimate for placements that are looked at
    /// again before they are used. It needs a collision-free grasp, but not that the straight lines
    /// are free of collision, too.
    fn seems_to_reach(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> bool {
        self.reaches(action, arm, object, pose, surface)
    }

    /// A hold by which `contact` can be had, and joints of the arm there.
    fn contact(&mut self, contact: &RestContact) -> Option<(Hold, Config)>;

    /// Whether `contact` can be had in the given hold although `other` rests at `pose` (world).
    fn is_clear(&mut self, contact: &RestContact, hold: &Hold, other: ObjectId, pose: &Pose) -> bool;

    /// A handoff of `object` from `giver`, which has it in one of `giver_holds`, to `receiver`,
    /// which takes it in one of `receiver_holds`; `None` when none is found.
    fn handoff(
        &mut self,
        giver: ArmId,
        receiver: ArmId,
        object: ObjectId,
        giver_holds: &[Hold],
        receiver_holds: &[Hold],
    ) -> Option<HandoffWitness>;
}
