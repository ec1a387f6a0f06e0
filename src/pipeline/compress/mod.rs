//! `qirf-vk compress`: from an existing model to a smaller one.

pub mod aim;
mod config;
pub mod fit;
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
use crate::metrics;
use crate::pipeline::Error;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Keep;
use aim::Aim;
use fit::{Fitted, Judge};
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
    compress_to(session, input, (config, None), output)
}

/// Compresses a model in memory: the record's files have no path, and no bytes.
///
/// # Errors
/// As of [`compress`].
pub fn compress_in_memory(
    session: &Session<'_>,
    model: Gaussians,
    config: &CompressConfig,
) -> Result<(CompressRecord, Gaussians), Error> {
    let input = Input { path: Path::new(""), model, read_s: 0.0 };
    let Reduced { record, model, .. } = reduce(session, input, (config, None), Path::new(""))?;
    Ok((record, model))
}

/// As [`compress`]; with an aim, the number of Gaussians and the format's settings are those of the best file that meets it.
///
/// # Errors
/// As of [`compress`]; [`Error::Usage`] for a size that even one Gaussian exceeds, or a selector other than pairs.
pub fn compress_to(
    session: &Session<'_>,
    input: Input<'_>,
    (config, aim): (&CompressConfig, Option<Aim>),
    output: &Path,
) -> Result<CompressRecord, Error> {
    let begun = Instant::now();
    let Reduced { mut record, model, bytes } = reduce(session, input, (config, aim), output)?;
    session.watcher.unless_stopped()?;
    let writing = Instant::now();
    match bytes {
        Some(bytes) => formats::write_atomically(output, |out| out.write_all(&bytes)),
        None => formats::write(output, &model, config.style.mode()),
    }
    .map_err(Error::writing)?;
    record.output = model_file(output, &model);
    record.time.write_s += seconds(writing);
    record.time.total_s = record.time.read_s + seconds(begun);
    Ok(record)
}

/// A compressed model that is not written yet.
struct Reduced {
    record: CompressRecord,
    model: Gaussians,
    /// Its file, where pictures decided on how finely that stores it.
    bytes: Option<Vec<u8>>,
}

/// Compresses a model for a file called `output`, which is not written.
fn reduce(
    session: &Session<'_>,
    input: Input<'_>,
    (config, aim): (&CompressConfig, Option<Aim>),
    output: &Path,
) -> Result<Reduced, Error> {
    let begun = Instant::now();
    if aim.is_some() && config.compression.selector != Selector::Pairs {
        let what = "--size and --psnr need --selector pairs, whose merges lead to every number of Gaussians";
        return Err(Error::Usage(what.to_owned()));
    }
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

    // Pictures decide how finely a model is worth storing as SOG.
    let is_sog = output.extension().is_some_and(|e| e.eq_ignore_ascii_case("sog"));
    let by_held_out = !matches!(aim, Some(Aim::Bytes(_)));
    let judge =
        (aim.is_some() || is_sog).then(|| Judge::new(session, &views, shown.source(), by_held_out)).transpose()?;
    let request = PruneRequest { compression: &config.compression, keep, seed: config.seed };
    let (plan, fitted) = match aim.zip(judge.as_ref()) {
        None => (prune::plan(device, shown.source(), &model, &responses, &request)?, None),
        Some((aim, judge)) => {
            let Fitted { plan, bytes, precision, record } = fit::fit(judge, &model, &responses, (config, aim), output)?;
            (plan, Some((bytes, precision, record)))
        }
    };
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
    let last = if tuned.is_empty() { &after } else { &tuned };
    let psnr = metrics::mean(last).and_then(|scores| scores.psnr);
    let (bytes, aim): (Option<Vec<u8>>, _) = match fitted {
        Some((bytes, _, record)) if tuned.is_empty() => (Some(bytes), Some(record)),
        Some((bytes, precision, record)) => {
            let most = if let Aim::Bytes(size) = record.aim { size } else { bytes.len() as u64 };
            (Some(fit::within(&mut model, (config, &precision), most, output)?), Some(record))
        }
        None => (judge.map(|judge| fit::written(&judge, &model, (config, psnr), output)).transpose()?, None),
    };
    time.write_s = seconds(writing);
    time.total_s = read_s + seconds(begun);
    let stages = views.stages([before, after, tuned]);
    let record = CompressRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.tuned(),
        protocol: views.protocol(config),
        input,
        output: model_file(output, &model),
        prune,
        aim,
        test: StageScores::mean(&stages),
        views: stages,
        time,
        memory: session.memory(views.estimated_bytes),
    };
    Ok(Reduced { record, model, bytes })
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
