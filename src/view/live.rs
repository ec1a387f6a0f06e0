//! A watcher of a run: draws its model between iterations, within a share of the time, and passes on the pages'
//! requests.
//!
//! The model is only read, on the thread and the queue that train it, so that a run's bytes do not depend on being
//! watched. Without a page, a check costs one atomic load.

use super::painter::{PaintInput, Painter};
use super::protocol::Control;
use super::server::Server;
use super::subject::{Job, Subject};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::RenderMode;
use crate::gpu::Device;
use crate::job::diagnostics::Diagnostics;
use crate::job::run_log::LogLine;
use crate::job::{Error, Stage, Watcher};
use crate::lock::lock;
use crate::train::{Progress, Trainer};
use serde_json::json;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Share of the time that pictures may take, unless a page requests another.
const SHARE: f64 = 0.05;
/// Largest share that a page may request.
const MOST_SHARE: f64 = 0.9;
/// Largest credit in seconds, so that a page that connects late does not halt the run.
const MOST_CREDIT: f64 = 0.25;
/// Iterations between checks while a page waits for a picture.
const PACE: u32 = 2;
/// Time between two reports of progress.
const NEWS: Duration = Duration::from_millis(400);
/// Timeout for a request or a control while the run is paused.
const PAUSED: Duration = Duration::from_millis(50);

/// A watcher that lets pages view the run, wrapped around another watcher.
pub struct Live<'a> {
    beside: &'a (dyn Watcher + Sync),
    server: &'a Server,
    device: &'a Device,
    subject: Arc<Subject>,
    state: Mutex<State>,
}

struct State {
    painter: Option<Painter>,
    /// Seconds that pictures may take now.
    credit: f64,
    share: f64,
    looked: Instant,
    told: Option<Instant>,
    until: u32,
    loss: f32,
    paused: bool,
    stop: bool,
    checkpoint: bool,
}

impl<'a> Live<'a> {
    /// Wraps `beside`, to which every call is passed on.
    pub fn new(
        beside: &'a (dyn Watcher + Sync),
        server: &'a Server,
        device: &'a Device,
        subject: Arc<Subject>,
    ) -> Self {
        let state = State {
            painter: None,
            credit: 0.0,
            share: SHARE,
            looked: Instant::now(),
            told: None,
            until: 0,
            loss: 0.0,
            paused: false,
            stop: false,
            checkpoint: false,
        };
        Self { beside, server, device, subject, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Takes in the pages' controls; returns false if there are none.
    fn hear(&self, state: &mut State) -> bool {
        let controls = self.server.requests().controls();
        for control in &controls {
            match control {
                Control::Pause => state.paused = true,
                Control::Resume => state.paused = false,
                Control::Checkpoint if self.subject.job == Job::Run => {
                    state.checkpoint = true;
                    let note = json!({ "note": "a checkpoint is written after this iteration" });
                    self.server.requests().tell(&note.to_string());
                }
                Control::Stop => state.stop = true,
                Control::Share(share) if share.is_finite() => state.share = share.clamp(0.0, MOST_SHARE),
                Control::Checkpoint | Control::Share(_) => {}
            }
        }
        !controls.is_empty()
    }

    /// Takes in the pages' controls, and sends them the run's progress.
    fn converse(&self, state: &mut State, trainer: &Trainer) {
        if self.hear(state) || state.told.is_none_or(|t| t.elapsed() > NEWS) {
            self.tell(state, trainer);
        }
    }

    fn tell(&self, state: &mut State, trainer: &Trainer) {
        state.told = Some(Instant::now());
        let loss = Some(state.loss).filter(|l| l.is_finite());
        let news = json!({
            "iteration": trainer.iteration(), "until": state.until, "gaussians": trainer.len(), "loss": loss,
            "paused": state.paused, "share": state.share,
        });
        self.server.requests().tell(&news.to_string());
    }

    /// Draws the next request; returns false if there is none.
    fn draw(&self, state: &mut State, trainer: &Trainer, patience: Duration) -> bool {
        let Some((client, request)) = self.server.requests().next_request(patience) else { return false };
        let begun = Instant::now();
        let (whole, iteration) = (trainer.model(), trainer.iteration());
        let input = PaintInput { whole, reduced: None, other: None, facts: None, fixed: false, iteration };
        let made = match state.painter.take() {
            Some(painter) => Ok(painter),
            None => Painter::new(self.device, *trainer.settings(), trainer.len()),
        };
        let requests = self.server.requests();
        // Viewer errors never stop training; the training loop reports a lost device itself, and its memory takes
        // precedence.
        match made.and_then(|mut painter| painter.draw(&self.subject, input, &request).map(|drawn| (painter, drawn))) {
            Ok((painter, drawn)) => {
                state.painter = Some(painter);
                requests.deliver(client, drawn.header, Arc::new(drawn.image));
            }
            Err(e) => requests.refuse(client, &request, &e),
        }
        state.credit -= begun.elapsed().as_secs_f64();
        true
    }
}

impl Watcher for Live<'_> {
    fn progress(&self, stage: Stage, done: usize, total: usize) {
        self.beside.progress(stage, done, total);
    }

    fn logged(&self, line: &LogLine) {
        self.beside.logged(line);
    }

    fn training(&self, progress: &Progress, until: u32) {
        self.beside.training(progress, until);
        let mut state = self.state();
        (state.until, state.loss) = (until, progress.loss);
    }

    fn look(&self, trainer: &Trainer) {
        let requests = self.server.requests();
        if requests.present() == 0 {
            let mut state = self.state();
            self.hear(&mut state); // the last messages of a page that left
            // A run paused by a page that has left resumes.
            (state.paused, state.share, state.credit) = (false, SHARE, 0.0);
            (state.looked, state.painter) = (Instant::now(), None);
            return;
        }
        let mut state = self.state();
        let earned = state.looked.elapsed().as_secs_f64() * state.share;
        state.credit = (state.credit + earned).min(MOST_CREDIT);
        self.converse(&mut state, trainer);
        while state.credit > 0.0 && self.draw(&mut state, trainer, Duration::ZERO) {}
        while state.paused && !state.stop && !state.checkpoint && !self.beside.stop() && requests.present() > 0 {
            self.draw(&mut state, trainer, PAUSED);
            self.converse(&mut state, trainer);
            state.credit = 0.0;
        }
        state.looked = Instant::now();
    }

    fn pace(&self) -> u32 {
        let requests = self.server.requests();
        if requests.present() == 0 {
            return self.beside.pace();
        }
        let state = self.state();
        match (state.paused, state.credit >= 0.0 && requests.waiting()) {
            (true, _) => 1,
            (_, true) => PACE,
            _ => self.beside.pace(),
        }
    }

    fn checkpoint(&self) -> bool {
        std::mem::take(&mut self.state().checkpoint) || self.beside.checkpoint()
    }

    fn pruned(&self, before: &Gaussians, mode: RenderMode, diagnostics: &Diagnostics) -> Result<(), Error> {
        self.beside.pruned(before, mode, diagnostics)
    }

    fn note(&self, line: &str) {
        self.beside.note(line);
        self.server.requests().tell(&json!({ "note": line }).to_string());
    }

    fn stop(&self) -> bool {
        let mut state = self.state();
        self.hear(&mut state);
        state.stop || self.beside.stop()
    }
}
