//! A run in progress: training, prunes, checkpoints, and final results. `run` drives one, `compare` several from one
//! checkpoint.

mod finish;

use super::checkpoint::{Checkpoint, RunNotes};
use super::evaluate::{Evaluator, exhibits, mean};
use super::pair_capacity;
use super::prune::{PruneRequest, prune};
use super::setup::Setup;
use super::start::{Start, initialise};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::config::ResponseSource;
use crate::job::records::{AttritionRecord, CurvePoint, Memory};
use crate::job::run_log::{LogLine, LoggedRates, RunLog};
use crate::job::{Error, Output, RunConfig, Watcher};
use crate::qirf::select::budget::Keep;
use crate::response::{Responses, Wanted};
use crate::sample::evenly;
use crate::train::loss::Weights;
use crate::train::method::Cut;
use crate::train::rates::Rates;
use crate::train::{Options, Progress, Trainer};
use std::ops::Range;
use std::time::Instant;

/// Number of points of the quality curve.
const CURVE_POINTS: u32 = 8;
/// Number of held-out views, and of training views, whose PSNR a point is the mean of; thousands would take longer than training.
const CURVE_VIEWS: usize = 64;

/// A run in progress.
pub struct ActiveRun<'a> {
    setup: &'a Setup<'a>,
    config: &'a RunConfig,
    output: &'a Output,
    trainer: Trainer,
    evaluator: Evaluator,
    notes: RunNotes,
    /// Iteration of the state that is in the folder's checkpoint, if there is one.
    saved: Option<u32>,
    log: Option<RunLog>,
    spent: Spent,
}

/// Seconds since the last start, besides training.
#[derive(Clone, Copy, Default)]
struct Spent {
    /// From the photos until training starts.
    start: f64,
    /// Evaluations on the way.
    curve: f64,
    /// Writing files.
    write: f64,
}

impl<'a> ActiveRun<'a> {
    /// Starts a run, or continues from a snapshot.
    ///
    /// # Errors
    /// Device memory; device errors; cameras that leave no room for random points; [`Error::OtherRun`] for a snapshot of other photos.
    pub fn start(setup: &'a Setup<'a>, config: &'a RunConfig, output: &'a Output, start: Start) -> Result<Self, Error> {
        let begun = Instant::now();
        let Setup { session, prepared, .. } = setup;
        let device = session.device;
        let settings = prepared.settings(config.style);
        let method = session.method(config)?;
        let options = |gaussians: usize| Options {
            schedule: config.schedule.clone(),
            settings,
            seed: config.seed,
            degree: config.sh_degree,
            most: config.max_gaussians,
            tail: 0,
            cameras: setup.cameras,
            exposure: config.exposure.then(|| setup.exposures.clone()),
            poses: config.poses,
            dropout: config.dropout,
            depth_loss: config.depth_loss,
            weights: Weights::default(),
            averaged: averaged(config),
            method: method.clone(),
            pairs: pair_capacity::initial(session.device, gaussians),
        };
        let views = prepared.train.clone();
        let saved = if let Start::Resumed(checkpoint) = &start { Some(checkpoint.snapshot.iteration) } else { None };
        let (text, photos, contents) =
            (config.written_in(output.folder())?, prepared.names_to_train(), prepared.contents()?);
        let (trainer, notes) = if let Start::Resumed(checkpoint) = start {
            let Checkpoint { snapshot, notes } = *checkpoint;
            if let Some(change) = notes.other_photos(&photos, &contents) {
                return Err(Error::OtherRun { folder: output.folder().to_owned(), changes: vec![change] });
            }
            let options = options(snapshot.model.len());
            let trainer = Trainer::resume(device, &snapshot, views, prepared.extent, options)?;
            (trainer, RunNotes { config: text, photos, contents, ..notes })
        } else {
            let model = initialise(config, prepared, &start)?;
            let initial = model.len();
            let trainer = Trainer::new(device, &model, views, prepared.extent, options(initial))?;
            let none = RunNotes { config: text, initial, photos, contents, trial: setup.trial, ..RunNotes::default() };
            (trainer, none)
        };
        // Starts empty and grows on demand; runs in blocks never use it.
        let mut evaluator = Evaluator::empty(device, settings)?;
        evaluator.compare_as(config.exposure);
        let spent = Spent::default();
        let mut run = Self { setup, config, output, trainer, evaluator, notes, saved, log: None, spent };
        if !run.notes.prunes.is_empty() || run.trainer.attrition().is_some() {
            run.fine_tune();
        }
        run.spent.start = setup.start_s + begun.elapsed().as_secs_f64();
        Ok(run)
    }

