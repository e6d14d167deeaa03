//! Ctrl-c as a cancellation.

use std::future::{Future as _, poll_fn};
use std::task::Poll;

use crate::run::CancelToken;

/// Raises `cancel` on ctrl-c, so that what was found until then can be written. From its return on: an interrupt
/// right afterwards is not lost, and does not end the process.
pub(super) fn cancels(cancel: CancelToken) {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
    let mut interrupt = Box::pin(tokio::signal::ctrl_c());
    // Interrupts are listened for since it is polled for the first time.
    if runtime.block_on(poll_fn(|context| Poll::Ready(interrupt.as_mut().poll(context)))).is_ready() {
        return;
    }
    std::thread::spawn(move || {
        if runtime.block_on(interrupt).is_ok() {
            cancel.cancel();
        }
    });
}
