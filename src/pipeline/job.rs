//! A run under way: training, prunes, checkpoints, and what is left at its end. `run` conducts one, `compare` many from one
//! checkpoint.

use super::checkpoint::{Checkpoint, Notes};
use super::config::{ResponseSource, RunConfig};
use super::effects;
use super::evaluate::{Evaluator, exhibits, exposure_note, protocol};
use super::output::{Output, bytes_on_disk};
use super::pairs;
use super::prepare::{Opened, Prepared, Start, initialise};
use super::prune::prune;
use super::records::{Counts, CurvePoint, Guards, Memory, Protocol, RunRecord, Times, TrainScores};
use super::watcher::Watcher;
use crate::effects::Decision;
use crate::error::Error;
use crate::gaussians::formats;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::response::Responses;
use crate::scene::PhotoMemory;
use crate::train::loss::Weights;
use crate::train::{Options, Trainer};
use std::ops::Range;
use std::time::Instant;

/// Points of the quality curve.
const CURVE_POINTS: u32 = 8;

/// What all runs on one scene share.
pub struct Stage<'a> {
    /// Where they run.
    pub device: &'a Device,
    /// The scene's views.
    pub prepared: Prepared,
    /// Networks of LPIPS.
    pub networks: &'a Networks,
    /// Who follows them.
    pub watcher: &'a dyn Watcher,
    /// Device memory that was expected before the start.
    pub estimated_bytes: u64,
    /// What was decided on each effect.
    pub decisions: Vec<Decision>,
    /// By training view: gains of red, green and blue against the others, as measured.
    pub gains: Vec<[f32; 3]>,
    /// When it began, and the seconds until the photos were there.
    pub begun: (Instant, f64),
}

impl<'a> Stage<'a> {
    /// Decodes the photos of an opened scene, which take no more than `host_bytes` of the host's memory, and decides on its
    /// effects; also gives the configuration with what was decided.
    ///
    /// # Errors
    /// No photo that can be decoded; none to train on; a disk that is full.
    pub fn load(
        device: &'a Device,
        (opened, config): (Opened, &RunConfig),
        (host_bytes, output): (u64, &Output),
        networks: &'a Networks,
        watcher: &'a (dyn Watcher + Sync),
        (begun, estimated_bytes): (Instant, u64),
    ) -> Result<(Self, RunConfig), Error> {
        let memory = PhotoMemory { bytes: host_bytes, folder: output.folder() };
        let prepared = opened.load_to_train(memory, watcher)?;
        let (decisions, gains) = effects::decide(&prepared, config)?;
        watcher.note(&effects::summary(&decisions));
        let config = config.decided(&decisions);
        let begun = (begun, begun.elapsed().as_secs_f64());
        Ok((Self { device, prepared, networks, watcher, estimated_bytes, decisions, gains, begun }, config))
    }
}

/// A run under way.
pub struct Job<'a> {
    stage: &'a Stage<'a>,
    config: &'a RunConfig,
    output: &'a Output,
    trainer: Trainer,
    evaluator: Evaluator,
    notes: Notes,
}

impl<'a> Job<'a> {
    /// Begins, or goes on from a snapshot.
    ///
    /// # Errors
    /// Device memory; device errors; cameras that leave no place for random points.
    pub fn start(stage: &'a Stage<'a>, config: &'a RunConfig, output: &'a Output, start: Start) -> Result<Self, Error> {
        let Stage { device, prepared, .. } = stage;
        let settings = config.style().over(prepared.background);
        let options = |gaussians: usize| Options {
            schedule: config.schedule.clone(),
            settings,
            seed: config.seed,
            degree: config.sh_degree,
            most: config.max_gaussians,
            exposure: config.exposure.then(|| stage.gains.clone()),
            weights: Weights::default(),
            averaged: averaged(config),
            pairs: pairs::room(gaussians),
        };
        let views = prepared.train.clone();
        let config_text = config.written()?;
        let (trainer, notes) = if let Start::Resumed(checkpoint) = start {
            let Checkpoint { snapshot, notes } = *checkpoint;
            let options = options(snapshot.model.len());
            let trainer = Trainer::resume(device, &snapshot, views, prepared.extent, options)?;
            (trainer, Notes { config: config_text, ..notes })
        } else {
            let model = initialise(config, prepared, start)?;
            let initial = model.len();
            let trainer = Trainer::new(device, &model, views, prepared.extent, options(initial))?;
            let none = Notes { config: config_text, curve: Vec::new(), prunes: Vec::new(), seconds: 0.0, initial };
            (trainer, none)
        };
        let mut evaluator = Evaluator::new(device, settings, trainer.len(), prepared.views())?;
        evaluator.compare_as(config.exposure);
        let mut job = Self { stage, config, output, trainer, evaluator, notes };
        if !job.notes.prunes.is_empty() {
            job.fine_tune();
        }
        Ok(job)
    }

