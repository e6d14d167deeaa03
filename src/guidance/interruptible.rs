//! Solving with HiGHS under a limit that counts work, and a flag that ends it from outside.
//!
//! HiGHS asks its callback between nodes and iterations, but not in its presolve, which may take seconds. So it
//! runs on a helper thread, which is left behind when it does not end soon after it was told to.
//!
//! The one place of this room with `unsafe`: HiGHS reports progress through a C callback.

#![allow(unsafe_code)]

use crate::run::Control;
use highs::{HighsStatus, Model, SolvedModel};
use std::ffi::{c_char, c_int, c_void};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// When a solve ends without an answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits<'a> {
    /// Looked at all the time.
    pub(super) control: &'a Control,
    /// Iterations of linear programs over the whole tree.
    pub(super) iterations: u64,
    /// Nodes of the tree.
    pub(super) nodes: u64,
}

/// What the callback goes by.
struct Watch {
    stop: AtomicBool,
    iterations: u64,
    nodes: u64,
}

/// A model on its way to the helper thread, or back.
struct Handed<T>(T);

// SAFETY: A model owns its instance of HiGHS, to which nothing else points, and HiGHS ties no instance to a
// thread. It is used by one thread at a time: it is handed over whole, and whoever has handed it over keeps
// nothing of it.
unsafe impl Send for Handed<Model> {}
// SAFETY: as above.
unsafe impl Send for Handed<Result<SolvedModel, HighsStatus>> {}

impl<T> Handed<T> {
    fn take(self) -> T {
        self.0
    }
}

/// Time between two looks at whether to stop.
const LOOK: Duration = Duration::from_millis(5);

/// Looks for which a solve that was told to end is waited for.
const PATIENCE: u32 = 8;

/// Solves `model` on one thread within `limits`.
///
/// # Errors
///
/// What HiGHS says of a malformed model or a failure inside; and when it did not end soon after the run was
/// told to stop.
pub(super) fn solve(mut model: Model, limits: &Limits<'_>) -> Result<SolvedModel, HighsStatus> {
    for (option, value) in [("threads", 1), ("random_seed", 0)] {
        model.try_set_option(option, value).map_err(|_| HighsStatus::Error)?;
    }
    model.try_set_option("parallel", "off").map_err(|_| HighsStatus::Error)?;
    let watch = Arc::new(Watch {
        stop: AtomicBool::new(limits.control.should_stop()),
        iterations: limits.iterations,
        nodes: limits.nodes,
    });
    let (answer, answers) = channel();
    let (handed, watched) = (Handed(model), watch.clone());
    std::thread::Builder::new()
        .name("integer-program".to_owned())
        .spawn(move || {
            let solved = watched_solve(handed.take(), &watched);
            // Nobody may wait for it any more.
            let _ = answer.send(Handed(solved));
        })
        .map_err(|_| HighsStatus::Error)?;
    let mut looks = 0;
    loop {
        match answers.recv_timeout(LOOK) {
            Ok(solved) => return solved.take(),
            Err(RecvTimeoutError::Disconnected) => return Err(HighsStatus::Error),
            Err(RecvTimeoutError::Timeout) if limits.control.should_stop() => {
                watch.stop.store(true, Ordering::Relaxed);
                looks += 1;
                if looks > PATIENCE {
                    return Err(HighsStatus::Warning);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Solves `model` on this thread until `watch` says that it is enough.
fn watched_solve(mut model: Model, watch: &Watch) -> Result<SolvedModel, HighsStatus> {
    let highs = model.as_mut_ptr();
    let data: *const Watch = watch;
    // SAFETY: `highs` is the live instance that `model` owns. `data` points to `watch`, which is
    // borrowed until this function returns; HiGHS calls back only inside the run below, on this
    // thread or one that it joins before the run returns, and a `Watch` may be read from any thread.
    // After the run the callback is taken off again, so that it cannot be called later.
    unsafe {
        highs_sys::Highs_setCallback(highs, Some(report), data.cast_mut().cast::<c_void>());
        highs_sys::Highs_startCallback(highs, highs_sys::kHighsCallbackMipInterrupt);
        highs_sys::Highs_startCallback(highs, highs_sys::kHighsCallbackSimplexInterrupt);
    }
    let mut solved = model.try_solve()?;
    // SAFETY: as above; without a callback HiGHS keeps no pointer to `watch`.
    unsafe {
        highs_sys::Highs_setCallback(solved.as_mut_ptr(), None, std::ptr::null_mut());
    }
    Ok(solved)
}

/// Asks HiGHS to end when a limit is reached.
unsafe extern "C" fn report(
    _kind: c_int,
    _message: *const c_char,
    output: *const highs_sys::HighsCallbackDataOut,
    input: *mut highs_sys::HighsCallbackDataIn,
    data: *mut c_void,
) {
    // SAFETY: HiGHS hands over the pointer given to `Highs_setCallback`, which outlives the run, and
    // pointers to its own structures, valid during this call; any of them may be null by its
    // interface, which `as_ref` and `as_mut` tell apart. Nothing here unwinds.
    let (watch, output, input) = unsafe { (data.cast::<Watch>().as_ref(), output.as_ref(), input.as_mut()) };
    if let (Some(watch), Some(output), Some(input)) = (watch, output, input) {
        let iterations = u64::try_from(output.mip_total_lp_iterations).unwrap_or(0)
            + u64::try_from(output.simplex_iteration_count).unwrap_or(0);
        let nodes = u64::try_from(output.mip_node_count).unwrap_or(0);
        if iterations > watch.iterations || nodes > watch.nodes || watch.stop.load(Ordering::Relaxed) {
            input.user_interrupt = 1;
        }
    }
}