    /// Writes `log.jsonl` from here on.
    pub fn log(&mut self) -> Result<(), Error> {
        self.log = Some(RunLog::open(&self.output.log(), self.trainer.iteration())?);
        Ok(())
    }

    /// Trains until `until` iterations are done, with prunes and checkpoints on the way. A prune due after the last of
    /// them is left to the caller.
    ///
    /// # Errors
    /// Device memory, after a note about the checkpoint that remains; device errors; a checkpoint that cannot be written;
    /// [`Error::Interrupted`] after one.
    pub fn train(&mut self, until: u32) -> Result<(), Error> {
        let trained = self.advance(until);
        if let Err(error) = &trained
            && let Some(iteration) = self.saved.filter(|_| self.output.checkpoint().is_file())
        {
            tell_of_checkpoint(self.setup.session.watcher, error, iteration);
        }
        trained
    }

    /// Trains one stretch. If device memory ends it after an iteration, that one's checkpoint is written; none is written
    /// half-way through a change of the model, nor where checkpoints are off.
    fn stretch(&mut self, until: u32) -> Result<Progress, Error> {
        let trained = self.trainer.advance(until).map_err(Error::from);
        if matches!(&trained, Err(Error::Device(error)) if error.is_resources())
            && self.config.checkpoint_every > 0
            && self.trainer.is_whole()
            && self.trainer.iteration() > self.saved.unwrap_or(0)
            && self.checkpoint().is_ok_and(|checkpoint| checkpoint.write(&self.output.checkpoint()).is_ok())
        {
            self.saved = Some(self.trainer.iteration());
        }
        trained
    }

    fn advance(&mut self, until: u32) -> Result<(), Error> {
        let last = self.config.schedule.iterations;
        let step = last.div_ceil(CURVE_POINTS).max(1);
        let every = self.config.checkpoint_every;
        let prunes = self.config.prune.as_ref().map(|p| p.iterations(last)).unwrap_or_default();
        let fine_tuned = self.config.prune.as_ref().and_then(|p| p.fine_tuned_from(last));
        while self.trainer.iteration() < until {
            let now = self.trainer.iteration();
            if fine_tuned.is_some_and(|from| from <= now) {
                self.fine_tune();
            }
            while self.due(&prunes) {
                self.prune(prunes.len())?;
            }
            let planned = prunes.get(self.notes.prunes.len()).copied();
            let planned = planned.into_iter().chain(fine_tuned.filter(|from| *from > now)).min();
            let pause = self.trainer.attrition().map(|a| a.last).or(planned).unwrap_or(last);
            let next = |every: u32| now.checked_div(every).map_or(last, |passed| (passed + 1) * every);
            let started = Instant::now();
            let watcher = self.setup.session.watcher;
            let pace = now.saturating_add(watcher.pace());
            let progress = self.stretch(until.min(next(step)).min(next(every)).min(pause).min(pace))?;
            self.notes.seconds += started.elapsed().as_secs_f64();
            watcher.training(&progress, last);
            watcher.look(&self.trainer);
            let at = progress.iteration;
            if let Some(cut) = self.trainer.cut().filter(|cut| at > now && cut.iteration == at) {
                let Cut { before, shown, after, .. } = cut;
                let note = format!(
                    "after iteration {at}: {after} of {before} Gaussians kept; the method would have kept {shown}"
                );
                watcher.note(&note);
            }
            let recorded = self.notes.curve.last().is_some_and(|p| p.iteration == at);
            let scored = at > now && (at.is_multiple_of(step) || at == last) && !recorded;
            let psnr = if scored { self.point(at)? } else { None };
            if psnr.is_some() || RunLog::due(now, at, last) {
                self.log_line(&progress, psnr)?;
            }
            let stop = watcher.stop();
            if stop || watcher.checkpoint() || (every > 0 && at > now && at.is_multiple_of(every) && at < last) {
                let writing = Instant::now();
                self.checkpoint()?.write(&self.output.checkpoint())?;
                self.spent.write += writing.elapsed().as_secs_f64();
                self.saved = Some(at);
            }
            if stop {
                return Err(Error::Interrupted);
            }
        }
        Ok(())
    }

