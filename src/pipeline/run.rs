//! `qirf-vk run`: from photos to a trained model, its pictures and its figures.

use super::budget;
use super::compression::{Responses, prune};
use super::config::RunConfig;
use super::effects;
use super::evaluate::Evaluator;
use super::output::Output;
use super::prepare::{Prepared, Start, initialise, open};
use super::results::{Counts, CurvePoint, Guards, Memory, Protocol, Pruned, Results, Times, TrainScores};
use super::watcher::Watcher;
use crate::error::Error;
use crate::gaussians::formats;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::render::Settings;
use crate::train::checkpoint::Snapshot;
use crate::train::loss::Weights;
use crate::train::{Options, Trainer};
use std::time::Instant;

/// Points of the quality curve.
const CURVE_POINTS: u32 = 8;

/// Trains, evaluates and writes a run. With `resume` it goes on from the folder's checkpoint, if there is one, and ends
/// with the same bytes as the unbroken run. Photos take no more than `host_bytes` of the host's memory.
///
/// # Errors
/// Anything from scene to disk; [`Error::Interrupted`] after a checkpoint.
pub fn run(
    device: &Device,
    config: &RunConfig,
    output: &Output,
    networks: &Networks,
    host_bytes: u64,
    resume: bool,
    watcher: &(dyn Watcher + Sync),
) -> Result<Results, Error> {
    let begun = Instant::now();
    let snapshot = found(output, resume, watcher)?;
    let going_on = snapshot.as_ref().map(|s| s.notes.get("config").cloned());
    let opened = open(&config.selection())?;
    let start = match snapshot {
        Some(s) => Start::Resumed(Box::new(s)),
        None => Start::of(config, &opened)?,
    };
    let estimated_bytes = budget::for_run(device, config, &opened, &start)?;
    let prepared = opened.load((host_bytes, output.folder()), &|done, total| watcher.loading(done, total))?;
    for line in prepared.scene.skipped.summary() {
        watcher.note(&line);
    }
    if prepared.train.is_empty() {
        return Err(Error::Usage(format!(
            "{}: no photo is left to train on; use a larger --eval-every",
            config.scene.display()
        )));
    }
    let decisions = effects::decide(&prepared, config)?;
    watcher.note(&effects::summary(&decisions));
    let config = &config.decided(&decisions);
    let written =
        toml::to_string(config).map_err(|e| Error::Usage(format!("the configuration cannot be written: {e}")))?;
    if going_on.is_some_and(|of| of.as_deref() != Some(written.as_str())) {
        return Err(Error::Usage(format!(
            "{} is of a run with other options: give those it had ({}), or start without --resume",
            output.checkpoint().display(),
            output.config().display()
        )));
    }
    Output::text(&output.config(), &written)?;
    let load_s = begun.elapsed().as_secs_f64();
    let settings = Settings { background: prepared.background, antialias: config.antialias, ..Settings::default() };

    let mut job = Job::start(device, config, &prepared, settings, start)?;
    job.train(config, &prepared, output, &written, watcher)?;

    let evaluating = Instant::now();
    let model = job.trainer.download()?;
    formats::write(&output.model(), &model).map_err(Error::writing)?;
    let evaluator = &mut job.evaluator;
    let resident = job.trainer.model();
    let held_out = evaluator.held_out(resident, &prepared, Some(&output.renders()), networks, &mut |done| {
        watcher.evaluating(done, prepared.test.len());
        Ok(())
    })?;
    held_out.warn(watcher);
    let unfitted_psnr = if config.exposure {
        evaluator.compare_as(false, prepared.masked);
        let psnr = evaluator.psnr(resident, prepared.test.iter().map(|(_, view)| view))?;
        evaluator.compare_as(true, prepared.masked);
        psnr
    } else {
        None
    };
    let train_psnr = evaluator.psnr(resident, prepared.train.iter())?;
    let frames_per_second = evaluator.frames_per_second(resident, &prepared)?;
    let results = Results {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.info().clone(),
        protocol: Protocol {
            iterations: Some(config.schedule.iterations),
            seed: Some(config.seed),
            exposure: Protocol::exposure(config.exposure),
            ..Protocol::new(&config.selection(), &prepared, networks)
        },
        gaussians: Counts {
            initial: Some(job.initial),
            dense: Some(job.prunes.first().map_or(model.len(), |p| p.before)),
            last: model.len(),
        },
        test: held_out.mean(),
        unfitted_psnr,
        train: TrainScores { psnr: train_psnr },
        frames_per_second,
        model_bytes: std::fs::metadata(output.model()).map_or(0, |m| m.len()),
        prunes: job.prunes.clone(),
        curve: job.curve,
        time: Times {
            total_s: begun.elapsed().as_secs_f64(),
            load_s,
            train_s: job.seconds,
            prune_s: job.prunes.iter().map(|p| p.seconds.total).sum(),
            evaluate_s: evaluating.elapsed().as_secs_f64(),
            stages_s: Times::stages(job.trainer.timings()),
        },
        effects: effects::timed(decisions, job.trainer.timings()),
        guards: Guards {
            skipped_rows: job.trainer.skipped_rows(),
            empty_views: held_out.empty,
            scene: prepared.scene.skipped.clone(),
        },
        views: held_out.views,
        memory: Memory { estimated_bytes, peak_bytes: device.memory_used().1, limit_bytes: device.memory_limit() },
    };
    results.write(output)?;
    // The run is whole: nothing is left to go on from.
    let _ = std::fs::remove_file(output.checkpoint());
    Ok(results)
}

