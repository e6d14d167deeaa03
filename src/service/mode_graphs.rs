//! Mode graphs of registered workcells: those that are kept at hand, and whose turn it is to have one made.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::ApiError;

/// Mode graphs that are kept at hand.
const KEPT: usize = 16;
/// Most requests that wait while one mode graph is made.
const WAITING: usize = 4;
/// When a client that found no place may come back (s).
const RETRY_AFTER_S: u64 = 5;

/// Mode graphs that are kept, by digest and extents, and the making of others, one after the other.
pub struct ModeGraphs {
    kept: Mutex<BTreeMap<String, Arc<str>>>,
    /// One for the request whose graph is made, and for each that waits.
    places: Arc<Semaphore>,
    work: Arc<Semaphore>,
}

/// The right to make a mode graph.
#[derive(Debug)]
pub struct Turn {
    // The work is given back before the place.
    _work: OwnedSemaphorePermit,
    _place: OwnedSemaphorePermit,
}

impl Default for ModeGraphs {
    fn default() -> Self {
        let (places, work) = (Semaphore::new(WAITING + 1), Semaphore::new(1));
        Self { kept: Mutex::default(), places: Arc::new(places), work: Arc::new(work) }
    }
}

impl ModeGraphs {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Arc<str>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The graph that is kept under `key`.
    pub fn get(&self, key: &str) -> Option<Arc<str>> {
        self.lock().get(key).cloned()
    }

    /// Keeps a graph.
    pub fn keep(&self, key: String, graph: Arc<str>) {
        let mut kept = self.lock();
        while kept.len() >= KEPT {
            kept.pop_first();
        }
        kept.insert(key, graph);
    }

    /// Waits for the turn to make one.
    ///
    /// # Errors
    /// [`ApiError::TooManyModeGraphs`] when as many wait as may.
    pub async fn turn(&self) -> Result<Turn, ApiError> {
        let full = ApiError::TooManyModeGraphs { retry_after_s: RETRY_AFTER_S };
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| full)?;
        let work = Arc::clone(&self.work).acquire_owned().await.map_err(|_| ApiError::Unavailable)?;
        Ok(Turn { _work: work, _place: place })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn one_is_made_few_wait_and_the_rest_is_refused() {
        let graphs = ModeGraphs::default();
        let first = graphs.turn().await.unwrap();
        let mut waiting: Vec<_> = (0..WAITING).map(|_| Box::pin(graphs.turn())).collect();
        for one in &mut waiting {
            assert!(futures::poll!(one).is_pending());
        }
        let refused = graphs.turn().await.unwrap_err();
        assert!(matches!(refused, ApiError::TooManyModeGraphs { .. }), "{refused}");
        // Who stops waiting makes room, and the next in line has its turn when the work is done.
        drop(waiting.pop());
        let mut late = Box::pin(graphs.turn());
        assert!(futures::poll!(&mut late).is_pending());
        drop(first);
        let second = waiting.remove(0).await.unwrap();
        assert!(futures::poll!(&mut late).is_pending());
        drop((second, waiting));
        late.await.unwrap();
    }

    #[test]
    fn only_so_many_are_kept() {
        let graphs = ModeGraphs::default();
        for number in 0..2 * KEPT {
            graphs.keep(format!("{number:02}"), "{}".into());
        }
        assert_eq!(graphs.lock().len(), KEPT);
        assert!(graphs.get("00").is_none() && graphs.get(&format!("{}", 2 * KEPT - 1)).is_some());
    }
}
