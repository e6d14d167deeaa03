//! Compiled workcells, kept across runs.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::collision::CollisionWorld;
use crate::motion::{Roadmap, first_roadmaps};
use crate::problem::Problem;
use crate::run::Control;
use crate::transition::ReachMemory;

/// Workcells that a cache keeps unless told otherwise.
const DEFAULT_CAPACITY: usize = 16;

/// What every run on one workcell needs and none changes: bodies, roadmaps, and what was found out
/// about reach. A run gets the same results from one that was used before as from a fresh one.
#[derive(Debug)]
pub(super) struct CompiledWorkcell {
    /// With the objects of some problem.
    world: CollisionWorld,
    roadmaps: Vec<Roadmap>,
    memory: Arc<ReachMemory>,
    /// Whether it was built to the end.
    complete: bool,
}

impl CompiledWorkcell {
    /// Compiles the workcell of `problem` with the threads that its options allow, until `control`
    /// says stop.
    pub(super) fn new(problem: &Problem, control: &Control) -> Self {
        let world = CollisionWorld::new(problem);
        let threads = problem.options.threads.max(1);
        let (roadmaps, complete) = first_roadmaps(&problem.workcell, &world, threads, control);
        Self { world, roadmaps, memory: Arc::default(), complete }
    }

    /// The bodies of the workcell with the objects of `problem`.
    pub(super) fn world(&self, problem: &Problem) -> CollisionWorld {
        self.world.with_objects_of(problem)
    }

    /// Roadmaps to begin with.
    pub(super) fn roadmaps(&self) -> &[Roadmap] {
        &self.roadmaps
    }

    /// What is known about reach.
    pub(super) fn memory(&self) -> Arc<ReachMemory> {
        self.memory.clone()
    }
}

/// What a compiled workcell depends on.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Key {
    workcell: String,
    clearance: u64,
    ik_solutions: usize,
}

impl Key {
    fn of(problem: &Problem) -> Self {
        Self {
            workcell: problem.workcell_digest.clone(),
            clearance: problem.options.clearance_m.to_bits(),
            ik_solutions: problem.options.ik_solutions,
        }
    }
}

/// A bounded number of compiled workcells, those used last; shared by threads.
#[derive(Debug)]
pub struct PlannerCache {
    capacity: usize,
    /// The one used last stands last.
    known: Mutex<Vec<(Key, Arc<CompiledWorkcell>)>>,
}

impl Default for PlannerCache {
    fn default() -> Self {
        Self::new(DEFAULT_CAPACITY)
    }
}

impl PlannerCache {
    /// An empty cache for at most `capacity` workcells; with 0 it keeps none.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, known: Mutex::default() }
    }

    /// How many workcells it holds.
    pub fn len(&self) -> usize {
        self.known().len()
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Makes the workcell of `problem` ready, all that a run does before it looks at the arrangements:
    /// compiles it unless it is known. Returns how many arms have their bodies and roadmaps.
    pub fn prepare(&self, problem: &Problem, control: &Control) -> usize {
        let compiled = self.get(problem, control);
        let _bodies = compiled.world(problem);
        compiled.roadmaps().to_vec().len()
    }

    /// The compiled workcell of `problem`: the one known, or a new one, which is kept if it could be
    /// built to the end. Two runs that ask for the same new one at once may both build it.
    pub(super) fn get(&self, problem: &Problem, control: &Control) -> Arc<CompiledWorkcell> {
        let key = Key::of(problem);
        if let Some(found) = self.lookup(&key) {
            return found;
        }
        let compiled = Arc::new(CompiledWorkcell::new(problem, control));
        if compiled.complete {
            self.insert(key, compiled.clone());
        }
        compiled
    }

    fn known(&self) -> MutexGuard<'_, Vec<(Key, Arc<CompiledWorkcell>)>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lookup(&self, key: &Key) -> Option<Arc<CompiledWorkcell>> {
        let mut known = self.known();
        let at = known.iter().position(|(other, _)| other == key)?;
        let entry = known.remove(at);
        let found = entry.1.clone();
        known.push(entry);
        Some(found)
    }

    fn insert(&self, key: Key, compiled: Arc<CompiledWorkcell>) {
        let mut known = self.known();
        known.retain(|(other, _)| *other != key);
        known.push((key, compiled));
        let surplus = known.len().saturating_sub(self.capacity);
        known.drain(..surplus);
    }
}
