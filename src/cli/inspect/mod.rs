//! `qirf-vk inspect MODEL|SCENE`.

mod model;
mod scene;

use super::console::Console;
use crate::error::Error;
use crate::gaussians::formats::{self, Loaded};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk inspect model.ply
  qirf-vk inspect capture --json";

/// Tell what a model or a scene holds.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model file, or folder of a scene or a SOG model
    path: PathBuf,
    /// Photo folder of a scene (such as images_4)
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        let value = if is_scene(&self.path) {
            scene::describe(&self.path, self.images.clone())?
        } else {
            model::describe(&self.path, &read(&self.path)?)?
        };
        if self.json { console.json(&value) } else { print(console, &value, "") }
    }
}

/// Folders and JSON files are scenes, save for SOG's `meta.json` and the folder that holds it.
fn is_scene(path: &Path) -> bool {
    if path.is_dir() {
        return !path.join("meta.json").is_file();
    }
    let json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    json && path.file_name().is_some_and(|n| n != "meta.json")
}

/// Reads a model; devices and pipes, which may never end, are refused.
fn read(path: &Path) -> Result<Loaded, Error> {
    let data = std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    if !data.is_file() && !data.is_dir() {
        return Err(Error::Usage(format!("{} is neither a file nor a folder; save the model first", path.display())));
    }
    Ok(formats::read(path)?)
}

/// Reads a model and tells what was repaired.
pub(super) fn read_model(path: &Path, console: &Console) -> Result<Loaded, Error> {
    let loaded = read(path)?;
    if loaded.repairs.any() {
        console.warn(format_args!("{}: {}", path.display(), loaded.repairs));
    }
    if loaded.gaussians.is_empty() {
        console.warn(format_args!("{}: it holds no Gaussian", path.display()));
    }
    Ok(loaded)
}

/// Prints a JSON document for people: a line a value, objects indented.
fn print(console: &Console, value: &serde_json::Value, indent: &str) -> Result<(), Error> {
    let Some(fields) = value.as_object() else { return console.print(value) };
    for (name, field) in fields {
        let label = name.replace('_', " ");
        match field {
            serde_json::Value::Object(inner) if !inner.is_empty() => {
                console.print(format_args!("{indent}{label}"))?;
                print(console, field, &format!("{indent}  "))?;
            }
            serde_json::Value::Array(items) if items.iter().any(serde_json::Value::is_object) => {
                console.print(format_args!("{indent}{label}"))?;
                for item in items {
                    console.print(format_args!("{indent}  {}", line(item)))?;
                }
            }
            other => {
                console.print(format_args!("{indent}{label:<width$} {}", line(other), width = 20 - indent.len()))?
            }
        }
    }
    Ok(())
}

/// A value on one line.
fn line(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Null => "none".into(),
        serde_json::Value::String(s) => s.clone(),
        serde_json::Value::Number(n) => n.as_f64().filter(|_| n.is_f64()).map_or_else(
            || n.to_string(),
            |v| {
                if v != 0.0 && !(1e-3..1e6).contains(&v.abs()) { format!("{v:.3e}") } else { format!("{v:.4}") }
            },
        ),
        serde_json::Value::Array(items) => items.iter().map(line).collect::<Vec<_>>().join("  "),
        serde_json::Value::Object(fields) => {
            fields.iter().map(|(k, v)| format!("{} {}", k.replace('_', " "), line(v))).collect::<Vec<_>>().join(", ")
        }
        serde_json::Value::Bool(b) => b.to_string(),
    }
}