/// The snapshot to go on from, if that is asked for and there is one.
fn found(output: &Output, resume: bool, watcher: &dyn Watcher) -> Result<Option<Snapshot>, Error> {
    if !resume {
        return Ok(None);
    }
    let path = output.checkpoint();
    if !path.exists() {
        watcher.note("no checkpoint is there yet: starting afresh");
        return Ok(None);
    }
    let snapshot = Snapshot::read(&path)?;
    watcher.note(&format!("going on after iteration {}", snapshot.iteration));
    Ok(Some(snapshot))
}

/// The iterations whose responses are averaged.
fn averaged(config: &RunConfig) -> std::ops::Range<u32> {
    match &config.prune {
        Some(p) if p.responses == Responses::Average => {
            let length = config.schedule.iterations;
            let from = (f64::from(length) * p.average_from).round() as u32 + 1;
            from..p.iterations(length).last().copied().unwrap_or(0) + 1
        }
        _ => 0..0,
    }
}

/// The loss once the model has been pruned.
fn fine_tuning(config: &RunConfig) -> Weights {
    let l2 = config.prune.as_ref().map_or(0.0, |p| p.l2 as f32);
    Weights { l2, ..Weights::default() }
}

/// A run under way.
struct Job {
    device: Device,
    trainer: Trainer,
    evaluator: Evaluator,
    initial: usize,
    seconds: f64,
    curve: Vec<CurvePoint>,
    prunes: Vec<Pruned>,
}

impl Job {
    fn start(
        device: &Device,
        config: &RunConfig,
        prepared: &Prepared,
        settings: Settings,
        start: Start,
    ) -> Result<Self, Error> {
        let options = |gaussians: usize| Options {
            schedule: config.schedule.clone(),
            settings,
            seed: config.seed,
            degree: config.sh_degree,
            most: config.max_gaussians,
            transparent: prepared.transparent,
            masked: prepared.masked,
            exposure: config.exposure,
            weights: Weights::default(),
            averaged: averaged(config),
            pairs: budget::pairs(gaussians),
        };
        let views = prepared.train.clone();
        let (mut trainer, initial, seconds, curve, prunes) = if let Start::Resumed(s) = start {
            let options = options(s.model.len());
            let note = |key: &str| s.notes.get(key).cloned().unwrap_or_default();
            let trainer = Trainer::resume(device, &s, views, prepared.extent, options)?;
            let curve = serde_json::from_str(&note("curve")).unwrap_or_default();
            let prunes: Vec<Pruned> = serde_json::from_str(&note("prunes")).unwrap_or_default();
            (trainer, note("initial").parse().unwrap_or(0), note("seconds").parse().unwrap_or(0.0), curve, prunes)
        } else {
            let model = initialise(config, prepared, start)?;
            let n = model.len();
            (Trainer::new(device, &model, views, prepared.extent, options(n))?, n, 0.0, Vec::new(), Vec::new())
        };
        if !prunes.is_empty() {
            trainer.weigh(fine_tuning(config));
        }
        let mut evaluator = Evaluator::new(device, settings, trainer.len(), prepared.views())?;
        evaluator.compare_as(config.exposure, prepared.masked);
        Ok(Self { device: device.clone(), trainer, evaluator, initial, seconds, curve, prunes })
    }

