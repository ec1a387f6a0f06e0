//! Scores.

use crate::arrays::{Resolution, dictionary};
use crate::device::{Device, or_usual};
use crate::errors::{colour, number, whole, wrong};
use crate::model::Model;
use crate::watch::Follower;
use engine::gaussians::Gaussians;
use engine::job::{Error, Preset, RunConfig, Session};
use engine::metrics::Networks;
use engine::pipeline::eval::{self, Evaluation};
use engine::pipeline::place::align;
use engine::render::Style;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Scores a model against a scene's held-out photos, or against another model's pictures: the record of `qirf-vk eval --json`.
///
/// resolution: of the photos, such as 640 (pixels wide) or "/2". eval_every: every eval_every-th photo is held out. background: red, green
/// and blue in [0, 1]. antialias, dilation and depth_order: as in Renderer; exposure: score with exposures fitted to the photos, as runs with
/// that effect do. The record's "test" has the means, "views" the scores of each view: psnr in dB, ssim, and, if weights are installed,
/// lpips_alex and the like.
#[pyfunction]
#[pyo3(signature = (model, scene=None, *, against=None, resolution=None, eval_every=8, background=None, antialias=None, dilation=None,
    depth_order=false, exposure=false, device=None, on_progress=None))]
pub fn evaluate<'py>(
    py: Python<'py>,
    model: &Bound<'py, Model>,
    scene: Option<PathBuf>,
    against: Option<&Bound<'py, Model>>,
    resolution: Option<Resolution>,
    #[pyo3(from_py_with = whole)] eval_every: i64,
    background: Option<[f32; 3]>,
    antialias: Option<bool>,
    dilation: Option<f32>,
    depth_order: bool,
    exposure: bool,
    device: Option<&Bound<'py, Device>>,
    on_progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (model, original) = (model.get(), against.map(Bound::get));
    let style = model.style(antialias, dilation, depth_order)?;
    let background = background.map(colour).transpose()?;
    if original.is_some() && resolution.is_some() {
        return Err(wrong("resolution is that of a scene's photos"));
    }
    if original.is_some() && exposure {
        return Err(wrong("exposures are fitted to a scene's photos"));
    }
    let device = or_usual(py, device)?;
    let follower = Follower::new(None, on_progress);
    let networks = Networks::find(None).map_err(|e| crate::errors::raised(Error::from(e)))?;
    let session = Session { watcher: &follower, ..Session::new(&device, &networks) };
    match (scene, original) {
        (Some(scene), None) => {
            let (resolution, eval_every) = (resolution.map(|r| r.0), number("eval_every", eval_every, 1)?);
            let usual = RunConfig::of(scene, Preset::default());
            let selection = RunConfig { resolution, eval_every, background, ..usual }.selection();
            let evaluation = Evaluation { selection, style, exposure };
            let record = py.detach(|| {
                let (model, _) = model.placed(Some(&evaluation.selection.scene))?;
                eval::eval(&session, Path::new(""), &model, &evaluation, None)
            });
            dictionary(py, &follower.result(record)?)
        }
        (None, Some(original)) => {
            let background = background.unwrap_or([0.0; 3]);
            let held_out = py.detach(|| {
                let mut moved = Gaussians::clone(&model.inner);
                align(&mut moved, [model.origin, original.origin], &original.inner);
                eval::against(&session, [(&moved, style), (&original.inner, Style::of(original.mode))], background)
            });
            let held_out = follower.result(held_out)?;
            let record = serde_json::json!({ "test": held_out.mean(), "views": held_out.views });
            dictionary(py, &record)
        }
        (Some(_), Some(_)) => Err(wrong("scene and against are two ways to score; give one of them")),
        (None, None) => Err(wrong("give a scene, or another model as against")),
    }
}
