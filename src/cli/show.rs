//! A job on the console: progress bars, notes, and Ctrl-C.

use super::console::Console;
use super::diagnostics::Recorder;
use super::interrupt::Watch;
use super::pulse::{Pulse, Steps};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::RenderMode;
use crate::job::diagnostics::Diagnostics;
use crate::job::run_log::LogLine;
use crate::job::{Error, Stage, Watcher};
use crate::lock::lock;
use crate::train::Progress;
use crate::wording::counted;
use indicatif::ProgressBar;
use std::sync::{Mutex, OnceLock};

/// Shows a job on the console.
pub(super) struct Show<'a> {
    console: &'a Console,
    watch: Watch,
    recorder: Option<Recorder>,
    json: bool,
    pulse: Pulse,
    bar: Bar,
    unprinted: OnceLock<Error>,
}

impl<'a> Show<'a> {
    /// Shows a job, and starts to watch for Ctrl-C.
    pub fn new(console: &'a Console) -> Self {
        let (watch, pulse) = (Watch::begin(), Pulse::new(console));
        Self { console, watch, recorder: None, json: false, pulse, bar: Bar::new(), unprinted: OnceLock::new() }
    }

    /// Sets the recorder that writes the diagnostics of prunes.
    pub fn record(&mut self, recorder: Option<Recorder>) {
        self.recorder = recorder;
    }

    /// Also prints the lines of a run's log.
    pub fn print_log(&mut self, json: bool) {
        self.json = json;
    }

    /// Prints no more progress: results follow, or another job that prints its own.
    pub fn rest(&self) {
        self.pulse.end();
    }

    /// The first error of printing a line of a log; `main` forgives a reader that closed the pipe.
    pub fn printed(&mut self) -> Result<(), Error> {
        self.unprinted.take().map_or(Ok(()), Err)
    }
}

/// The loss, which is unknown before the first step, and the number of Gaussians.
fn told(progress: &Progress) -> String {
    let gaussians = counted(progress.gaussians, "Gaussian");
    if progress.loss.is_finite() { format!("loss {:.4}  {gaussians}", progress.loss) } else { gaussians }
}

/// The bar on the screen, and the stage that it shows.
struct Bar(Mutex<(&'static str, ProgressBar)>);

impl Bar {
    fn new() -> Self {
        Self(Mutex::new(("", ProgressBar::hidden())))
    }

    /// Advances the bar of a stage, and removes it when all is done. Another stage, and one that begins anew, gets a bar of its own.
    fn advance(&self, (stage, done, total): Steps, new: impl FnOnce() -> ProgressBar) -> ProgressBar {
        let mut shown = lock(&self.0);
        let (of, bar) = &mut *shown;
        if *of != stage || bar.is_finished() {
            bar.finish_and_clear();
            (*of, *bar) = (stage, new().with_position(done));
            // Steps that were done before do not count for the pace: the bar learns of them by its length, and begins anew.
            bar.set_length(total);
            bar.reset_eta();
        }
        bar.set_length(total);
        bar.set_position(done);
        if done == total {
            bar.finish_and_clear();
        }
        bar.clone()
    }
}

impl Watcher for Show<'_> {
    fn progress(&self, stage: Stage, done: usize, total: usize) {
        let steps @ (name, _, total) = (stage.name(), done as u64, total as u64);
        self.bar.advance(steps, || self.console.bar(total, name));
        self.pulse.beat(steps, "");
    }

    fn training(&self, progress: &Progress, until: u32) {
        let (done, total) = (u64::from(progress.iteration), u64::from(until));
        let steps = ("training", done, total);
        let bar = self.bar.advance(steps, || self.console.training_bar(total));
        let message = told(progress);
        self.pulse.beat(steps, &message);
        bar.set_message(message);
    }

    fn logged(&self, line: &LogLine) {
        if self.json
            && let Ok(text) = serde_json::to_string(line)
        {
            // Whatever became of the reader, the run continues.
            if let Err(error) = self.console.print(text) {
                let _ = self.unprinted.set(error);
            }
        }
    }

    fn pruned(&self, before: &Gaussians, mode: RenderMode, diagnostics: &Diagnostics) -> Result<(), Error> {
        self.recorder.as_ref().map_or(Ok(()), |r| r.write(before, mode, diagnostics, self.console))
    }

    fn note(&self, line: &str) {
        self.console.note(line);
    }

    fn stop(&self) -> bool {
        self.watch.pressed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_is_told_once_it_is_known() {
        let at = |loss| told(&Progress { iteration: 0, loss, gaussians: 5000 });
        assert_eq!([at(f32::NAN), at(0.5)], ["5000 Gaussians", "loss 0.5000  5000 Gaussians"]);
    }

    #[test]
    fn a_stage_that_begins_anew_gets_a_new_bar() {
        let bar = Bar::new();
        let mut made = 0;
        let mut advance = |stage, done, total| {
            let shown = bar.advance((stage, done, total), || {
                made += 1;
                ProgressBar::hidden()
            });
            (made, shown.length(), shown.is_finished())
        };
        assert_eq!(advance("training", 40, 50), (1, Some(50), false));
        assert_eq!(advance("training", 50, 50), (1, Some(50), true));
        assert_eq!(advance("training", 1, 900), (2, Some(900), false));
        assert_eq!(advance("scores", 3, 9), (3, Some(9), false));
        assert_eq!(advance("scores", 4, 12), (3, Some(12), false));
        assert_eq!(advance("training", 300, 900), (4, Some(900), false));
    }
}
