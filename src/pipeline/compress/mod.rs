//! `qirf-vk compress`: reduction of an existing model.

mod config;
pub mod cost;
pub mod fit;
pub mod levels;
mod original;
pub mod remarks;
pub(crate) mod scoring;
pub mod stages;
pub(crate) mod train;
mod tuned;
pub(crate) mod views;

pub use config::{CompressConfig, ViewSource};

use super::prune::{self, PrunePlan, PruneRequest};
use crate::gaussians::{Gaussians, formats};
use crate::gpu::Device;
use crate::job::records::{Aim, AimRecord, CompressRecord, CompressTimes, ModelFile, StageScores, Truth};
use crate::job::{Error, Session};
use crate::metrics::{self, Scores};
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Keep;
use crate::render::Source;
use crate::response::Responses;
use fit::{Fitted, Fitter, Judge, Target};
use scoring::Scoring;
use std::path::Path;
use std::time::Instant;
use tuned::Packed;
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

/// Compresses a model in memory, whose means count from `origin`: the record's files have no path, and no bytes. An aim is met by the
/// PLY file of the result.
///
/// # Errors
/// The errors of [`compress_to`], without those of files.
pub fn compress_in_memory(
    session: &Session<'_>,
    model: Gaussians,
    origin: [f64; 3],
    config: &CompressConfig,
    aim: Option<Aim>,
) -> Result<(CompressRecord, Gaussians), Error> {
    let nowhere = Path::new("");
    let input = Input { path: nowhere, model, read_s: 0.0 };
    let target = Target { path: nowhere, origin, ..Target::new(Path::new("model.ply")) };
    let Reduced { record, model, .. } = reduce(session, input, config, aim, &target)?;
    Ok((record, model))
}

/// Compresses a model and writes it to a file, whose extension decides the format. With an aim, the number of Gaussians and the
/// format's settings are those of the best file that meets it.
///
/// # Errors
/// Any error from reading views to writing the model; [`Error::Interrupted`], with no model written; with an aim, [`Error::Usage`] for a
/// size that even one Gaussian exceeds, or a selector other than pairs.
pub fn compress_to(
    session: &Session<'_>,
    input: Input<'_>,
    config: &CompressConfig,
    aim: Option<Aim>,
    target: &Target<'_>,
) -> Result<CompressRecord, Error> {
    let begun = Instant::now();
    let Reduced { mut record, model, packed } = reduce(session, input, config, aim, target)?;
    session.watcher.unless_stopped()?;
    let writing = Instant::now();
    target.write(packed, &model, config.style.mode())?;
    record.output = ModelFile::of(target.path, &model);
    record.time.write_s += seconds(writing);
    record.time.total_s = record.time.read_s + seconds(begun);
    Ok(record)
}

/// A compressed model that is not written yet.
struct Reduced {
    record: CompressRecord,
    model: Gaussians,
    /// The model in its format, if that rounds values or has a target size.
    packed: Option<Vec<u8>>,
}

