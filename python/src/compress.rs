//! Compression.

use crate::arrays::{Resolution, dictionary};
use crate::device::{Device, or_usual};
use crate::errors::{self, number, share, some_picture_size, some_whole, whole, wrong};
use crate::model::Model;
use crate::watch::Follower;
use engine::gaussians::formats;
use engine::job::records::Aim;
use engine::job::{Error, Preset, RunConfig, Session};
use engine::metrics::Networks;
use engine::pipeline::compress::fit::Target;
use engine::pipeline::compress::{self as engine_compress, CompressConfig, Input, ViewSource};
use engine::pipeline::virtual_views::VirtualCameras;
use engine::qirf::select::budget::Keep;
use engine::render::Style;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Removes redundant Gaussians. Returns the smaller model and the record of `qirf-vk compress --json`.
///
/// keep: the share to keep, 0.28 by default; or count: the number of Gaussians to keep; or size: the maximum size in bytes, with the highest
/// PSNR; or psnr: the minimum PSNR in dB, with the smallest file. The last two are of `output`, a file name as for Model.save, which is
/// written and read for the returned model; without one, of the .ply that the returned model makes.
///
/// The result is compared with `views` pictures of the model itself, of picture_size (width, height), or with the photos of `scene`, at a
/// resolution such as 640 (pixels wide) or "/2". selector: the rule that ranks Gaussians (docs/method.md); fine_tune: iterations of training
/// afterwards. record["test"] has mean scores of held-out views: "pruned" and "written" (the file), with photos also "before", after tuning
/// "fine_tuned"; each has psnr in dB and ssim.
#[pyfunction]
#[pyo3(signature = (model, keep=None, *, count=None, size=None, psnr=None, output=None, scene=None, resolution=None,
    selector=None, fine_tune=0, views=None, picture_size=None, seed=1, device=None, on_progress=None))]
pub fn compress<'py>(
    py: Python<'py>,
    model: &Bound<'py, Model>,
    keep: Option<f64>,
    #[pyo3(from_py_with = some_whole)] count: Option<i64>,
    #[pyo3(from_py_with = some_whole)] size: Option<i64>,
    psnr: Option<f64>,
    output: Option<PathBuf>,
    scene: Option<PathBuf>,
    resolution: Option<Resolution>,
    selector: Option<&str>,
    #[pyo3(from_py_with = whole)] fine_tune: i64,
    #[pyo3(from_py_with = some_whole)] views: Option<i64>,
    #[pyo3(from_py_with = some_picture_size)] picture_size: Option<(u32, u32)>,
    #[pyo3(from_py_with = whole)] seed: i64,
    device: Option<&Bound<'py, Device>>,
    on_progress: Option<Py<PyAny>>,
) -> PyResult<(Model, Bound<'py, PyAny>)> {
    let model = model.get();
    let (fine_tune, seed) = (number("fine_tune", fine_tune, 0)?, number("seed", seed, 0)?);
    let mut config = CompressConfig { style: Style::of(model.mode), fine_tune, seed, ..CompressConfig::default() };
    config.compression = CompressConfig::rule(fine_tune);
    if let Some(selector) = selector {
        config.compression.selector =
            serde_json::from_value(selector.into()).map_err(|e| wrong(format!("selector: {e}")))?;
    }
    if [keep.is_some(), count.is_some(), size.is_some(), psnr.is_some()].iter().filter(|given| **given).count() > 1 {
        return Err(wrong("keep, count, size and psnr ask for different models; give one of them"));
    }
    if let Some(keep) = keep {
        config.compression.keep = Keep::Share(share(keep)?);
    }
    if let Some(count) = count {
        config.compression.keep = Keep::Count(number("count", count, 1)?);
    }
    let size: Option<u64> = size.map(|size| number("size", size, 1)).transpose()?;
    let views: Option<u32> = views.map(|count| errors::views("views", count, 2)).transpose()?;
    let usual = VirtualCameras::default();
    let cameras =
        VirtualCameras { views: views.unwrap_or(usual.views), size: picture_size.unwrap_or(usual.size), ..usual };
    if let Some(psnr) = psnr.filter(|psnr| !(5.0..=100.0).contains(psnr)) {
        return Err(wrong(format!("psnr={psnr}: give one from 5 to 100 dB")));
    }
    config.views = match &scene {
        Some(_) if views.is_some() || picture_size.is_some() => {
            return Err(wrong(
                "views and picture_size are of the model's own pictures, which a scene's photos replace",
            ));
        }
        Some(scene) => {
            let resolution = resolution.map(|r| r.0);
            ViewSource::Photos(RunConfig { resolution, ..RunConfig::of(scene.clone(), Preset::default()) }.selection())
        }
        None if resolution.is_some() => {
            return Err(wrong("resolution is that of a scene's photos; without a scene, picture_size"));
        }
        None => ViewSource::OwnPictures { cameras, background: [0.0; 3] },
    };
    let aim = size.map(Aim::Bytes).or(psnr.map(Aim::Psnr));
    let device = or_usual(py, device)?;
    let follower = Follower::new(None, on_progress);
    let done = py.detach(|| -> Result<_, Error> {
        let networks = Networks::default();
        let session = Session { watcher: &follower, ..Session::new(&device, &networks) };
        let (input, origin) = model.placed(scene.as_deref())?;
        let Some(output) = &output else {
            let (record, smaller) = engine_compress::compress_in_memory(&session, input, (&config, aim))?;
            return Ok((record, Model { origin, ..model.like(smaller) }));
        };
        formats::check_output(output).map_err(Error::writing)?;
        let input = Input { path: Path::new(""), model: input, read_s: 0.0 };
        let target = Target { origin, ..Target::new(output) };
        let record = engine_compress::compress_to(&session, input, (&config, aim), &target)?;
        Ok((record, Model { origin, ..model.like(formats::read(output)?.gaussians) }))
    });
    let (record, smaller) = follower.result(done)?;
    Ok((smaller, dictionary(py, &record)?))
}
