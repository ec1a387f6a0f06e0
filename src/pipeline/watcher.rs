//! Progress of a job, and the wish to end it early.

use crate::error::Error;
use crate::train::Progress;

/// Follows a job; every method may be left out.
pub trait Watcher {
    /// Photos decoded so far, of how many.
    fn loading(&self, _done: usize, _total: usize) {}
    /// Where training stands, and the iteration at which it ends.
    fn training(&self, _progress: &Progress, _until: u32) {}
    /// Views that gave their responses so far, of how many.
    fn responding(&self, _done: usize, _total: usize) {}
    /// Held-out views scored so far, of how many.
    fn evaluating(&self, _done: usize, _total: usize) {}
    /// Pictures written so far, of how many.
    fn rendering(&self, _done: usize, _total: usize) {}
    /// A line worth reading.
    fn note(&self, _line: &str) {}
    /// Whether to end early; training does so after a checkpoint.
    fn stop(&self) -> bool {
        false
    }

    /// Ends work that has nothing to save, if the watcher wants it to stop.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    fn unless_stopped(&self) -> Result<(), Error> {
        if self.stop() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Says nothing, and never ends a job.
pub struct Silent;

impl Watcher for Silent {}
