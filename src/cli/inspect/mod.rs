//! `qirf-vk inspect MODEL|SCENE`.

mod model;
mod scene;

use super::Global;
use super::console::Console;
use super::remedy::remedy;
use super::values;
use crate::edit::reading_warnings;
use crate::extension::has_extension;
use crate::gaussians::{
    self,
    formats::{self, Loaded},
};
use crate::job::earlier::is_run;
use crate::job::{Error, Preset, RunConfig, Session};
use crate::metrics::Networks;
use crate::pipeline::budget::{Foreseen, foreseen};
use crate::scene::{OpenOptions, Scene, instead};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk inspect model.ply
  qirf-vk inspect capture --json
  qirf-vk inspect capture --html capture.html";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model file, or folder of a scene or a SOG model
    path: PathBuf,
    /// Photo folder of a scene (such as images_4)
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Depth maps of a scene, with the photos' names
    #[arg(long, value_name = "DIR")]
    depth: Option<PathBuf>,
    /// Mask everything within DEG degrees of straight down in the panoramas and wide fisheyes of a scene
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = values::pole)]
    pole_mask: f64,
    /// Write a web page with a scene's points and cameras: held-out cameras are orange, suspect ones red
    #[arg(long, value_name = "FILE", value_parser = page)]
    html: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Reads the name of a web page, which no model and no photo has.
fn page(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if has_extension(&path, &["html"]) { Ok(path) } else { Err("the name of a page ends in .html".to_owned()) }
}

impl Arguments {
    /// An option that was given and is for scenes.
    fn of_scenes(&self) -> Option<&'static str> {
        let given = [
            (self.images.is_some(), "--images"),
            (self.depth.is_some(), "--depth"),
            (self.pole_mask > 0.0, "--pole-mask"),
            (self.html.is_some(), "--html"),
        ];
        given.into_iter().find(|(given, _)| *given).map(|(_, option)| option)
    }

    fn options(&self) -> OpenOptions {
        OpenOptions {
            images: self.images.clone(),
            undistort: None,
            pole_mask: self.pole_mask,
            depth: self.depth.clone(),
            check: true,
        }
    }

    /// The needs of a run of this scene without options, if a device is there to tell.
    fn needs(&self, scene: Scene, global: &Global) -> Option<Value> {
        let device = global.open().ok()?;
        let preset = Preset::default();
        let config = RunConfig {
            images: self.images.clone(),
            depth: self.depth.clone(),
            pole_mask: self.pole_mask,
            ..RunConfig::of(self.path.clone(), preset).pruned(preset.pruning())
        };
        let networks = Networks::default();
        match foreseen(&Session::new(&device, &networks), &config, scene) {
            Ok(Foreseen { gaussians, bytes }) => {
                Some(json!({ "device": device.info().name, "gaussians": gaussians, "bytes": bytes }))
            }
            Err(error @ (Error::Memory { .. } | Error::Buffer { .. })) => {
                let remedy = remedy(&error).map_or(String::new(), |remedy| format!("; {remedy}"));
                Some(json!({ "device": device.info().name, "problem": format!("{error}{remedy}") }))
            }
            Err(_) => None,
        }
    }

    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let value = if is_scene(&self.path) {
            let (mut value, shown) = scene::describe(&self.path, &self.options(), self.html.as_deref())
                .map_err(|e| unfinished(&self.path, e))?;
            let needs = shown.and_then(|scene| self.needs(scene, global));
            if let (Some(fields), Some(needs)) = (value.as_object_mut(), needs) {
                fields.insert("run_needs".to_owned(), needs);
            }
            value
        } else if let Some(option) = self.of_scenes() {
            return Err(Error::Usage(format!("{option} needs a scene, but {} is a model", self.path.display())));
        } else {
            let loaded = read(&self.path)?;
            if let Some(doubt) = &loaded.doubt {
                console.warn(format_args!("{}: {doubt}", self.path.display()));
            }
            model::describe(&self.path, &loaded)?
        };
        if self.json { console.json(&value) } else { print(console, &value) }
    }
}

/// Returns true for folders and the files of captures, except for those of a SOG model.
pub(super) fn is_scene(path: &Path) -> bool {
    (has_extension(path, &["json", "txt", "bin"]) || path.is_dir()) && formats::sog_meta(path).is_none()
}

