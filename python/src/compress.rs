//! Compression.

use crate::arrays::{Resolution, dictionary};
use crate::device::{Device, or_usual};
use crate::errors::{
    self, colour, number, raised, share, some_bytes, some_file, some_keep, some_picture_size, some_whole, warn, whole,
    wrong,
};
use crate::model::{Model, in_memory};
use crate::options::read;
use crate::photos::Photos;
use crate::watch::{Callbacks, followed, log};
use crate::words::in_python;
use engine::gaussians::formats;
use engine::job::config::PruneRule;
use engine::job::earlier::spare_model;
use engine::job::output::check_file;
use engine::job::records::Aim;
use engine::job::{Error, Session};
use engine::metrics::Networks;
use engine::pipeline::compress::fit::Target;
use engine::pipeline::compress::remarks::{Remark, remarks};
use engine::pipeline::compress::{self as engine_compress, CompressConfig, Input, ViewSource};
use engine::pipeline::virtual_views::VirtualCameras;
use engine::qirf::select::Selector;
use engine::qirf::select::budget::Keep;
use pyo3::prelude::*;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Removes redundant Gaussians. Returns the smaller model and the record of `qirf-vk compress --json`.
///
/// keep: the share to keep, 0.28 by default; or count: the number of Gaussians to keep; or size: the maximum size in bytes or as a text
/// such as "5MB" or "1165B", with the highest PSNR; or psnr: the minimum PSNR in dB, with the smallest file, and a UserWarning if none
/// reaches it. The last two are of `output`, a file name as for Model.save, which is written and read for the returned model; without one,
/// of the .ply that the returned model makes. An output that cannot be written is refused before any work.
///
/// The result is compared with `views` pictures of the model itself, of picture_size (width, height), or with the photos of `scene`: those
/// in its folder images, at a resolution such as 640 (pixels wide) or "/2", of which every eval_every-th is held out (8 by default).
/// background, antialias, dilation, depth_order and exposure: as in evaluate; without a scene the background is black unless given. selector:
/// the rule that ranks Gaussians (docs/method.md), "pairs" by default; the others also read budget ("per-block", "hybrid" or "global"),
/// detail (the share reserved for small detail) and merge (False drops Gaussians without merging them). fine_tune: iterations of training
/// afterwards, left out if they make a file of a given size or psnr worse (record["aim"]["fine_tuning"]).
///
/// record["test"] has mean scores of held-out views: "pruned" and "written" (the file), with photos also "before", after tuning
/// "fine_tuned"; each has psnr in dB, None where pictures are equal, and ssim. record["input"] and record["output"] have the bytes of the
/// model's .ply where the model is in memory, and None as its path.
#[pyfunction]
#[pyo3(signature = (model, keep=None, *, count=None, size=None, psnr=None, output=None, scene=None, images=None, resolution=None,
    eval_every=None, background=None, antialias=None, dilation=None, depth_order=None, exposure=None, selector=None, budget=None,
    detail=None, merge=None, fine_tune=0, views=None, picture_size=None, seed=1, device=None, on_progress=None))]
