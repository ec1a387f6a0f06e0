//! A job on the console: progress bars, notes, and Ctrl-C.

use super::console::Console;
use super::interrupt::Watch;
use crate::pipeline::Watcher;
use crate::train::Progress;
use indicatif::ProgressBar;
use std::sync::OnceLock;

/// Shows a job on the console; each bar appears with its stage.
pub(super) struct Show<'a> {
    console: &'a Console,
    watch: Watch,
    bars: [OnceLock<ProgressBar>; 4],
}

impl<'a> Show<'a> {
    /// Shows a job, and begins to watch for Ctrl-C.
    pub fn new(console: &'a Console) -> Self {
        Self { console, watch: Watch::begin(), bars: Default::default() }
    }

    fn step(&self, stage: usize, done: u64, total: u64) -> &ProgressBar {
        let bar = self.bars[stage].get_or_init(|| match stage {
            0 => self.console.bar(total, "photos"),
            1 => self.console.training_bar(total),
            2 => self.console.bar(total, "scores"),
            _ => self.console.bar(total, "responses"),
        });
        bar.set_position(done);
        if done == total {
            bar.finish_and_clear();
        }
        bar
    }
}

impl Watcher for Show<'_> {
    fn loading(&self, done: usize, total: usize) {
        self.step(0, done as u64, total as u64);
    }

    fn training(&self, progress: &Progress, until: u32) {
        let bar = self.step(1, u64::from(progress.iteration), u64::from(until));
        bar.set_message(format!("loss {:.4}  {} Gaussians", progress.loss, progress.gaussians));
    }

    fn responding(&self, done: usize, total: usize) {
        self.step(3, done as u64, total as u64);
    }

    fn evaluating(&self, done: usize, total: usize) {
        self.step(2, done as u64, total as u64);
    }

    fn note(&self, line: &str) {
        self.console.note(line);
    }

    fn stop(&self) -> bool {
        self.watch.check().is_err()
    }
}