    /// Trains until `until` iterations are done, pruning and keeping checkpoints on the way. A prune due after the last of
    /// them is left to whoever goes on.
    ///
    /// # Errors
    /// Device memory; device errors; a checkpoint that cannot be written; [`Error::Interrupted`] after one.
    pub fn train(&mut self, until: u32) -> Result<(), Error> {
        let last = self.config.schedule.iterations;
        let step = last.div_ceil(CURVE_POINTS).max(1);
        let every = self.config.checkpoint_every;
        let prunes = self.config.prune.as_ref().map(|p| p.iterations(last)).unwrap_or_default();
        while self.trainer.iteration() < until {
            let now = self.trainer.iteration();
            if prunes.get(self.notes.prunes.len()).is_some_and(|at| *at <= now) {
                self.prune(prunes.len())?;
            }
            let pause = prunes.get(self.notes.prunes.len()).copied().unwrap_or(last);
            let next = |every: u32| now.checked_div(every).map_or(last, |passed| (passed + 1) * every);
            let started = Instant::now();
            let progress = self.trainer.advance(until.min(next(step)).min(next(every)).min(pause))?;
            self.notes.seconds += started.elapsed().as_secs_f64();
            self.stage.watcher.training(&progress, last);
            let at = progress.iteration;
            let recorded = self.notes.curve.last().is_some_and(|p| p.iteration == at);
            if at > now && (at.is_multiple_of(step) || at == last) && !recorded {
                self.point(at)?;
            }
            let stop = self.stage.watcher.stop();
            if stop || (every > 0 && at > now && at.is_multiple_of(every) && at < last) {
                self.checkpoint()?.write(&self.output.checkpoint())?;
            }
            if stop {
                return Err(Error::Interrupted);
            }
        }
        Ok(())
    }

