//! Ctrl-c as a cancellation.

use tokio::signal::unix::{SignalKind, signal};

use crate::run::CancelToken;

/// Raises `cancel` on ctrl-c, so that what was found until then can be written. From its return on: an interrupt
/// right afterwards is not lost, and does not end the process.
pub(super) fn cancels(cancel: CancelToken) {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
    let Ok(mut interrupts) = runtime.block_on(async { signal(SignalKind::interrupt()) }) else { return };
    std::thread::spawn(move || {
        if runtime.block_on(interrupts.recv()).is_some() {
            cancel.cancel();
        }
    });
}
