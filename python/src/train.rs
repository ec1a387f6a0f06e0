//! Training.

use crate::arrays::{dictionary, json};
use crate::device::{Device, or_usual};
use crate::errors::{file, raised, some_file, wrong};
use crate::fork::detached;
use crate::model::{Model, warn_of};
use crate::of_run::OfRun;
use crate::options::{configuration, from_model};
use crate::watch::{Callbacks, followed};
use engine::gaussians::formats::{self, RenderMode};
use engine::job::earlier::{self, Earlier};
use engine::job::{Error, Init, Output, RunConfig, Session};
use engine::metrics::Networks;
use engine::pipeline::run;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A finished run, made by train. It cannot be pickled: send its model, record and log.
#[pyclass(frozen, weakref, module = "qirf_vk")]
pub struct Run {
    /// The trained, pruned model.
    #[pyo3(get)]
    model: Py<Model>,
    /// The contents of metrics.json (docs/metrics.md).
    #[pyo3(get)]
    record: Py<PyAny>,
    /// The lines of log.jsonl (docs/metrics.md).
    #[pyo3(get)]
    log: Py<PyAny>,
    /// The folder of its files; None if it was temporary.
    #[pyo3(get)]
    folder: Option<PathBuf>,
}

#[pymethods]
impl Run {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let psnr = self.record.bind(py).get_item("test")?.get_item("psnr").and_then(|psnr| psnr.extract::<f64>());
        let psnr = psnr.map_or_else(|_| String::new(), |psnr| format!(", PSNR {psnr:.2} dB"));
        let folder = self.folder.as_ref().map_or_else(String::new, |folder| format!(", in {}", folder.display()));
        Ok(format!("Run({}{psnr}{folder})", self.model.bind(py).repr()?))
    }
}

/// The initial model of a run, if it is no file.
fn initial(options: &Bound<'_, PyDict>) -> PyResult<Option<Py<Model>>> {
    let Some(init) = options.get_item("init")? else { return Ok(None) };
    let Ok(model) = init.cast::<Model>() else { return Ok(None) };
    options.del_item("init")?;
    Ok(Some(model.clone().unbind()))
}

/// Writes the initial model into the run's folder; refuses another one than the run began with.
fn store(path: &Path, model: &Model, folder: &Path, resumed: bool) -> Result<(), Error> {
    if resumed && path.exists() {
        if formats::read(path)?.gaussians == *model.inner {
            return Ok(());
        }
        let changes = vec!["init was another model".to_owned()];
        return Err(Error::OtherRun { folder: folder.to_owned(), changes });
    }
    let bytes = model.ply()?;
    formats::write_atomically(path, |out| out.write_all(&bytes)).map_err(Error::writing)
}

/// The results of a run.
struct Left {
    record: String,
    model: Model,
    log: String,
}

/// The file of an initial model that came from memory.
fn initial_file(folder: &Path) -> PathBuf {
    folder.join("initial.ply")
}

/// Runs a job in its folder, or resumes it; `initial` is the initial model, if it is no file.
fn job(
    session: &Session<'_>,
    config: &RunConfig,
    folder: &Path,
    [resume, overwrite]: [bool; 2],
    initial: Option<&Model>,
) -> Result<Left, Error> {
    let output = Output::for_run(folder, &config.init)?;
    let found = Earlier::of(&output);
    if !resume && found == Earlier::Interrupted {
        return Err(Error::Unfinished(output.checkpoint()));
    }
    if !resume && !overwrite && found == Earlier::Finished {
        return Err(Error::Finished(folder.to_owned()));
    }
    let resumed = resume && found != Earlier::Nothing;
    if resumed {
        earlier::check(&output, config)?;
    }
    if let Some(model) = initial {
        store(&initial_file(folder), model, folder, resumed)?;
    }
    if !(resume && found == Earlier::Finished) {
        run::run(session, config, &output, resume)?;
        output.complete();
    }
    let text = |path: PathBuf| std::fs::read_to_string(&path).map_err(|source| Error::Read { path, source });
    Ok(Left {
        record: text(output.metrics())?,
        model: Model::of_file(formats::read(&output.model())?, OfRun::beside(&output.model())?),
        log: text(output.log())?,
    })
}

