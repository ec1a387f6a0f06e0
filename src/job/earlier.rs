//! An earlier run in the folder of a new one.

use super::config::RunConfig;
use super::output::Output;
use super::records::ViewScores;
use crate::job::Error;
use crate::train::checkpoint::Snapshot;
use std::path::Path;

/// State of the run whose folder a new run names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Earlier {
    /// Nothing to continue.
    Nothing,
    /// A checkpoint.
    Interrupted,
    /// A model and its figures.
    Finished,
}

impl Earlier {
    /// The state of the run in a folder.
    pub fn of(output: &Output) -> Self {
        let finished = [output.config(), output.model(), output.metrics()].iter().all(|file| file.exists());
        match (output.checkpoint().exists(), finished) {
            (true, _) => Self::Interrupted,
            (false, true) => Self::Finished,
            (false, false) => Self::Nothing,
        }
    }
}

/// Returns true for the folder of a run that has its configuration and its model.
pub fn is_run(folder: &Path) -> bool {
    ["config.toml", "model.ply"].iter().all(|file| folder.join(file).is_file())
}

/// The configuration beside `model`, such as that of the run in whose folder it is; `None` without a `config.toml`.
///
/// # Errors
/// A `config.toml` that cannot be read.
pub fn of_model(model: &Path) -> Result<Option<RunConfig>, Error> {
    let file = model.parent().unwrap_or(Path::new("")).join("config.toml");
    if !file.is_file() {
        return Ok(None);
    }
    // Other programs have files of this name.
    let is_ours = model.with_file_name("model.ply").is_file();
    RunConfig::read(&file).map(Some).or_else(|error| if is_ours { Err(error) } else { Ok(None) })
}

/// The background of the figures of the finished run in a folder, if it has any.
pub fn scored_on(run: &Path) -> Option<[f32; 3]> {
    serde_json::from_value(figures(run)?["protocol"]["background"].clone()).ok()
}

/// Names of the held-out views in the figures of the finished run in a folder, if it has any.
pub fn views(run: &Path) -> Option<Vec<String>> {
    let views: Vec<ViewScores> = serde_json::from_value(figures(run)?["views"].clone()).ok()?;
    Some(views.into_iter().map(|view| view.name).collect())
}

fn figures(run: &Path) -> Option<serde_json::Value> {
    serde_json::from_slice(&std::fs::read(run.join("metrics.json")).ok()?).ok()
}

/// Refuses to replace the model of a run, which its figures describe.
///
/// # Errors
/// [`Error::Usage`].
pub fn spare_model(file: &Path) -> Result<(), Error> {
    let folder = file.parent().unwrap_or(Path::new(""));
    if file.file_name().is_some_and(|name| name == "model.ply" || name == "model.sog") && is_run(folder) {
        return Err(Error::Usage(format!(
            "{} is a run's model, which the figures beside it describe; name another file",
            file.display()
        )));
    }
    Ok(())
}

/// The configuration in the checkpoint of the run in `folder`; `None` if there is none that can be read.
fn of_checkpoint(folder: &Path) -> Option<RunConfig> {
    let text = Snapshot::note(&folder.join("checkpoint.safetensors"), "config")?;
    Some(toml::from_str::<RunConfig>(&text).ok()?.read_in(folder))
}

/// The configuration of the earlier run in `output`: that of its checkpoint, else that of `config.toml`, which people may have edited;
/// `None` without either.
///
/// # Errors
/// A `config.toml` that cannot be read.
pub fn config(output: &Output) -> Result<Option<RunConfig>, Error> {
    let (own, written) = (of_checkpoint(output.folder()), output.config());
    if own.is_some() || !written.exists() { Ok(own) } else { RunConfig::read(&written).map(Some) }
}

/// True if the `config.toml` in `folder` is that of the checkpoint beside it, but for the tuning, or there is no checkpoint.
pub fn is_config_kept(folder: &Path) -> bool {
    let Some(own) = of_checkpoint(folder) else { return true };
    RunConfig::read(&folder.join("config.toml")).is_ok_and(|written| written.changes(&own).is_empty())
}

/// Checks that `config` is that of the earlier run in `output`, as far as this is known before the scene is read.
///
/// # Errors
/// [`Error::OtherRun`]; a damaged checkpoint; without one, a `config.toml` that cannot be read.
pub fn check(output: &Output, config: &RunConfig) -> Result<(), Error> {
    let Some(earlier) = self::config(output)? else { return Ok(()) };
    let changes = config.changes_before_decisions(&earlier);
    if changes.is_empty() {
        return Ok(());
    }
    // A damaged checkpoint may be the cause of the difference.
    if output.checkpoint().exists() {
        Snapshot::read(&output.checkpoint())?;
    }
    Err(Error::OtherRun { folder: output.folder().to_owned(), changes })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_models_of_runs_are_spared() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("model.ply"), "").unwrap();
        assert!(spare_model(&at("model.ply")).is_ok(), "a folder without config.toml is no run's");
        std::fs::write(at("config.toml"), "").unwrap();
        let spared = ["model.ply", "model.sog", "other.ply"].map(|name| spare_model(&at(name)).is_err());
        assert_eq!((spared, is_run(folder.path())), ([true, true, false], true));
    }
}
