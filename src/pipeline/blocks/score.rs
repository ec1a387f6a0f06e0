//! Scores of a run in blocks, by parts of the photos.

use super::run::BlockRun;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::pipeline::config::RunConfig;
use crate::pipeline::eval::{self, Evaluation};
use crate::pipeline::evaluate::{Assessment, Compared, protocol};
use crate::pipeline::prepare::open;
use crate::pipeline::records::{Protocol, RunRecord};
use crate::pipeline::session::Session;
use std::ops::Range;
use std::path::Path;

impl BlockRun {
    /// Number of photos that are scored: those held out, then those trained on.
    pub fn scored(&self) -> usize {
        self.held_out.len() + self.photos.len()
    }

    /// Measures the joined model on some of the photos that are scored, by their numbers.
    ///
    /// # Errors
    /// As of an evaluation; photos other than the plan's.
    pub fn score(&self, session: &Session<'_>, model: &Gaussians, photos: Range<usize>) -> Result<Assessment, Error> {
        let RunConfig { style, exposure, .. } = self.config;
        let evaluation = Evaluation { selection: self.config.selection(), style, exposure };
        let first = self.held_out.len();
        let held_out = &self.held_out[photos.start.min(first)..photos.end.min(first)];
        let trained = &self.photos[photos.start.max(first) - first..photos.end.max(first) - first];
        eval::part(session, model, &evaluation, [held_out, trained])
    }

    /// The record of the joined model, read from `file`, by what was measured on all photos. Tells the watcher of empty pictures.
    ///
    /// # Errors
    /// Those of reading the scene.
    pub fn record(
        &self,
        session: &Session<'_>,
        (file, model): (&Path, &Gaussians),
        measured: Assessment,
    ) -> Result<RunRecord, Error> {
        measured.held_out.warn(session.watcher);
        let (config, selection) = (&self.config, self.config.selection());
        let compared = Compared {
            train_views: self.photos.len(),
            test_views: self.held_out.len(),
            image_size: open(&selection)?.only(&[&self.held_out[..], &self.photos].concat())?.size(),
            background: config.background.unwrap_or_default(),
        };
        let protocol = Protocol {
            iterations: Some(config.schedule.iterations),
            seed: Some(config.seed),
            ..protocol(&selection, compared, session.networks, config.exposure)
        };
        Ok(measured.record(session, self.skipped.clone(), protocol, model, file))
    }
}
