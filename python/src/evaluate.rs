//! Scores.

use crate::arrays::{Resolution, dictionary};
use crate::device::{Device, or_usual};
use crate::errors::{colour, number, some_file, some_whole, warn, wrong};
use crate::model::Model;
use crate::photos::Photos;
use crate::watch::{Callbacks, followed};
use engine::gaussians::Gaussians;
use engine::job::{Error, Selection, Session};
use engine::metrics::Networks;
use engine::pipeline::eval::{self, Evaluation};
use engine::pipeline::place::align;
use engine::render::Style;
use pyo3::prelude::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Scores a model against a scene's held-out photos, or against another model's pictures: the record of `qirf-vk eval --json`.
///
/// images: the folder of the scene's photos, such as "images_4"; resolution: their size, such as 640 (pixels wide) or "/2". eval_every:
/// every eval_every-th photo is held out, 8 by default. background: red, green and blue in [0, 1]. antialias, dilation and depth_order:
/// as in Renderer, of both models where there are two; a UserWarning tells of models that are drawn differently. exposure: score with
/// exposures fitted to the photos, as runs with that effect do. With a scene these are by default as in the model's run (see Model).
///
/// The record's "test" has the means, "views" the scores of each view: psnr in dB, None where pictures are equal, ssim, and lpips_vgg,
/// lpips_vgg_normalized and lpips_alex, which are None without weights ($QIRF_LPIPS: a file or folder made by tools/lpips-weights).
/// "ply_bytes" are those of the .ply that the model makes; the record against another model has "schema", "gaussians" with the numbers of
/// "model" and "original", "test" and "views".
#[pyfunction]
#[pyo3(signature = (model, scene=None, *, against=None, images=None, resolution=None, eval_every=None, background=None, antialias=None,
    dilation=None, depth_order=None, exposure=None, device=None, on_progress=None))]
pub fn evaluate<'py>(
    py: Python<'py>,
    model: &Bound<'py, Model>,
    #[pyo3(from_py_with = some_file)] scene: Option<PathBuf>,
    against: Option<&Bound<'py, Model>>,
    #[pyo3(from_py_with = some_file)] images: Option<PathBuf>,
    resolution: Option<Resolution>,
    #[pyo3(from_py_with = some_whole)] eval_every: Option<i64>,
    background: Option<[f32; 3]>,
    antialias: Option<bool>,
    dilation: Option<f32>,
    depth_order: Option<bool>,
    exposure: Option<bool>,
    device: Option<&Bound<'py, Device>>,
    on_progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let model = model.get();
    let original = match against.map(Bound::get) {
        Some(original) => Some((original, original.style(antialias, dilation, depth_order)?)),
        None => None,
    };
    let background = background.map(colour).transpose()?;
    if original.is_some() && exposure == Some(true) {
        return Err(wrong("exposures are fitted to a scene's photos: leave out exposure"));
    }
    if original.is_some() && scene.is_some() {
        return Err(wrong("scene and against are two ways to score; give one of them"));
    }
    if original.is_none() && scene.is_none() {
        return Err(wrong("give a scene, or another model as against"));
    }
    let eval_every = eval_every.map(|every| number("eval_every", every, 1)).transpose()?;
    // Two models are compared as their tags say.
    let (style, exposure) = if original.is_some() {
        (model.style(antialias, dilation, depth_order)?, false)
    } else {
        (model.style_of_run(py, antialias, dilation, depth_order)?, model.exposure(py, exposure)?)
    };
    let of_photos = background.or(model.run.background);
    let photos = Photos { scene, images, resolution, eval_every, background: of_photos }.selection()?;
    if let Some((_, other)) = original.filter(|(_, other)| *other != style) {
        let (a, b) = (style.mode(), other.mode());
        let remedy = "antialias=True or antialias=False draws both alike";
        warn(py, &format!("this model is {a} and the original {b}, and they are drawn so; {remedy}"))?;
    }
    let device = or_usual(py, device)?;
    let (record, doubt) = followed(py, Callbacks { on_step: None, on_progress }, |watcher| {
        let networks = Networks::find(None)?;
        let session = Session { watcher, ..Session::new(&device, &networks) };
        match (photos, original) {
            (Some(selection), _) => by_photos(&session, model, Evaluation { selection, style, exposure }),
            (None, Some(original)) => by_original(&session, (model, style), original, background.unwrap_or_default())
                .map(|record| (record, None)),
            (None, None) => Err(Error::Usage("there is nothing to score against".to_owned())),
        }
    })?;
    if let Some(doubt) = doubt {
        warn(py, &doubt)?;
    }
    dictionary(py, &record)
}

/// The record, and a warning about the model's place.
fn by_photos(session: &Session<'_>, model: &Model, evaluation: Evaluation) -> Result<(Value, Option<String>), Error> {
    let Selection { scene, images, .. } = &evaluation.selection;
    let (placed, _, doubt) = model.placed(Some((scene, images.as_deref())))?;
    let mut record = eval::eval(session, Path::new(""), &placed, &evaluation, None)?;
    record.model_bytes = model.ply_bytes()?;
    let record = serde_json::to_value(&record).map_err(|e| Error::Usage(e.to_string()))?;
    Ok((record, doubt))
}

/// The record of a model by the pictures of another.
fn by_original(
    session: &Session<'_>,
    (model, style): (&Model, Style),
    (original, original_style): (&Model, Style),
    background: [f32; 3],
) -> Result<Value, Error> {
    let mut moved = Gaussians::clone(&model.inner);
    align(&mut moved, [model.origin, original.origin], &original.inner);
    let held_out = eval::against(session, [(&moved, style), (&original.inner, original_style)], background)?;
    let gaussians = json!({ "model": model.inner.len(), "original": original.inner.len() });
    Ok(json!({ "schema": 1, "gaussians": gaussians, "test": held_out.mean(), "views": held_out.views }))
}