    /// Prunes as the configuration says, whatever the iteration.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn prune_now(&mut self) -> Result<(), Error> {
        let steps = self.config.prune.as_ref().map_or(1, |p| p.iterations(self.config.schedule.iterations).len());
        self.prune(steps)
    }

    /// Goes on with the loss of fine-tuning.
    pub fn fine_tune(&mut self) {
        if let Some(pruning) = &self.config.prune {
            self.trainer.fine_tune(Weights { l2: pruning.l2 as f32, ..Weights::default() });
        }
    }

    /// Mean PSNR of the held-out views as the model stands, in dB.
    ///
    /// # Errors
    /// Device errors.
    pub fn psnr(&mut self) -> Result<Option<f64>, Error> {
        self.evaluator.psnr(self.trainer.model(), self.stage.prepared.test.iter().map(|(_, view)| view))
    }

    /// How strongly the training photos depend on each Gaussian of the model as it stands.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn responses(&mut self) -> Result<Responses, Error> {
        Ok(self.trainer.responses(false)?)
    }

    /// Prune number `self.notes.prunes.len()` of `steps`.
    fn prune(&mut self, steps: usize) -> Result<(), Error> {
        let Some(pruning) = &self.config.prune else { return Ok(()) };
        let Stage { device, prepared, watcher, .. } = self.stage;
        let frames = self.evaluator.frames_per_second(self.trainer.model(), prepared)?;
        if self.notes.prunes.is_empty() {
            exhibits::dense(&mut self.evaluator, self.trainer.model(), prepared, &self.output.renders())?;
        }
        let keep = pruning.keep(self.notes.prunes.len(), steps, self.trainer.len());
        let (compression, seed) = (&pruning.compression, self.config.seed);
        let mut pruned = prune(device, &mut self.trainer, compression, keep, pruning.responses, seed)?;
        pruned.frames_per_second_before = frames;
        self.fine_tune();
        watcher.note(&format!(
            "after iteration {}: {} of {} Gaussians kept, {} blocks, {:.1} s",
            pruned.iteration, pruned.after, pruned.before, pruned.blocks, pruned.seconds.total
        ));
        self.notes.seconds += pruned.seconds.total;
        self.notes.prunes.push(pruned);
        Ok(())
    }

    fn point(&mut self, iteration: u32) -> Result<(), Error> {
        if let Some(psnr) = self.psnr()? {
            let gaussians = self.trainer.len();
            self.notes.curve.push(CurvePoint { iteration, seconds: self.notes.seconds, psnr, gaussians });
        }
        Ok(())
    }

    /// All that it takes to go on from here.
    ///
    /// # Errors
    /// Device errors.
    pub fn checkpoint(&self) -> Result<Checkpoint, Error> {
        Checkpoint::new(self.trainer.snapshot()?, self.notes.clone())
    }

    /// Writes the model, scores it, and writes what was measured.
    ///
    /// # Errors
    /// Device errors; a disk that is full.
    pub fn finish(mut self) -> Result<RunRecord, Error> {
        let Stage { device, prepared, networks, watcher, estimated_bytes, begun, decisions, .. } = self.stage;
        let (config, output) = (self.config, self.output);
        let evaluating = Instant::now();
        let model = self.trainer.download()?;
        formats::write(&output.model(), &model).map_err(Error::writing)?;
        let (evaluator, resident) = (&mut self.evaluator, self.trainer.model());
        let held_out =
            evaluator.held_out(resident, &prepared.test, Some(&output.renders()), networks, &mut |done| {
                watcher.evaluating(done, prepared.test.len());
                Ok(())
            })?;
        held_out.warn(*watcher);
        exhibits::photos(prepared, &output.renders())?;
        let unfitted_psnr = if config.exposure {
            evaluator.compare_as(false);
            let psnr = evaluator.psnr(resident, prepared.test.iter().map(|(_, view)| view))?;
            evaluator.compare_as(true);
            psnr
        } else {
            None
        };
        let train_psnr = evaluator.psnr(resident, prepared.train.iter())?;
        let frames_per_second = evaluator.frames_per_second(resident, prepared)?;
        let results = RunRecord {
            schema: 1,
            version: env!("CARGO_PKG_VERSION"),
            device: device.info().clone(),
            protocol: Protocol {
                iterations: Some(config.schedule.iterations),
                seed: Some(config.seed),
                exposure: exposure_note(config.exposure),
                ..protocol(&config.selection(), prepared, networks)
            },
            gaussians: Counts {
                initial: Some(self.notes.initial),
                dense: Some(self.notes.prunes.first().map_or(model.len(), |p| p.before)),
                last: model.len(),
            },
            test: held_out.mean(),
            unfitted_psnr,
            train: TrainScores { psnr: train_psnr },
            frames_per_second,
            model_bytes: bytes_on_disk(&output.model()),
            time: Times {
                total_s: begun.0.elapsed().as_secs_f64(),
                load_s: begun.1,
                train_s: self.notes.seconds,
                prune_s: self.notes.prunes.iter().map(|p| p.seconds.total).sum(),
                evaluate_s: evaluating.elapsed().as_secs_f64(),
                stages_s: self.trainer.timings().iter().map(|(name, seconds, _)| (name, seconds)).collect(),
            },
            prunes: self.notes.prunes,
            curve: self.notes.curve,
            effects: effects::timed(decisions.clone(), self.trainer.timings()),
            guards: Guards {
                skipped_rows: self.trainer.skipped_rows(),
                undrawable: model.undrawable(),
                empty_views: held_out.empty,
                scene: prepared.scene.skipped.clone(),
            },
            views: held_out.views,
            memory: Memory {
                estimated_bytes: *estimated_bytes,
                peak_bytes: device.memory_used().1,
                limit_bytes: device.memory_limit(),
            },
        };
        Output::json(&output.metrics(), "metrics.json", &results)?;
        Ok(results)
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
