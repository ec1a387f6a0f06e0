//! Scores of a run in blocks, by parts of the photos.

use super::run::BlockRun;
use crate::gaussians::Gaussians;
use crate::job::records::{Protocol, RunRecord};
use crate::job::{Error, RunConfig, Session};
use crate::pipeline::eval::{self, Evaluation};
use crate::pipeline::evaluate::{Assessment, rules};
use std::ops::Range;
use std::path::Path;

impl BlockRun {
    /// Measures the joined model on some of the photos, by number: held-out photos come first, then training photos.
    pub fn score(&self, session: &Session<'_>, model: &Gaussians, photos: Range<usize>) -> Result<Assessment, Error> {
        let RunConfig { style, exposure, .. } = self.config;
        let evaluation = Evaluation { selection: self.selection(), style, exposure };
        let first = self.held_out.len();
        let held_out = &self.held_out[photos.start.min(first)..photos.end.min(first)];
        let trained = &self.photos[photos.start.max(first) - first..photos.end.max(first) - first];
        eval::part(session, model, &evaluation, [held_out, trained])
    }

    /// The record of the joined model, read from `file`, from the measurements on all photos. Reports empty pictures to
    /// the watcher.
    pub fn record(&self, session: &Session<'_>, file: &Path, model: &Gaussians, measured: Assessment) -> RunRecord {
        measured.held_out.warn(session.watcher);
        let config = &self.config;
        let protocol = Protocol {
            train_views: self.photos.len(),
            test_views: self.held_out.len(),
            image_size: self.image_size,
            background: config.background.unwrap_or_default(),
            iterations: Some(config.schedule.iterations),
            seed: Some(config.seed),
            ..rules(config.eval_every, session.networks, config.exposure)
        };
        measured.record(session, self.skipped.clone(), protocol, model, file)
    }
}
