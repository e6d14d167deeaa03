//! Compiled workcells, kept across runs.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::collision::CollisionWorld;
use crate::motion::{Roadmap, first_roadmaps};
use crate::problem::Problem;
use crate::run::Control;
use crate::transition::ReachMemory;
use crate::workcell::ArmId;

use super::folder::{DEFAULT_BYTES, Folder};

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
    /// How much was known when it was kept in a folder last.
    kept: AtomicUsize,
}

impl CompiledWorkcell {
    /// Compiles the workcell of `problem` with the threads that its options allow, until `control`
    /// says stop.
    pub(super) fn new(problem: &Problem, control: &Control) -> Self {
        let world = CollisionWorld::new(problem);
        let threads = problem.options.threads.max(1);
        let (roadmaps, complete) = first_roadmaps(&problem.workcell, &world, threads, control);
        Self { world, roadmaps, memory: Arc::default(), complete, kept: AtomicUsize::new(0) }
    }

    /// All but the bodies, which are compiled as quickly as they could be read.
    fn words(&self) -> Vec<u64> {
        self.roadmaps.iter().flat_map(Roadmap::words).chain(self.memory.words()).collect()
    }

    /// The compiled workcell of `problem` from [`Self::words`]; `None` where these are not of it.
    fn from_words(problem: &Problem, words: &[u64]) -> Option<Self> {
        let words = &mut words.iter().copied();
        let arms = problem.workcell.arms.iter().enumerate();
        let roadmaps: Option<Vec<Roadmap>> =
            arms.map(|(index, arm)| Roadmap::from_words(ArmId(index), arm, words)).collect();
        let (roadmaps, memory) = (roadmaps?, ReachMemory::from_words(words)?);
        if words.next().is_some() {
            return None;
        }
        let world = CollisionWorld::new(problem);
        let found =
            Self { world, roadmaps, memory: Arc::new(memory), complete: true, kept: AtomicUsize::new(0) };
        found.kept.store(found.learned(), Ordering::Relaxed);
        Some(found)
    }

    /// How much is known that a run can add to.
    fn learned(&self) -> usize {
        1 + self.memory.len() + self.roadmaps.iter().map(Roadmap::shared_checks).sum::<usize>()
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

    /// In one line.
    fn text(&self) -> String {
        format!("{} {} {}", self.workcell, self.clearance, self.ik_solutions)
    }
}

/// A bounded number of compiled workcells, those used last; shared by threads.
#[derive(Debug)]
pub struct PlannerCache {
    capacity: usize,
    /// The one used last stands last.
    known: Mutex<Vec<(Key, Arc<CompiledWorkcell>)>>,
    /// Where they are kept for other processes and later ones.
    folder: Option<Folder>,
}

impl Default for PlannerCache {
    fn default() -> Self {
        Self::new(DEFAULT_CAPACITY)
    }
}

impl PlannerCache {
    /// An empty cache for at most `capacity` workcells; with 0 it keeps none.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, known: Mutex::default(), folder: None }
    }

    /// The cache with a folder in which workcells are kept for other processes and later ones, at most
    /// `bytes` of them (512 MiB by default); those go first that were not used for longest. What
    /// cannot be read or written there is compiled as if there were no folder.
    pub fn with_folder(self, path: &Path, bytes: Option<u64>) -> Self {
        Self { folder: Some(Folder::new(path, bytes.unwrap_or(DEFAULT_BYTES))), ..self }
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
        let stored = self.folder.as_ref().and_then(|folder| folder.load(&key.text()));
        let stored = stored.and_then(|words| CompiledWorkcell::from_words(problem, &words));
        let compiled = Arc::new(stored.unwrap_or_else(|| CompiledWorkcell::new(problem, control)));
        if compiled.complete {
            self.insert(key, compiled.clone());
        }
        compiled
    }

    /// Keeps in the folder what was found out since that was done last; without a folder, nothing.
    pub(super) fn keep(&self, problem: &Problem, compiled: &CompiledWorkcell) {
        let Some(folder) = &self.folder else { return };
        let learned = compiled.learned();
        if compiled.complete && compiled.kept.fetch_max(learned, Ordering::Relaxed) < learned {
            folder.save(&Key::of(problem).text(), &compiled.words());
        }
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
