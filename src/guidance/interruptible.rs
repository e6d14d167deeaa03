//! Solving with HiGHS under a limit that counts work, and a flag that ends it from outside.
//!
//! The one place of this room with `unsafe`: HiGHS reports progress through a C callback.

#![allow(unsafe_code)]

use crate::run::Control;
use highs::{HighsStatus, Model, SolvedModel};
use std::ffi::{c_char, c_int, c_void};

/// When a solve ends without an answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits<'a> {
    /// Asked at every report.
    pub(super) control: &'a Control,
    /// Iterations of linear programs over the whole tree.
    pub(super) iterations: u64,
    /// Nodes of the tree.
    pub(super) nodes: u64,
}

/// Solves `model` on one thread within `limits`.
///
/// # Errors
///
/// What HiGHS says of a malformed model or a failure inside.
pub(super) fn solve(mut model: Model, limits: &Limits<'_>) -> Result<SolvedModel, HighsStatus> {
    for (option, value) in [("threads", 1), ("random_seed", 0)] {
        model.try_set_option(option, value).map_err(|_| HighsStatus::Error)?;
    }
    model.try_set_option("parallel", "off").map_err(|_| HighsStatus::Error)?;
    let highs = model.as_mut_ptr();
    let data: *const Limits<'_> = limits;
    // SAFETY: `highs` is the live instance that `model` owns. `data` points to `limits`, which is
    // borrowed until this function returns; HiGHS calls back only inside the run below, on this
    // thread or one that it joins before the run returns, and `Control` may be read from any thread.
    // After the run the callback is taken off again, so that it cannot be called later.
    unsafe {
        highs_sys::Highs_setCallback(highs, Some(report), data.cast_mut().cast::<c_void>());
        highs_sys::Highs_startCallback(highs, highs_sys::kHighsCallbackMipInterrupt);
        highs_sys::Highs_startCallback(highs, highs_sys::kHighsCallbackSimplexInterrupt);
    }
    let mut solved = model.try_solve()?;
    // SAFETY: as above; without a callback HiGHS keeps no pointer to `limits`.
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
    let (limits, output, input) =
        unsafe { (data.cast::<Limits<'_>>().as_ref(), output.as_ref(), input.as_mut()) };
    if let (Some(limits), Some(output), Some(input)) = (limits, output, input) {
        let iterations = u64::try_from(output.mip_total_lp_iterations).unwrap_or(0)
            + u64::try_from(output.simplex_iteration_count).unwrap_or(0);
        let nodes = u64::try_from(output.mip_node_count).unwrap_or(0);
        if iterations > limits.iterations || nodes > limits.nodes || limits.control.should_stop() {
            input.user_interrupt = 1;
        }
    }
}