    /// Returns true if a prune, or the attrition before it, is due.
    fn due(&self, prunes: &[u32]) -> bool {
        let now = self.trainer.iteration();
        match self.trainer.attrition() {
            Some(attrition) => attrition.over(now, self.trainer.trained()),
            None => prunes.get(self.notes.prunes.len()).is_some_and(|at| *at <= now),
        }
    }

    /// Prunes as configured, at any iteration. With attrition, that begins instead.
    pub fn prune_now(&mut self) -> Result<(), Error> {
        let steps = self.config.prune.as_ref().map_or(1, |p| p.iterations(self.config.schedule.iterations).len());
        self.prune(steps)
    }

    /// Continues with the loss of fine-tuning.
    fn fine_tune(&mut self) {
        if let Some(pruning) = &self.config.prune {
            self.trainer.fine_tune(Weights { l2: pruning.l2 as f32, ..Weights::default() });
        }
    }

    /// Mean PSNR of the held-out views with the current model, in dB; of 64 evenly spread ones if there are more.
    pub fn psnr(&mut self) -> Result<Option<f64>, Error> {
        let views = evenly(&self.setup.prepared.test, CURVE_VIEWS).map(|(_, view)| view);
        let psnr = self.shown(|evaluator, model| evaluator.psnr(model, views))?;
        Ok(mean(&psnr))
    }

    /// Mean PSNR of as many training views, evenly spread, with the current model, in dB.
    fn train_psnr(&mut self) -> Result<Option<f64>, Error> {
        let photos = self.trainer.photos().to_vec();
        let most = self.setup.prepared.test.len().clamp(1, CURVE_VIEWS);
        let psnr = self.shown(|evaluator, model| evaluator.psnr(model, evenly(&photos, most)))?;
        Ok(mean(&psnr).filter(|psnr| psnr.is_finite()))
    }

    /// Shows the model to the evaluator; the trainer and the evaluator do not take memory at the same time.
    fn shown<T>(&mut self, show: impl FnOnce(&mut Evaluator, &Resident) -> Result<T, Error>) -> Result<T, Error> {
        let Self { trainer, evaluator, .. } = self;
        trainer.lend(|model| {
            let shown = show(evaluator, model);
            evaluator.rest()?;
            shown
        })
    }

    /// Responses of the training photos to each Gaussian of the current model.
    pub fn responses(&mut self) -> Result<Responses, Error> {
        Ok(self.trainer.responses(Wanted::CHANNELS)?)
    }

    /// Returns true if the model was pruned.
    pub fn pruned(&self) -> bool {
        !self.notes.prunes.is_empty()
    }

    /// Makes prune number `self.notes.prunes.len()` of `steps`, or begins the attrition before it.
    fn prune(&mut self, steps: usize) -> Result<(), Error> {
        let Some(pruning) = &self.config.prune else { return Ok(()) };
        let Setup { session, prepared, .. } = self.setup;
        let attrition = self.trainer.attrition().copied();
        if self.notes.prunes.is_empty() && attrition.is_none() {
            let (renders, writing) = (self.output.renders(), Instant::now());
            self.shown(|evaluator, model| exhibits::dense(evaluator, model, prepared, &renders))?;
            self.spent.write += writing.elapsed().as_secs_f64();
            if let Some(attrition) = pruning.attrition {
                self.trainer.begin_attrition(attrition, pruning.survivors(self.trainer.trained()))?;
                self.fine_tune();
                return Ok(());
            }
        }
        let evaluating = Instant::now();
        let frames = self.shown(|evaluator, model| evaluator.frames_per_second(model, prepared))?;
        self.spent.curve += evaluating.elapsed().as_secs_f64();
        let next = || pruning.keep(self.notes.prunes.len(), steps, self.trainer.trained());
        let keep = attrition.map_or_else(next, |c| Keep::Count(c.survivors));
        let request = PruneRequest { compression: &pruning.compression, keep, seed: self.config.seed };
        let unit = prepared.scene.unit;
        let follow =
            |model: &Gaussians, facts: &_| session.watcher.pruned(&model.scaled(unit), self.config.style.mode(), facts);
        let mut pruned = prune(session.device, &mut self.trainer, pruning.responses, &request, follow)?;
        pruned.frames_per_second_before = frames;
        pruned.attrition = attrition.map(|c| AttritionRecord { from: c.from, before: c.before });
        self.trainer.end_attrition();
        if pruning.rewarm && self.notes.prunes.len() + 1 >= steps {
            self.trainer.rewarm()?;
        }
        self.fine_tune();
        let chosen = match pruned.attrition {
            Some(_) => format!("attrition had left {}, from which {} chose", pruned.before, pruned.selector),
            None => format!("{} chose", pruned.selector),
        };
        session.watcher.note(&format!(
            "after iteration {}: {} of {} Gaussians kept ({chosen}), {:.1} s",
            pruned.iteration,
            pruned.after,
            pruned.dense(),
            pruned.seconds.total
        ));
        if let Some(note) = pruning.compression.detail_note(keep, pruned.before) {
            session.watcher.note(&note);
        }
        if let Keep::Count(wanted) = pruning.compression.keep
            && pruned.after < wanted
            && self.notes.prunes.len() + 1 >= steps
        {
            let most = self.config.max_gaussians;
            let cause = if wanted > most && pruned.dense() >= most {
                format!("--max-gaussians {most} allows no more")
            } else {
                "train longer, or give a larger --grow-to".to_owned()
            };
            let after = pruned.after;
            let note = format!("{wanted} Gaussians were asked for, and the model has {after}: {cause}");
            session.watcher.note(&note);
        }
        self.notes.seconds += pruned.seconds.total;
        self.notes.prunes.push(pruned);
        Ok(())
    }