/// The error of a path that holds neither the expected scene nor the expected model: another result in it, or a job that has not
/// finished, explains it.
pub(super) fn unfinished(path: &Path, error: Error) -> Error {
    let holds = |name: &str| path.join(name).is_file();
    // A comparison of several seeds has its figures above the folders of the seeds.
    let of_a_seed = |folder: &Path| folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with("seed-"));
    let above = path.parent().filter(|_| of_a_seed(path));
    let seeds_begun = || {
        let mut entries = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
        entries.any(|entry| of_a_seed(&entry) && entry.join("arms").is_dir())
    };
    let what = if holds("compare.json") || above.is_some_and(|above| above.join("compare.json").is_file()) {
        "it is the folder of a comparison: compare.html shows its figures, and compare.json holds them"
    } else if holds("sweep.json") {
        "it is the folder of a sweep: sweep.html shows its figures, and sweep.json holds them"
    } else if (holds("config.toml") && path.join("arms").is_dir()) || seeds_begun() {
        "it is the folder of a comparison that has not finished; continue it with `compare --resume`"
    } else if !holds("config.toml") || is_run(path) {
        return error;
    } else {
        "it is the folder of a run that has not finished; continue it with `run --resume`, or watch it with `run --view`"
    };
    match error {
        Error::Scene(crate::scene::Error::NoScene { .. }) | Error::Gaussians(gaussians::Error::Unsupported { .. }) => {
            crate::scene::Error::Instead { path: path.to_owned(), what: what.to_owned() }.into()
        }
        other => other,
    }
}

/// Reads a model; refuses devices and pipes, which may never end.
fn read(path: &Path) -> Result<Loaded, Error> {
    let data = std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    if !data.is_file() && !data.is_dir() {
        return Err(Error::Usage(format!("{} is neither a file nor a folder; save the model first", path.display())));
    }
    formats::read(path).map_err(|error| {
        // Archives of these kinds hold models, too.
        let packed = has_extension(path, &["zip", "gz"]);
        let no_model = match error {
            gaussians::Error::Unsupported { .. } => true,
            gaussians::Error::Malformed { .. } => !packed,
            _ => false,
        };
        match instead(path).filter(|_| data.is_file() && no_model) {
            Some(what) => crate::scene::Error::Instead { path: path.to_owned(), what }.into(),
            None => unfinished(path, error.into()),
        }
    })
}

/// Reads a model and warns of repairs.
pub(super) fn read_model(path: &Path, console: &Console) -> Result<Loaded, Error> {
    let loaded = read(path)?;
    for warning in reading_warnings(&loaded) {
        console.warn(format_args!("{}: {warning}", path.display()));
    }
    Ok(loaded)
}

/// Opens a scene, whose photos may be absent, and warns of what its readers left out.
pub(super) fn open_scene(path: &Path, options: &OpenOptions, console: &Console) -> Result<Scene, Error> {
    let scene = Scene::open(path, options).map_err(|e| unfinished(path, e.into()))?;
    for line in scene.skipped.summary() {
        console.warn(format_args!("{}: {line}", path.display()));
    }
    Ok(scene)
}

/// Largest number of lines of a list that are printed.
const LIST_LINES: usize = 6;

/// Prints a JSON document as text: one line per field, lists of objects below one another.
fn print(console: &Console, document: &Value) -> Result<(), Error> {
    for (name, field) in document.as_object().into_iter().flatten() {
        if name == "effects" {
            effects(console, field)?;
            continue;
        }
        let label = name.replace('_', " ");
        let lines: Vec<String> = match field {
            Value::Array(items) if items.iter().any(|i| !i.is_number()) => items.iter().map(line).collect(),
            other => vec![line(other)],
        };
        for (i, line) in lines.iter().take(LIST_LINES).enumerate() {
            console.print(format_args!("{:<26} {line}", if i == 0 { label.as_str() } else { "" }))?;
        }
        if lines.len() > LIST_LINES {
            console.print(format_args!("{:<26} and {} more (--json shows all)", "", lines.len() - LIST_LINES))?;
        }
    }
    Ok(())
}

/// Prints the decision on each effect, with the reason.
fn effects(console: &Console, decisions: &Value) -> Result<(), Error> {
    for (i, d) in decisions.as_array().into_iter().flatten().enumerate() {
        let text = |key: &str| d[key].as_str().unwrap_or_default();
        let switch = match (d["on"].as_bool(), d["degree"].as_u64()) {
            (Some(true), Some(degree)) => format!("on, {degree}"),
            (Some(true), None) => "on".to_owned(),
            _ => "off".to_owned(),
        };
        let near = if d["near_threshold"].as_bool() == Some(true) { "; this is near the threshold" } else { "" };
        let label = if i == 0 { "effects" } else { "" };
        let name = text("name").replace('_', " ");
        console.print(format_args!("{label:<26} {name:<16} {switch:<6} {}{near}", text("evidence")))?;
    }
    Ok(())
}

fn line(value: &Value) -> String {
    match value {
        Value::Null => "none".into(),
        Value::String(s) => s.clone(),
        Value::Number(n) => n.as_f64().filter(|_| n.is_f64()).map_or_else(
            || n.to_string(),
            |v| {
                if v != 0.0 && !(1e-3..1e9).contains(&v.abs()) { format!("{v:.3e}") } else { format!("{v:.4}") }
            },
        ),
        Value::Array(items) if items.is_empty() => "none".into(),
        Value::Array(items) => items.iter().map(line).collect::<Vec<_>>().join("  "),
        Value::Object(fields) => {
            fields.iter().map(|(k, v)| format!("{} {}", k.replace('_', " "), line(v))).collect::<Vec<_>>().join(", ")
        }
        Value::Bool(b) => b.to_string(),
    }
}
