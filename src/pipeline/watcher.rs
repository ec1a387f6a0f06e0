//! Who follows a job, and may end it early.

use crate::error::Error;
use crate::train::Progress;

/// What a job tells while it goes on.
pub trait Watcher {
    /// Photos decoded so far, of how many.
    fn loading(&self, done: usize, total: usize);
    /// Where training stands.
    fn training(&self, progress: &Progress, until: u32);
    /// Views that gave their responses so far, of how many.
    fn responding(&self, _done: usize, _total: usize) {}
    /// Held-out views scored so far, of how many.
    fn evaluating(&self, done: usize, total: usize);
    /// A line worth reading.
    fn note(&self, line: &str);
    /// Whether to end early; training does so after a checkpoint.
    fn stop(&self) -> bool;

    /// Ends work that has nothing to save, where that is wished for.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    fn unless_stopped(&self) -> Result<(), Error> {
        if self.stop() { Err(Error::Interrupted) } else { Ok(()) }
    }
}