    /// A point of the quality curve, if there are held-out views: its PSNR.
    fn point(&mut self, iteration: u32) -> Result<Option<f64>, Error> {
        let evaluating = Instant::now();
        let psnr = self.psnr()?;
        if let Some(psnr) = psnr {
            let train_psnr = self.train_psnr()?;
            let gaussians = self.trainer.len();
            let seconds = self.notes.seconds;
            self.notes.curve.push(CurvePoint { iteration, seconds, psnr, train_psnr, gaussians });
        }
        self.spent.curve += evaluating.elapsed().as_secs_f64();
        Ok(psnr)
    }

    /// Adds a line to the log, if there is one.
    fn log_line(&mut self, progress: &Progress, psnr: Option<f64>) -> Result<(), Error> {
        let Some(log) = &mut self.log else { return Ok(()) };
        let Rates { means, log_scales, rotations, opacity_logits, sh } = self.trainer.rates();
        let line = LogLine {
            iteration: progress.iteration,
            iterations: self.config.schedule.iterations,
            seconds: self.notes.seconds,
            loss: Some(progress.loss).filter(|loss| loss.is_finite()),
            gaussians: progress.gaussians,
            psnr: psnr.filter(|psnr| psnr.is_finite()),
            rates: LoggedRates { means, log_scales, rotations, opacity_logits, sh0: sh[0], sh_rest: sh[1] },
            device_bytes: self.setup.session.device.memory_used().0,
        };
        log.add(&line)?;
        self.setup.session.watcher.logged(&line);
        Ok(())
    }

    /// The device's memory use so far, in all parts of the run.
    fn memory(&self) -> Memory {
        let memory = self.setup.session.memory(self.setup.estimated_bytes.max(self.notes.estimated));
        Memory { peak_bytes: memory.peak_bytes.max(self.notes.peak), ..memory }
    }

    /// The state needed to continue from here.
    pub fn checkpoint(&self) -> Result<Checkpoint, Error> {
        let Memory { estimated_bytes: estimated, peak_bytes: peak, .. } = self.memory();
        let notes = RunNotes { elapsed: self.setup.elapsed(), peak, estimated, ..self.notes.clone() };
        Checkpoint::new(self.trainer.snapshot()?, notes)
    }
}

/// Tells that the checkpoint of an iteration remains, if `error` is a lack of device memory.
pub fn tell_of_checkpoint(watcher: &dyn Watcher, error: &Error, iteration: u32) {
    if matches!(error, Error::Device(error) if error.is_resources()) {
        watcher.note(&format!(
            "the checkpoint of iteration {iteration} remains: where the device has more room, the same command continues from it \
             (`run` and `compare` with --resume)"
        ));
    }
}

/// The iterations whose responses are averaged.
fn averaged(config: &RunConfig) -> Range<u32> {
    match &config.prune {
        Some(p) if p.responses == ResponseSource::Average => {
            let length = config.schedule.iterations;
            let from = (f64::from(length) * p.average_from).round() as u32 + 1;
            from..p.iterations(length).last().copied().unwrap_or(0) + 1
        }
        _ => 0..0,
    }
}
