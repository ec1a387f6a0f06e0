//! `qirf-vk compress`: from an existing model to a smaller one.

mod config;
mod scoring;
pub mod stages;
mod train;
mod views;

pub use config::{CompressConfig, ViewSource};

use super::output::bytes_on_disk;
use super::prune::{self, PruneRequest};
use super::records::{CompressRecord, CompressTimes, ModelFile, StageScores, Truth};
use super::session::Session;
use super::virtual_views::ALL;
use crate::gaussians::{Gaussians, formats};
use crate::pipeline::Error;
use crate::qirf::select::budget::Keep;
use scoring::Scoring;
use std::path::Path;
use std::time::Instant;
use views::Views;

/// A model, the file it was read from, and the time of reading.
pub struct Input<'a> {
    /// The file.
    pub path: &'a Path,
    /// The model.
    pub model: Gaussians,
    /// Seconds that reading it took.
    pub read_s: f64,
}

/// Compresses a model and writes it to `output`, whose extension decides the format.
///
/// # Errors
/// Any error from reading the model to writing it; [`Error::Interrupted`], with no model written.
pub fn compress(
    session: &Session<'_>,
    input: Input<'_>,
    config: &CompressConfig,
    output: &Path,
) -> Result<CompressRecord, Error> {
    let begun = Instant::now();
    let Session { device, watcher, .. } = *session;
    let Input { path, model, read_s } = input;
    let input = model_file(path, &model);
    let mut time = CompressTimes { read_s, ..CompressTimes::default() };
    let keep = at_least_one(config.compression.keep, model.len());

    let (views, shown) = Views::load(session, &model, config, ALL)?;
    time.truth_s = seconds(begun);
    let mut scoring = Scoring::new(session, &views, config);
    let before = if views.truth == Truth::Photos { scoring.scores(shown.source())? } else { Vec::new() };

    let responding = Instant::now();
    let responses = train::respond(session, shown.source(), model.degree(), (&views, None), config)?;
    time.responses_s = seconds(responding);

    let request = PruneRequest { compression: &config.compression, keep, seed: config.seed };
    let plan = prune::plan(device, shown.source(), &model, &responses, &request)?;
    drop((shown, responses));
    watcher.unless_stopped()?;
    watcher.pruned(&model, config.style.mode(), &plan.diagnostics)?;
    let (prune, mut model) = plan.apply(model);
    time.merge_s = prune.seconds.merge;
    time.keep_mask_s = prune.seconds.total - prune.seconds.merge;
    let after = scoring.scores_of(&model)?;

    let tuning = Instant::now();
    let mut tuned = Vec::new();
    if config.fine_tune > 0 {
        model = train::fine_tune(session, &model, &views, config)?;
        time.fine_tune_s = seconds(tuning);
        tuned = scoring.scores_of(&model)?;
    }
    time.evaluate_s = scoring.seconds;

    watcher.unless_stopped()?;
    let writing = Instant::now();
    formats::write(output, &model, config.style.mode()).map_err(Error::writing)?;
    time.write_s = seconds(writing);
    time.total_s = read_s + seconds(begun);
    let stages = views.stages([before, after, tuned]);
    Ok(CompressRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.tuned(),
        protocol: views.protocol(config),
        input,
        output: model_file(output, &model),
        prune,
        test: StageScores::mean(&stages),
        views: stages,
        time,
        memory: session.memory(views.estimated_bytes),
    })
}

fn model_file(path: &Path, model: &Gaussians) -> ModelFile {
    ModelFile { path: path.to_owned(), bytes: bytes_on_disk(path), gaussians: model.len(), sh_degree: model.degree() }
}

fn seconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64()
}

/// Keeps at least one Gaussian: a share of a few may round to none, which is no model.
fn at_least_one(keep: Keep, gaussians: usize) -> Keep {
    match keep {
        Keep::Share(share) if share * (gaussians as f64) < 1.0 => Keep::Count(1),
        keep => keep,
    }
}
