//! Ctrl-c as a cancellation.

use crate::run::CancelToken;

/// Raises `cancel` on ctrl-c, so that what was found until then can be written.
pub(super) fn cancels(cancel: CancelToken) {
    std::thread::spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        if runtime.block_on(tokio::signal::ctrl_c()).is_ok() {
            cancel.cancel();
        }
    });
}
