//! Scores of a model before and after each stage of a compression.

use super::config::CompressConfig;
use super::views::Views;
use crate::gaussians::Gaussians;
use crate::job::records::Truth;
use crate::job::{Error, Session, Stage};
use crate::metrics::Scores;
use crate::pipeline::draw_source::DrawSource;
use crate::pipeline::evaluate::Evaluator;
use crate::render::Source;
use crate::scene::camera;
use std::time::Instant;

/// Scores models on the held-out views.
pub struct Scoring<'a> {
    session: &'a Session<'a>,
    views: &'a Views,
    /// Number of views to score in all stages, and number of views scored so far.
    total: usize,
    done: usize,
    /// Seconds spent so far.
    pub seconds: f64,
}

impl<'a> Scoring<'a> {
    pub fn new(session: &'a Session<'a>, views: &'a Views, config: &CompressConfig) -> Self {
        let stages = 2 + usize::from(views.truth == Truth::Photos) + usize::from(config.fine_tune > 0);
        Self { session, views, total: stages * views.test.len(), done: 0, seconds: 0.0 }
    }

    /// The scores of a model on the host in each held-out view.
    pub fn scores_of(&mut self, model: &Gaussians) -> Result<Vec<Scores>, Error> {
        let Views { test, settings, .. } = self.views;
        let size = camera::largest(test.iter().map(|(_, view)| &view.camera));
        self.scores(DrawSource::for_pictures(self.session, model, size, settings.style)?.source())
    }

    /// The scores of a model in each held-out view.
    pub fn scores(&mut self, model: Source<'_>) -> Result<Vec<Scores>, Error> {
        let begun = Instant::now();
        let Session { device, networks, watcher, .. } = *self.session;
        let Views { test, settings, .. } = self.views;
        let mut evaluator = Evaluator::of(device, *settings, model, test.iter().map(|(_, view)| view))?;
        evaluator.compare_as(self.views.fits_exposure);
        let (done, total) = (self.done, self.total);
        let held_out = evaluator.held_out(model, test, None, networks, &mut |now| {
            watcher.step(Stage::Scores, done + now, total.max(done + test.len()))
        })?;
        self.done += test.len();
        self.seconds += begun.elapsed().as_secs_f64();
        Ok(held_out.views.into_iter().map(|v| v.scores).collect())
    }
}