/// Compresses a model for a file, without writing it.
fn reduce(
    session: &Session<'_>,
    input: Input<'_>,
    config: &CompressConfig,
    aim: Option<Aim>,
    target: &Target<'_>,
) -> Result<Reduced, Error> {
    let begun = Instant::now();
    if aim.is_some() && config.compression.selector != Selector::Pairs {
        let what = "--size and --psnr need --selector pairs, whose merges lead to every number of Gaussians";
        return Err(Error::Usage(what.to_owned()));
    }
    let Session { device, watcher, .. } = *session;
    let original = original::fitting(&input, config, aim, target);
    let Input { path, model, read_s } = input;
    let input = ModelFile::of(path, &model);
    let mut time = CompressTimes { read_s, ..CompressTimes::default() };

    let opening = Instant::now();
    let (views, shown) = Views::exposed(session, &model, config)?;
    time.truth_s = seconds(opening);
    let mut scoring = Scoring::new(session, &views, config);
    let before = if views.truth == Truth::Photos { scoring.scores(shown.source())? } else { Vec::new() };

    let responding = Instant::now();
    let responses = train::respond(session, shown.source(), model.degree(), &views, None, config)?;
    time.responses_s = seconds(responding);

    // Pictures decide how finely a model is worth storing.
    let by_held_out = !matches!(aim, Some(Aim::Bytes(_)));
    let judged = original.is_none() && (aim.is_some() || target.ladder(&model).steps.len() > 1);
    let judge = judged.then(|| Judge::new(session, &views, shown.source(), by_held_out)).transpose()?;
    let file = (aim.zip(judge.as_ref()), original);
    let (plan, fitted) = choose((device, shown.source()), &model, &responses, file, config, target)?;
    drop((shown, responses));
    watcher.unless_stopped()?;
    watcher.pruned(&model, config.style.mode(), &plan.diagnostics)?;
    let (mut prune, mut model) = plan.apply(model);
    if let Some((_, record)) = &fitted {
        fit::up_to(&mut model, record.precision);
    }
    (time.merge_s, time.keep_mask_s) = (prune.seconds.merge, prune.seconds.total - prune.seconds.merge);
    prune.seconds.add_responses(time.responses_s);
    let after = scoring.scores_of(&model)?;

    let tuning = Instant::now();
    let (mut tuned, mut untuned) = (Vec::new(), None);
    if config.fine_tune > 0 {
        let trained = train::fine_tune(session, &model, &views, config)?;
        untuned = Some(std::mem::replace(&mut model, trained)).filter(|_| fitted.is_some());
        time.fine_tune_s = seconds(tuning);
        tuned = scoring.scores_of(&model)?;
    }
    watcher.unless_stopped()?;
    let writing = Instant::now();
    let unpacked = if tuned.is_empty() { &after } else { &tuned };
    let (packed, written, aim) = match (fitted, untuned, judge.as_ref()) {
        (Some((bytes, mut record)), Some(before), Some(judge)) => {
            let scores = of_file(&mut scoring, Some(&bytes), target, &after)?;
            let before = Packed { model: before, bytes, scores };
            let to = (target, config.style.mode());
            let file = tuned::better(&mut scoring, judge, before, model, &mut record, to)?;
            model = file.model;
            (Some(file.bytes), file.scores, Some(record))
        }
        (fitted, _, judge) => pack(&mut scoring, judge, (&model, config), fitted, target, unpacked)?,
    };
    time.evaluate_s = scoring.seconds;
    time.write_s = seconds(writing);
    time.total_s = read_s + seconds(begun);
    let stages = views.stages([before, after, tuned, written]);
    let record = CompressRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.tuned(),
        protocol: views.protocol(config),
        input,
        output: ModelFile::of(target.path, &model),
        clipped: formats::clipped(target.path, &model),
        outsized: formats::outsized(target.path, &model),
        prune,
        aim,
        test: StageScores::mean(&stages),
        views: stages,
        time,
        memory: session.memory(views.estimated_bytes),
    };
    Ok(Reduced { record, model, packed })
}

/// A packed model, and the record of its choice.
type Recorded = (Vec<u8>, AimRecord);

/// Chooses the Gaussians: all of them for the original's own file; those of the best file that meets an aim, which is
/// returned, too; or else as the configuration says.
fn choose(
    (device, source): (&Device, Source<'_>),
    model: &Gaussians,
    responses: &Responses,
    (aim, original): (Option<(Aim, &Judge<'_>)>, Option<Recorded>),
    config: &CompressConfig,
    target: &Target<'_>,
) -> Result<(PrunePlan, Option<Recorded>), Error> {
    if let (Some((aim, judge)), None) = (aim, &original) {
        let Fitted { plan, packed, record } = Fitter::new(judge, model, responses, config).fit(aim, target)?;
        return Ok((plan, Some((packed, record))));
    }
    let keep = if original.is_some() { Keep::Count(model.len()) } else { config.compression.keep };
    let request = PruneRequest { compression: &config.compression, keep, seed: config.seed };
    Ok((prune::plan(device, source, model, responses, &request)?, original))
}

/// The bytes of a file in a format that is packed, its scores, and the search that found it.
type PackedFile = (Option<Vec<u8>>, Vec<Scores>, Option<AimRecord>);

/// Packs a model whose pictures have the scores `unpacked`, unless a search has packed it.
fn pack(
    scoring: &mut Scoring<'_>,
    judge: Option<&Judge<'_>>,
    (model, config): (&Gaussians, &CompressConfig),
    fitted: Option<Recorded>,
    target: &Target<'_>,
    unpacked: &[Scores],
) -> Result<PackedFile, Error> {
    let (mut packed, aim) = fitted.unzip();
    if packed.is_none() {
        let psnr = metrics::mean(unpacked).and_then(|scores| scores.psnr);
        packed = fit::packed(judge, model, config, psnr, target)?;
    }
    let written = of_file(scoring, packed.as_deref(), target, unpacked)?;
    Ok((packed, written, aim))
}

/// Scores of a packed model; `unpacked` if its format stores floats.
fn of_file(
    scoring: &mut Scoring<'_>,
    packed: Option<&[u8]>,
    target: &Target<'_>,
    unpacked: &[Scores],
) -> Result<Vec<Scores>, Error> {
    match packed.filter(|_| !formats::is_exact(target.format)) {
        Some(packed) => {
            let model = formats::read_bytes(packed, target.format).map_err(Error::writing)?.gaussians;
            scoring.scores_of(&model)
        }
        None => Ok(unpacked.to_vec()),
    }
}

fn seconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64()
}
