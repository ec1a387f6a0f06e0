//! A job on the console: progress bars, notes, and Ctrl-C.

use super::console::Console;
use super::diagnostics::Recorder;
use super::interrupt::Watch;
use super::pulse::Pulse;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::RenderMode;
use crate::job::diagnostics::Diagnostics;
use crate::job::run_log::LogLine;
use crate::job::{Error, Watcher};
use crate::train::Progress;
use crate::wording::counted;
use indicatif::ProgressBar;
use std::sync::OnceLock;

/// Shows a job on the console; each stage has a bar of its own.
pub(super) struct Show<'a> {
    console: &'a Console,
    watch: Watch,
    recorder: Option<Recorder>,
    json: bool,
    pulse: Pulse,
    poses: OnceLock<ProgressBar>,
    photos: OnceLock<ProgressBar>,
    training: OnceLock<ProgressBar>,
    responses: OnceLock<ProgressBar>,
    scores: OnceLock<ProgressBar>,
    pictures: OnceLock<ProgressBar>,
    files: OnceLock<ProgressBar>,
    unprinted: OnceLock<Error>,
}

impl<'a> Show<'a> {
    /// Shows a job, and starts to watch for Ctrl-C.
    pub fn new(console: &'a Console) -> Self {
        let [poses, photos, training, responses, scores, pictures, files] = Default::default();
        let (watch, recorder, pulse, json) = (Watch::begin(), None, Pulse::new(), false);
        let unprinted = OnceLock::new();
        Self {
            console,
            watch,
            recorder,
            json,
            pulse,
            poses,
            photos,
            training,
            responses,
            scores,
            pictures,
            files,
            unprinted,
        }
    }

    /// Also writes what prunes knew and decided.
    pub fn record(&mut self, recorder: Option<Recorder>) {
        self.recorder = recorder;
    }

    /// Also prints the lines of a run's log.
    pub fn print_log(&mut self, json: bool) {
        self.json = json;
    }

    /// The first error of printing a line of a log; `main` forgives a reader that closed the pipe.
    pub fn printed(&mut self) -> Result<(), Error> {
        self.unprinted.take().map_or(Ok(()), Err)
    }

    fn step(&self, bar: &OnceLock<ProgressBar>, what: &'static str, done: usize, total: usize) {
        advance(bar.get_or_init(|| self.console.bar(total as u64, what)), done as u64, total as u64);
        self.pulse.beat(self.console, (what, done as u64, total as u64), "");
    }
}

/// Advances a bar; removes it when all is done.
fn advance(bar: &ProgressBar, done: u64, total: u64) {
    bar.set_position(done);
    if done == total {
        bar.finish_and_clear();
    }
}

impl Watcher for Show<'_> {
    fn posing(&self, stage: &'static str, done: usize, total: usize) {
        let bar = self.poses.get_or_init(|| self.console.bar(total as u64, stage));
        if bar.message() != stage {
            // One bar for all stages: it begins anew.
            bar.reset();
            bar.set_message(stage);
        }
        bar.set_length(total as u64);
        advance(bar, done as u64, total as u64);
        self.pulse.beat(self.console, (stage, done as u64, total as u64), "");
    }

    fn loading(&self, done: usize, total: usize) {
        self.step(&self.photos, "photos", done, total);
    }

    fn training(&self, progress: &Progress, until: u32) {
        let bar = self.training.get_or_init(|| self.console.training_bar(u64::from(until)));
        advance(bar, u64::from(progress.iteration), u64::from(until));
        let message = format!("loss {:.4}  {}", progress.loss, counted(progress.gaussians, "Gaussian"));
        self.pulse.beat(self.console, ("training", u64::from(progress.iteration), u64::from(until)), &message);
        bar.set_message(message);
    }

    fn logged(&self, line: &LogLine) {
        if self.json
            && let Ok(text) = serde_json::to_string(line)
        {
            // Whatever became of the reader, the run goes on.
            if let Err(error) = self.console.print(text) {
                let _ = self.unprinted.set(error);
            }
        }
    }

    fn responding(&self, done: usize, total: usize) {
        self.step(&self.responses, "responses", done, total);
    }

    fn pruned(&self, before: &Gaussians, mode: RenderMode, diagnostics: &Diagnostics) -> Result<(), Error> {
        self.recorder.as_ref().map_or(Ok(()), |r| r.write(before, mode, diagnostics, self.console))
    }

    fn evaluating(&self, done: usize, total: usize) {
        self.step(&self.scores, "scores", done, total);
    }

    fn rendering(&self, done: usize, total: usize) {
        self.step(&self.pictures, "rendering", done, total);
    }

    fn trying(&self, done: usize, total: usize) {
        let bar = self.files.get_or_init(|| self.console.bar(total as u64, "files"));
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        self.pulse.beat(self.console, ("files", done as u64, total as u64), "");
        if (done, total) == (1, 1) {
            bar.finish_and_clear();
        }
    }

    fn note(&self, line: &str) {
        self.console.note(line);
    }

    fn stop(&self) -> bool {
        self.watch.pressed()
    }
}
