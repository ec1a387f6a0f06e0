//! The end of a run: its model, scores and records.

use super::ActiveRun;
use crate::edit::are_many_floaters;
use crate::gaussians::resident::Resident;
use crate::job::records::{Counts, FloaterCounts, Guards, Protocol, PruneRecord, RunRecord, Times};
use crate::job::{Error, Output, Session, Silent, Stage};
use crate::pipeline::effects;
use crate::pipeline::evaluate::{camera_errors, exhibits, protocol};
use crate::pipeline::floaters::of_training;
use crate::pipeline::setup::Setup;
use crate::wording::counted;
use std::time::Instant;

impl ActiveRun<'_> {
    /// Writes the model, scores it, and writes the results.
    pub fn finish(mut self) -> Result<RunRecord, Error> {
        let Setup { session, prepared, .. } = self.setup;
        let Session { networks, watcher, .. } = *session;
        let (config, output) = (self.config, self.output);
        let (evaluating, written) = (Instant::now(), self.spent.write);
        let mut model = self.trainer.download()?;
        let mut floaters = None;
        if config.clean {
            let found = of_training(session, &model, &mut self.trainer, &prepared.train)?;
            model.compact(&found.iter().map(Option::is_none).collect::<Vec<_>>());
            let (counts, removed) = (FloaterCounts::of(&found), found.iter().flatten().count());
            watcher.note(&format!("{} removed: {counts}", counted(removed, "floater")));
            if are_many_floaters(removed, found.len()) {
                watcher.note("that is far more than usual, and may cost quality: train longer, or leave out --clean");
            }
            floaters = Some((counts, Resident::upload(session.device, &model)?));
        }
        let writing = Instant::now();
        prepared.write(&output.model(), &model, config.style.mode())?;
        self.spent.write += writing.elapsed().as_secs_f64();
        let mut follow = |done: usize| {
            watcher.progress(Stage::Scores, done, prepared.test.len());
            Ok(())
        };
        let cleaned = floaters.as_ref().map(|(_, cleaned)| cleaned);
        let renders = output.renders();
        let photos = self.trainer.photos().to_vec();
        let assessment = self.shown(|evaluator, model| {
            let model = cleaned.unwrap_or(model);
            let mut assessment = evaluator.assess(model, prepared, Some(&renders), networks, &mut follow)?;
            assessment.train_psnr = evaluator.psnr(model, photos.iter())?;
            assessment.frames_per_second = evaluator.frames_per_second(model, prepared)?;
            Ok(assessment)
        })?;
        assessment.held_out.warn(watcher);
        let writing = Instant::now();
        exhibits::photos(prepared, &output.renders())?;
        self.spent.write += writing.elapsed().as_secs_f64();
        let protocol = Protocol {
            iterations: Some(config.schedule.iterations),
            seed: Some(config.seed),
            ..protocol(&config.selection(), prepared, networks, config.exposure)
        };
        let evaluated = assessment.record(session, prepared.scene.skipped.clone(), protocol, &model, &output.model());
        let floaters = floaters.map(|(counts, _)| counts);
        let setup = self.setup;
        let mut record = RunRecord { floaters, ..self.record(evaluated) };
        // The trainer is gone: there is room for the model's depths. As the evaluation before, this is not interrupted.
        let session = &Session { watcher: &Silent, ..*session };
        let settings = prepared.settings(config.style);
        let held_out: Vec<_> = prepared.test.iter().map(|(_, photo)| photo).collect();
        record.camera_errors = camera_errors(session, &model, &held_out, settings, config.exposure)?;
        record.time.evaluate_s = evaluating.elapsed().as_secs_f64() - (record.time.write_s - written);
        record.time.total_s = setup.elapsed();
        let passes = f64::from(config.schedule.iterations) / prepared.train.len().max(1) as f64;
        if let Some(note) = record.camera_errors.and_then(|errors| errors.note(Some(passes), config.poses)) {
            watcher.note(&note);
        }
        if let Some(told) = record.told_past_best() {
            watcher.note(&format!("the run was {told}"));
        }
        Output::json(&output.metrics(), "metrics.json", &record)?;
        Ok(record)
    }

    /// An evaluation's record with the figures of training added.
    fn record(self, evaluated: RunRecord) -> RunRecord {
        let memory = self.memory();
        let Self { setup, trainer, notes, spent, .. } = self;
        RunRecord {
            gaussians: Counts {
                initial: Some(notes.initial),
                dense: Some(notes.prunes.first().map_or(evaluated.gaussians.last, PruneRecord::dense)),
                ..evaluated.gaussians
            },
            guards: Guards { skipped_rows: trainer.skipped_rows(), ..evaluated.guards },
            time: Times {
                load_s: setup.load_s,
                start_s: spent.start,
                train_s: notes.seconds,
                prune_s: notes.prunes.iter().fold(0.0, |sum, p| sum + p.seconds.total),
                curve_s: spent.curve,
                write_s: spent.write,
                stages_s: trainer.timings().iter().map(|(name, seconds, _)| (name, seconds)).collect(),
                ..Times::default()
            },
            prunes: notes.prunes,
            cut: trainer.cut(),
            curve: notes.curve,
            effects: effects::timed(
                effects::moved(setup.decisions.clone(), trainer.moved_cameras()),
                trainer.timings(),
            ),
            memory,
            ..evaluated
        }
    }
}