    fn train(
        &mut self,
        config: &RunConfig,
        prepared: &Prepared,
        output: &Output,
        written: &str,
        watcher: &dyn Watcher,
    ) -> Result<(), Error> {
        let last = config.schedule.iterations;
        let step = last.div_ceil(CURVE_POINTS).max(1);
        let every = config.checkpoint_every;
        let prunes = config.prune.as_ref().map(|p| p.iterations(last)).unwrap_or_default();
        while self.trainer.iteration() < last {
            let now = self.trainer.iteration();
            if let Some(at) = prunes.get(self.prunes.len()).filter(|at| **at <= now) {
                self.prune(config, prepared, (*at).max(now), prunes.len(), watcher)?;
            }
            let pause = prunes.get(self.prunes.len()).copied().unwrap_or(last);
            let next = |every: u32| now.checked_div(every).map_or(last, |passed| (passed + 1) * every);
            let started = Instant::now();
            let progress = self.trainer.advance(last.min(next(step)).min(next(every)).min(pause))?;
            self.seconds += started.elapsed().as_secs_f64();
            watcher.training(&progress, last);
            let at = progress.iteration;
            let recorded = self.curve.last().is_some_and(|p| p.iteration == at);
            if at > now && (at.is_multiple_of(step) || at == last) && !recorded {
                self.point(at, prepared)?;
            }
            let stop = watcher.stop();
            if stop || (every > 0 && at > now && at.is_multiple_of(every) && at < last) {
                self.checkpoint(output, written)?;
            }
            if stop {
                return Err(Error::Interrupted);
            }
        }
        Ok(())
    }

    fn prune(
        &mut self,
        config: &RunConfig,
        prepared: &Prepared,
        iteration: u32,
        steps: usize,
        watcher: &dyn Watcher,
    ) -> Result<(), Error> {
        let Some(pruning) = &config.prune else { return Ok(()) };
        let frames = self.evaluator.frames_per_second(self.trainer.model(), prepared)?;
        let keep = pruning.keep(self.prunes.len(), steps, self.trainer.len());
        let device = &self.device;
        let mut pruned = prune(device, &mut self.trainer, &pruning.compression, keep, pruning.responses, config.seed)?;
        pruned.frames_per_second_before = frames;
        self.trainer.weigh(fine_tuning(config));
        watcher.note(&format!(
            "after iteration {iteration}: {} of {} Gaussians kept, {} blocks, {:.1} s",
            pruned.after, pruned.before, pruned.blocks, pruned.seconds.total
        ));
        self.seconds += pruned.seconds.total;
        self.prunes.push(pruned);
        Ok(())
    }

    fn point(&mut self, iteration: u32, prepared: &Prepared) -> Result<(), Error> {
        let views = prepared.test.iter().map(|(_, view)| view);
        if let Some(psnr) = self.evaluator.psnr(self.trainer.model(), views)? {
            let gaussians = self.trainer.len();
            self.curve.push(CurvePoint { iteration, seconds: self.seconds, psnr, gaussians });
        }
        Ok(())
    }

    fn checkpoint(&self, output: &Output, written: &str) -> Result<(), Error> {
        let mut snapshot = self.trainer.snapshot()?;
        let curve = serde_json::to_string(&self.curve).unwrap_or_default();
        let prunes = serde_json::to_string(&self.prunes).unwrap_or_default();
        for (key, value) in [
            ("config", written.to_owned()),
            ("curve", curve),
            ("prunes", prunes),
            ("seconds", self.seconds.to_string()),
            ("initial", self.initial.to_string()),
        ] {
            snapshot.notes.insert(key.into(), value);
        }
        snapshot.write(&output.checkpoint()).map_err(Error::writing)
    }
}
