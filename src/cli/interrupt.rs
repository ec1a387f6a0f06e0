//! Ctrl-C: the first asks the work to end at the next step, the second ends the program.

use crate::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C is noticed by [`check`]. Commands that never check leave Ctrl-C alone, which ends them at once.
pub(super) fn watch() {
    let watching = ctrlc::set_handler(|| {
        if ASKED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    });
    if let Err(e) = watching {
        tracing::debug!("Ctrl-C will end the program at once: {e}");
    }
}

/// Ends the work with [`Error::Interrupted`] once Ctrl-C was pressed.
pub(super) fn check() -> Result<(), Error> {
    if ASKED.load(Ordering::SeqCst) { Err(Error::Interrupted) } else { Ok(()) }
}
