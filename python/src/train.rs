//! Training.

use crate::arrays::{dictionary, json};
use crate::device::{Device, or_usual};
use crate::errors::{number, share, wrong};
use crate::model::Model;
use crate::watch::Follower;
use engine::effects::{Choice, Effect};
use engine::gaussians::formats;
use engine::job::config::Pruning;
use engine::job::earlier::{self, Earlier};
use engine::job::{Error, Output, Preset, RunConfig, Session};
use engine::metrics::Networks;
use engine::pipeline::run;
use engine::qirf::select::budget::Keep;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// A finished run.
#[pyclass(frozen, module = "qirf_vk")]
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

/// Takes an option out of them, in Rust's type.
fn taken<T: serde::de::DeserializeOwned>(options: &mut Map<String, Value>, name: &str) -> PyResult<Option<T>> {
    let Some(value) = options.shift_remove(name).filter(|value| !value.is_null()) else { return Ok(None) };
    serde_json::from_value(value).map(Some).map_err(|e| wrong(format!("{name}: {e}")))
}

/// The configuration of a run: the preset's, with these options.
fn configuration(scene: PathBuf, preset: &str, mut options: Map<String, Value>) -> PyResult<RunConfig> {
    let preset: Preset = serde_json::from_value(preset.into()).map_err(|e| wrong(format!("preset: {e}")))?;
    let mut config = RunConfig::of(scene, preset);
    config.schedule = preset.schedule(taken(&mut options, "iterations")?);
    // In config.toml these keys tell what was decided; here they ask for it.
    for (name, effect, _) in config.switches() {
        if let Some(on) = taken::<bool>(&mut options, name)? {
            config.effects.set(effect, if on { Choice::On } else { Choice::Off });
        }
    }
    if let Some(degree) = options.get("sh_degree").and_then(Value::as_u64) {
        config.effects.set(Effect::ViewDependence, if degree > 0 { Choice::On } else { Choice::Off });
    }
    let effects: Option<Vec<String>> = taken(&mut options, "effects")?;
    for effect in effects.iter().flatten() {
        let (effect, choice) = engine::effects::Overrides::parse(effect).map_err(wrong)?;
        config.effects.set(effect, choice);
    }
    let (keep, count): (Option<f64>, Option<i64>) = (taken(&mut options, "keep")?, taken(&mut options, "count")?);
    let prune = taken(&mut options, "prune")?.unwrap_or(true);
    let keep = match (keep, count) {
        (Some(_), Some(_)) => return Err(wrong("keep and count ask for two numbers of Gaussians; give one of them")),
        (Some(keep), None) => Some(Keep::Share(share(keep)?)),
        (None, Some(count)) => Some(Keep::Count(number("count", count, 1)?)),
        (None, None) => None,
    };
    if !prune && keep.is_some() {
        return Err(wrong("a run without a prune keeps all: leave out keep and count"));
    }
    if prune {
        let mut pruning: Pruning = preset.pruning();
        pruning.compression.keep = keep.unwrap_or(pruning.compression.keep);
        config = config.pruned(pruning);
    }
    options.retain(|_, value| !value.is_null());
    if let Some(resolution @ Value::Number(_)) = options.get_mut("resolution") {
        *resolution = Value::String(resolution.to_string()); // a width in pixels
    }
    let with = |options: Map<String, Value>| {
        let fields = serde_json::from_value(Value::Object(options)).map_err(|e| e.to_string())?;
        config.with(fields).map_err(|e| e.to_string())
    };
    with(options.clone()).map_err(|error| {
        // The first option that is wrong alone, whose place in config.toml says nothing to who gave it.
        let one = |(name, value): (String, Value)| Some((name.clone(), with(Map::from_iter([(name, value)])).err()?));
        let Some((name, error)) = options.into_iter().find_map(one) else { return wrong(error) };
        if error.starts_with("unknown field") {
            return wrong(format!("{error}; and here iterations, keep and count"));
        }
        match error.split_once(": ") {
            Some((place, what)) if place.starts_with("line ") => wrong(format!("{name}: {what}")),
            _ => wrong(error),
        }
    })
}

/// Trains a scene with poses, prunes it, and scores it, as `qirf-vk run` does, with the same bytes.
///
/// scene: a folder with COLMAP's, Blender's, instant-ngp's or nerfstudio's cameras and photos. preset: "standard", "quick" or "paper".
/// output: the folder of the run's files; a temporary folder by default. resume: continue from the checkpoint of an interrupted run there.
///
/// on_step gets a line of log.jsonl as a dictionary: iteration, iterations, seconds, loss (or None), gaussians, psnr if it was measured,
/// rates, device_bytes. on_progress gets the stage, the steps done and their total. An exception in a callback ends the run.
///
/// options: iterations; keep (a share) or count of Gaussians, or prune=False; effects, such as ["exposure=on"]; and every key of
/// config.toml, such as seed, resolution (640 pixels wide, or "/2"), images, eval_every, sh_degree, max_gaussians, checkpoint_every,
/// background, clean.
#[pyfunction]
#[pyo3(signature = (scene, preset="standard", *, output=None, device=None, resume=false, on_step=None, on_progress=None, **options))]
pub fn train(
    py: Python<'_>,
    scene: PathBuf,
    preset: &str,
    output: Option<PathBuf>,
    device: Option<&Bound<'_, Device>>,
    resume: bool,
    on_step: Option<Py<PyAny>>,
    on_progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Run> {
    let config = configuration(scene, preset, options.map(json).transpose()?.unwrap_or_default())?;
    if resume && output.is_none() {
        return Err(wrong("resume=True goes on from a checkpoint: name the run's folder as output"));
    }
    let device = or_usual(py, device)?;
    let temporary = tempfile::tempdir()?;
    let folder = output.clone().unwrap_or_else(|| temporary.path().to_owned());
    let follower = Follower::new(on_step, on_progress);
    let done = py.detach(|| -> Result<_, Error> {
        let output = Output::claim(&folder)?;
        let found = Earlier::of(&output);
        if !resume && found == Earlier::Interrupted {
            return Err(Error::Unfinished(output.checkpoint()));
        }
        if resume && found != Earlier::Nothing {
            earlier::check(&output, &config)?;
        }
        let networks = Networks::find(None)?;
        let session = Session { watcher: &follower, ..Session::new(&device, &networks) };
        if !(resume && found == Earlier::Finished) {
            run::run(&session, &config, &output, resume)?;
            output.complete();
        }
        let text = |path: PathBuf| std::fs::read_to_string(&path).map_err(|source| Error::Read { path, source });
        Ok((text(output.metrics())?, formats::read(&output.model())?, text(output.log())?))
    });
    let (record, loaded, log) = follower.result(done)?;
    let json = |text: &str| serde_json::from_str::<Value>(text).map_err(|e| wrong(e.to_string()));
    let (record, log) = (json(&record)?, log.lines().map(json).collect::<PyResult<Vec<Value>>>()?);
    Ok(Run {
        model: Py::new(py, Model::from(loaded))?,
        record: dictionary(py, &record)?.unbind(),
        log: dictionary(py, &log)?.unbind(),
        folder: output,
    })
}
