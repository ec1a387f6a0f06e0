//! Compression.

use crate::arrays::dictionary;
use crate::device::{Device, or_usual};
use crate::errors::wrong;
use crate::model::Model;
use crate::watch::Follower;
use engine::gaussians::formats;
use engine::metrics::Networks;
use engine::pipeline::compress::aim::Aim;
use engine::pipeline::compress::fit::Target;
use engine::pipeline::compress::{self as engine_compress, CompressConfig, Input, ViewSource};
use engine::pipeline::virtual_views::VirtualCameras;
use engine::pipeline::{Error, RunConfig, Session};
use engine::qirf::select::budget::Keep;
use engine::render::Style;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Prunes a model: keeps the Gaussians that its pictures, or a scene's photos, need. Returns the smaller model and the record.
#[pyfunction]
#[pyo3(signature = (model, keep=None, *, count=None, size=None, psnr=None, output=None, scene=None, resolution=None,
    selector=None, fine_tune=0, views=None, picture_size=None, seed=1, device=None, on_progress=None))]
pub fn compress<'py>(
    py: Python<'py>,
    model: &Bound<'py, Model>,
    keep: Option<f64>,
    count: Option<usize>,
    size: Option<u64>,
    psnr: Option<f64>,
    output: Option<PathBuf>,
    scene: Option<PathBuf>,
    resolution: Option<String>,
    selector: Option<&str>,
    fine_tune: u32,
    views: Option<u32>,
    picture_size: Option<(u32, u32)>,
    seed: u32,
    device: Option<&Bound<'py, Device>>,
    on_progress: Option<Py<PyAny>>,
) -> PyResult<(Model, Bound<'py, PyAny>)> {
    let model = model.get();
    let mut config = CompressConfig { style: Style::of(model.mode), fine_tune, seed, ..CompressConfig::default() };
    config.compression = CompressConfig::rule(fine_tune);
    if let Some(selector) = selector {
        config.compression.selector =
            serde_json::from_value(selector.into()).map_err(|e| wrong(format!("selector: {e}")))?;
    }
    if [keep.is_some(), count.is_some(), size.is_some(), psnr.is_some()].iter().filter(|given| **given).count() > 1 {
        return Err(wrong("keep, count, size and psnr ask for different models; give one of them"));
    }
    if let Some(share) = keep {
        if !(share > 0.0 && share <= 1.0) {
            return Err(wrong(format!("keep={share}: give a share above 0 and up to 1")));
        }
        config.compression.keep = Keep::Share(share);
    }
    if let Some(count) = count {
        config.compression.keep = Keep::Count(count.max(1));
    }
    let usual = VirtualCameras::default();
    let cameras =
        VirtualCameras { views: views.unwrap_or(usual.views), size: picture_size.unwrap_or(usual.size), ..usual };
    config.views = match &scene {
        Some(scene) => {
            ViewSource::Photos(RunConfig { resolution, ..RunConfig::of(scene.clone(), Default::default()) }.selection())
        }
        None if resolution.is_some() => {
            return Err(wrong("resolution is that of a scene's photos; without a scene, picture_size"));
        }
        None if cameras.views < 2 => return Err(wrong("views: give two or more")),
        None => ViewSource::OwnPictures { cameras, background: [0.0; 3] },
    };
    let aim = size.map(Aim::Bytes).or(psnr.map(Aim::Psnr));
    if aim.is_some() && output.is_none() {
        return Err(wrong("size and psnr are of a file: name it as output"));
    }
    let device = or_usual(py, device)?;
    let follower = Follower::new(None, on_progress);
    let done = py.detach(|| -> Result<_, Error> {
        let networks = Networks::default();
        let session = Session { watcher: &follower, ..Session::new(&device, &networks) };
        let (input, origin) = model.placed(scene.as_deref())?;
        let Some(output) = &output else {
            let (record, smaller) = engine_compress::compress_in_memory(&session, input, &config)?;
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
