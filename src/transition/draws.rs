//! Places where two arms may hand over, drawn at random once and remembered.
//!
//! Whether inverse kinematics brings two hands together depends on the two arms, on how their bases stand to each other,
//! and on how their hands do; not on the object, and not on where in the workcell they are. So all such draws of equal
//! stances are one numbered sequence, and the draw of a number is the same whoever asks for it, and whether it was asked
//! for before. Of those that hit it is remembered, too, whether the handoff of an object of a class is free of collision,
//! and by which lines.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::kinematics::Config;
use crate::run::{Rng, Seed};
use crate::workcell::ArmId;

use super::grains::Grains;
use super::line::Line;
use super::memory::Class;

/// Draws of one sequence that are remembered; further ones are nobody's but the asker's.
pub(super) const MOST_DRAWN: usize = 64;

/// What all draws may take up (bytes, about); beyond it all are forgotten.
const MOST_BYTES: usize = 24 << 20;

/// How two arms and their hands stand to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Stance {
    /// The receiver's TCP frame in the giver's; first, since it is what tells most stances apart.
    pub(super) hands: Grains,
    /// The receiver's base frame in the giver's.
    pub(super) bases: Grains,
    /// The giver's kind and the receiver's.
    pub(super) kinds: (usize, usize),
}

impl Stance {
    /// The stream of the draw with this number.
    fn stream(&self, number: usize) -> Rng {
        let numbers = [self.kinds.0 as u64, self.kinds.1 as u64, number as u64];
        let poses = self.bases.numbers().into_iter().chain(self.hands.numbers());
        Seed::mixed(numbers.into_iter().chain(poses)).stream("handoff/draw")
    }
}

/// Two arms, an object by its class and how the giver holds it, and which configurations of a [`Meeting`] they are in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Grounded {
    pub(super) arms: (ArmId, ArmId),
    pub(super) class: Class,
    pub(super) giver_hold: Grains,
    pub(super) configurations: (usize, usize),
}

/// The giver's line after the release and the receiver's before the grasp.
pub(super) type Lines = Arc<(Line, Line)>;

/// A draw that hit: configurations of the giver and of the receiver, every one of which goes with every other.
#[derive(Debug)]
pub(super) struct Meeting {
    pub(super) giving: Vec<Config>,
    pub(super) taking: Vec<Config>,
    /// Whether it is one of a [`Sequence`], and not somebody's own.
    is_kept: bool,
    /// What is known of handoffs here; `None` where a collision is in the way.
    grounded: Mutex<BTreeMap<Grounded, Option<Lines>>>,
}

impl Meeting {
    /// One that nobody else will look at.
    pub(super) fn passing(giving: Vec<Config>, taking: Vec<Config>) -> Self {
        Self { giving, taking, is_kept: false, grounded: Mutex::default() }
    }

    /// The lines of a handoff here, by `ground` where nobody asked for it before.
    pub(super) fn lines(
        &self,
        asked: Grounded,
        draws: &Draws,
        ground: impl FnOnce() -> Option<(Line, Line)>,
    ) -> Option<Lines> {
        if !self.is_kept {
            return ground().map(Arc::new);
        }
        if let Some(known) = lock(&self.grounded).get(&asked) {
            return known.clone();
        }
        let found = ground().map(Arc::new);
        let waypoints = found.as_ref().map_or(0, |lines| lines.0.waypoints.len() + lines.1.waypoints.len());
        draws.add(size_of::<(Grounded, Lines)>() + waypoints * size_of::<Config>());
        lock(&self.grounded).insert(asked, found.clone());
        found
    }
}

/// The draws of one stance.
#[derive(Debug, Default)]
pub(super) struct Sequence {
    fits: OnceLock<bool>,
    /// By number; `None` for a miss.
    drawn: Mutex<Vec<Option<Arc<Meeting>>>>,
}

impl Sequence {
    /// Whether the hands are clear of each other, by `find` where nobody asked before.
    pub(super) fn fits(&self, find: impl FnOnce() -> bool) -> bool {
        *self.fits.get_or_init(find)
    }

    /// The draw with this number, less than [`MOST_DRAWN`]; `draw` makes those that nobody asked for before.
    pub(super) fn get(
        &self,
        stance: &Stance,
        number: usize,
        draws: &Draws,
        mut draw: impl FnMut(&mut Rng) -> Option<(Vec<Config>, Vec<Config>)>,
    ) -> Option<Arc<Meeting>> {
        let mut drawn = lock(&self.drawn);
        while drawn.len() <= number {
            let meeting = draw(&mut stance.stream(drawn.len())).map(|(giving, taking)| {
                Arc::new(Meeting { giving, taking, is_kept: true, grounded: Mutex::default() })
            });
            let configurations =
                meeting.as_ref().map_or(0, |meeting| meeting.giving.len() + meeting.taking.len());
            draws.add(size_of::<Meeting>() + configurations * size_of::<Config>());
            drawn.push(meeting);
        }
        drawn[number].clone()
    }
}

/// All draws in one workcell, bounded in number, shared by threads and runs.
#[derive(Debug, Default)]
pub(super) struct Draws {
    sequences: Mutex<BTreeMap<Stance, Arc<Sequence>>>,
    /// Bytes in use, about.
    bytes: AtomicUsize,
}

impl Draws {
    /// The sequence of a stance.
    pub(super) fn of(&self, stance: &Stance) -> Arc<Sequence> {
        let mut sequences = lock(&self.sequences);
        if self.bytes() > MOST_BYTES {
            // Whoever has one at hand keeps it as long as it is needed.
            sequences.clear();
            self.bytes.store(0, Ordering::Relaxed);
        }
        if let Some(known) = sequences.get(stance) {
            return known.clone();
        }
        self.add(size_of::<(Stance, Sequence)>());
        sequences.entry(*stance).or_default().clone()
    }

    /// How much they take up (about).
    pub(super) fn bytes(&self) -> usize {
        self.bytes.load(Ordering::Relaxed)
    }

    /// As when there are too many.
    #[cfg(test)]
    pub(super) fn forget(&self) {
        self.add(MOST_BYTES + 1);
    }

    fn add(&self, bytes: usize) {
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
    }
}

/// Whoever panics leaves all as it was.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
