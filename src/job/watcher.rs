//! Progress of a job, and requests to end it early.

use super::diagnostics::Diagnostics;
use super::run_log::LogLine;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::RenderMode;
use crate::job::Error;
use crate::train::{Progress, Trainer};
use crate::wording::named;

named! {
    /// A part of a job that is done in steps. Training has a method of its own, because it has a loss.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Stage {
        /// Photos are decoded.
        Photos = "photos",
        /// The responses of views are computed.
        Responses = "responses",
        /// Held-out views are scored.
        Scores = "scores",
        /// Files are tried in a search for one of a wanted size or PSNR; their total is a guess.
        Files = "files",
        /// Pictures are drawn and written.
        Rendering = "rendering",
        /// Frames of a video are read.
        Frames = "frames",
        /// Features of photos are found.
        Features = "features",
        /// Pairs of photos are matched.
        Matches = "matches",
        /// Poses of photos are estimated.
        Poses = "poses",
    }
}

/// Follows a job; every method has a default.
pub trait Watcher {
    /// Steps of a stage that are done, and their total.
    fn progress(&self, _stage: Stage, _done: usize, _total: usize) {}
    /// Progress of training, and the iteration at which it ends.
    fn training(&self, _progress: &Progress, _until: u32) {}
    /// A line of the run's log.
    fn logged(&self, _line: &LogLine) {}
    /// Called between iterations, a few times a second: the watcher may draw the model, or hold the run.
    fn look(&self, _trainer: &Trainer) {}
    /// Largest number of iterations before the next look.
    fn pace(&self) -> u32 {
        u32::MAX
    }
    /// Returns true once if a checkpoint is asked for.
    fn checkpoint(&self) -> bool {
        false
    }
    /// Called after each prune: the model before it, how that has to be drawn, and what became of its Gaussians.
    fn pruned(&self, _before: &Gaussians, _mode: RenderMode, _diagnostics: &Diagnostics) -> Result<(), Error> {
        Ok(())
    }
    /// A line for the user.
    fn note(&self, _line: &str) {}
    /// A line on something that is left out, damaged or doubtful.
    fn lost(&self, line: &str) {
        self.note(line);
    }
    /// Returns true to end early; training then writes a checkpoint first.
    fn stop(&self) -> bool {
        false
    }

    /// Tells the progress of work that has nothing to save, and ends it, if the watcher wants it to stop.
    fn step(&self, stage: Stage, done: usize, total: usize) -> Result<(), Error> {
        self.progress(stage, done, total);
        self.unless_stopped()
    }

    /// Ends work that has nothing to save, if the watcher wants it to stop.
    fn unless_stopped(&self) -> Result<(), Error> {
        if self.stop() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Prints nothing, and never ends a job.
pub struct Silent;

impl Watcher for Silent {}