pub fn compress<'py>(
    py: Python<'py>,
    model: &Bound<'py, Model>,
    #[pyo3(from_py_with = some_keep)] keep: Option<f64>,
    #[pyo3(from_py_with = some_whole)] count: Option<i64>,
    #[pyo3(from_py_with = some_bytes)] size: Option<u64>,
    psnr: Option<f64>,
    #[pyo3(from_py_with = some_file)] output: Option<PathBuf>,
    #[pyo3(from_py_with = some_file)] scene: Option<PathBuf>,
    #[pyo3(from_py_with = some_file)] images: Option<PathBuf>,
    resolution: Option<Resolution>,
    #[pyo3(from_py_with = some_whole)] eval_every: Option<i64>,
    background: Option<[f32; 3]>,
    antialias: Option<bool>,
    dilation: Option<f32>,
    depth_order: Option<bool>,
    exposure: Option<bool>,
    selector: Option<&str>,
    budget: Option<&str>,
    detail: Option<f64>,
    merge: Option<bool>,
    #[pyo3(from_py_with = whole)] fine_tune: i64,
    #[pyo3(from_py_with = some_whole)] views: Option<i64>,
    #[pyo3(from_py_with = some_picture_size)] picture_size: Option<(u32, u32)>,
    #[pyo3(from_py_with = whole)] seed: i64,
    device: Option<&Bound<'py, Device>>,
    on_progress: Option<Py<PyAny>>,
) -> PyResult<(Model, Bound<'py, PyAny>)> {
    let model = model.get();
    if model.inner.is_empty() {
        return Err(wrong("the model has no Gaussian"));
    }
    let (fine_tune, seed) = (number("fine_tune", fine_tune, 0)?, number("seed", seed, 0)?);
    let mut config = CompressConfig { fine_tune, seed, ..CompressConfig::default() };
    config.compression = rule(CompressConfig::rule(fine_tune), [selector, budget], detail, merge)?;
    if [keep.is_some(), count.is_some(), size.is_some(), psnr.is_some()].iter().filter(|given| **given).count() > 1 {
        return Err(wrong("keep, count, size and psnr ask for different models; give one of them"));
    }
    if let Some(keep) = keep {
        config.compression.keep = Keep::Share(share(keep)?);
    }
    if let Some(count) = count {
        config.compression.keep = Keep::Count(number("count", count, 1)?);
    }
    if let Some(note) = config.compression.detail_note(config.compression.keep, model.inner.len()) {
        log(py, "info", &in_python(&note))?;
    }
    if let Some(psnr) = psnr.filter(|psnr| !(5.0..=100.0).contains(psnr)) {
        return Err(wrong(format!("psnr={psnr}: give one from 5 to 100 dB")));
    }
    let views = views.map(|count| errors::views("views", count, 2)).transpose()?;
    if scene.is_some() && (views.is_some() || picture_size.is_some()) {
        return Err(wrong("views and picture_size are of the model's own pictures, which a scene's photos replace"));
    }
    if scene.is_none() && exposure == Some(true) {
        return Err(wrong("exposures are fitted to a scene's photos: leave out exposure"));
    }
    config.style = model.style_of_run(py, antialias, dilation, depth_order)?;
    config.exposure = scene.is_some() && model.exposure(py, exposure)?;
    let eval_every = eval_every.map(|every| number("eval_every", every, 0)).transpose()?;
    let background = background.map(colour).transpose()?;
    let place = scene.clone().map(|scene| (scene, images.clone()));
    let of_photos = background.or(model.run.background);
    let photos = Photos { scene, images, resolution, eval_every, background: of_photos }.selection()?;
    let usual = VirtualCameras::default();
    let cameras =
        VirtualCameras { views: views.unwrap_or(usual.views), size: picture_size.unwrap_or(usual.size), ..usual };
    let own = ViewSource::OwnPictures { cameras, background: background.unwrap_or_default() };
    config.views = photos.map_or(own, ViewSource::Photos);
    let aim = size.map(Aim::Bytes).or(psnr.map(Aim::Psnr));
    if let Some(output) = &output {
        check_place(output).map_err(raised)?;
    }
    let device = or_usual(py, device)?;
    let (smaller, mut record, warnings) = followed(py, Callbacks { on_step: None, on_progress }, |watcher| {
        let networks = Networks::default();
        let session = Session { watcher, ..Session::new(&device, &networks) };
        compressed(&session, model, (&config, aim), (place.as_ref(), output.as_deref()))
    })?;
    in_memory(&mut record["input"]);
    if output.is_none() {
        in_memory(&mut record["output"]);
    }
    for line in warnings {
        warn(py, &line)?;
    }
    Ok((smaller, dictionary(py, &record)?))
}

/// The choice of Gaussians with these arguments in place of the usual ones.
fn rule(
    mut rule: PruneRule,
    [selector, budget]: [Option<&str>; 2],
    detail: Option<f64>,
    merge: Option<bool>,
) -> PyResult<PruneRule> {
    if let Some(selector) = selector {
        rule.selector = read("selector", &selector.into())?;
    }
    if let Some(budget) = budget {
        rule.budget = read("budget", &budget.into())?;
    }
    if let Some(detail) = detail.filter(|detail| !(0.0..=1.0).contains(detail)) {
        return Err(wrong(format!("detail={detail}: give a share from 0 to 1")));
    }
    rule.detail = detail.unwrap_or(rule.detail);
    rule.merge = merge.unwrap_or(rule.merge);
    let given = [("budget", budget.is_some()), ("detail", detail.is_some()), ("merge", merge.is_some())];
    match given.iter().find(|(_, given)| *given && rule.selector == Selector::Pairs) {
        Some((name, _)) => Err(wrong(format!(
            "the selector pairs merges over the whole model and does not read {name}; choose another selector, such as \
             selector=\"css\""
        ))),
        None => Ok(rule),
    }
}

/// Refuses an output that cannot be written, or that would replace the model of a run, before any work.
fn check_place(output: &Path) -> Result<(), Error> {
    spare_model(output)?;
    formats::check_output(output).map_err(Error::writing)?;
    check_file(output)
}

/// The smaller model, its record, and the lines to warn of.
fn compressed(
    session: &Session<'_>,
    model: &Model,
    (config, aim): (&CompressConfig, Option<Aim>),
    (place, output): (Option<&(PathBuf, Option<PathBuf>)>, Option<&Path>),
) -> Result<(Model, Value, Vec<String>), Error> {
    let place = place.map(|(scene, images)| (scene.as_path(), images.as_deref()));
    let (input, origin, doubt) = model.placed(place)?;
    let smaller = |gaussians| Model { origin, mode: config.style.mode(), ..model.like(gaussians) };
    let (record, smaller) = if let Some(output) = output {
        let input = Input { path: Path::new(""), model: input, read_s: 0.0 };
        let target = Target { origin, ..Target::new(output) };
        let record = engine_compress::compress_to(session, input, config, aim, &target)?;
        (record, smaller(formats::read(output)?.gaussians))
    } else {
        let (mut record, gaussians) = engine_compress::compress_in_memory(session, input, origin, config, aim)?;
        let smaller = smaller(gaussians);
        record.output.bytes = smaller.ply_bytes()?;
        (record, smaller)
    };
    let mut warnings: Vec<String> = doubt.into_iter().collect();
    for remark in remarks(&record) {
        match remark {
            Remark::Note(line) => session.watcher.note(&line),
            Remark::Warning(line) => warnings.push(line),
        }
    }
    let mut record = serde_json::to_value(&record).map_err(|e| Error::Usage(e.to_string()))?;
    record["input"]["bytes"] = model.ply_bytes()?.into();
    Ok((smaller, record, warnings))
}