/// Trains a scene with poses, prunes it, and scores it, as `qirf-vk run` does, with the same bytes.
///
/// scene: a folder with COLMAP's, Blender's, instant-ngp's or nerfstudio's cameras and photos. preset: "standard", "quick" or "paper".
/// output: the folder of the run's files; a temporary folder by default. resume: continue from the checkpoint of an interrupted run there. overwrite:
/// replace a finished run there. The folder of a comparison or of another run's pictures is refused, and so is one with a
/// model that is no run's, unless it is the initial one.
///
/// on_step gets a line of log.jsonl as a dictionary: iteration, iterations, seconds, loss (or None), gaussians, psnr if it was measured,
/// rates, device_bytes. on_progress gets the stage, the steps done and their total, which never fall within a stage. Both are called in the
/// thread that called train. An exception in a callback ends the run.
///
/// options: every key of config.toml, such as seed, resolution (640 pixels wide, or "/2"), images, eval_every, sh_degree, max_gaussians,
/// checkpoint_every, background, clean; tables are dicts. train(**tomllib.load(file)) repeats the run whose config.toml that is; its paths
/// within the run's folder are relative to it. In a dict as schedule or prune, keys that are left out have the preset's values, and None
/// removes one. Short forms: iterations; keep (a share) or count of Gaussians; prune=False; schedule="attrition", "one-shot" or "gradual",
/// the schedule of the prune; effects=["exposure=on"] or {"exposure": "on"}; init="random", the path of a model, or a Model, which is written
/// to the folder as initial.ply, without its bands above a given sh_degree. Unknown keywords are TypeErrors.
#[pyfunction]
#[pyo3(signature = (scene, preset="standard", *, output=None, device=None, resume=false, overwrite=false, on_step=None, on_progress=None, **options))]
pub fn train(
    py: Python<'_>,
    #[pyo3(from_py_with = file)] scene: PathBuf,
    preset: &str,
    #[pyo3(from_py_with = some_file)] output: Option<PathBuf>,
    device: Option<&Bound<'_, Device>>,
    resume: bool,
    overwrite: bool,
    on_step: Option<Py<PyAny>>,
    on_progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Run> {
    if output.as_ref().is_some_and(|folder| folder.as_os_str().is_empty()) {
        return Err(wrong("output is an empty path: name a folder, or leave it out"));
    }
    if resume && overwrite {
        return Err(wrong("resume=True and overwrite=True contradict each other: leave out one"));
    }
    if resume && output.is_none() {
        return Err(wrong("resume=True continues from a checkpoint: name the run's folder as output"));
    }
    let options = options.map_or_else(|| Ok(PyDict::new(py)), Bound::copy)?;
    let model = initial(&options)?;
    let options = json(&options)?;
    let asked = options.contains_key("antialias") || options.get("effects").is_some_and(names_antialias);
    let mut config = configuration(py, scene, preset, options)?;
    let temporary = tempfile::tempdir()?;
    let folder = output.clone().unwrap_or_else(|| temporary.path().to_owned());
    if let Some((path, mode)) = beginning(py, &config, &folder, model.as_ref())? {
        config = from_model(config, &path, mode, asked);
    }
    let device = or_usual(py, device)?;
    let initial = model.as_ref().map(Py::get);
    let left = followed(py, Callbacks { on_step, on_progress }, |watcher| {
        let networks = Networks::find(None)?;
        job(&Session { watcher, ..Session::new(&device, &networks) }, &config, &folder, [resume, overwrite], initial)
    })?;
    let json = |text: &str| serde_json::from_str::<Value>(text).map_err(|e| wrong(e.to_string()));
    let log = left.log.lines().map(json).collect::<PyResult<Vec<Value>>>()?;
    Ok(Run {
        model: Py::new(py, left.model)?,
        record: dictionary(py, &json(&left.record)?)?.unbind(),
        log: dictionary(py, &log)?.unbind(),
        folder: output,
    })
}

/// True if `effects`, as a list, a text or a table, names anti-aliasing.
fn names_antialias(effects: &Value) -> bool {
    match effects {
        Value::String(text) => text.trim_start().starts_with("antialias"),
        Value::Array(list) => list.iter().any(names_antialias),
        Value::Object(table) => table.contains_key("antialias"),
        _ => false,
    }
}

/// The file that a run begins with, and its mode, if it begins with a model.
fn beginning(
    py: Python<'_>,
    config: &RunConfig,
    folder: &Path,
    model: Option<&Py<Model>>,
) -> PyResult<Option<(PathBuf, RenderMode)>> {
    if let Some(model) = model.map(Py::get) {
        if model.inner.is_empty() {
            return Err(wrong("init: the model has no Gaussian"));
        }
        return Ok(Some((initial_file(folder), model.mode)));
    }
    let Init::Model(path) = &config.init else { return Ok(None) };
    // A config.toml names the model that lies beside it without their folder.
    let beside = folder.join(path);
    let path = if path.exists() || !beside.is_file() { path.clone() } else { beside };
    let loaded = detached(py, || formats::read(&path))?.map_err(|e| raised(Error::from(e)))?;
    warn_of(py, &loaded, &path)?;
    Ok(Some((path, loaded.mode)))
}
