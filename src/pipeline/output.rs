//! Paths of a job's files.

use crate::gaussians::formats;
use crate::pipeline::Error;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A folder of results.
pub struct Output(PathBuf);

impl Output {
    /// Opens a folder, created if absent. Temporary files that a killed program left there are removed.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn new(folder: &Path) -> Result<Self, Error> {
        std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
        let output = Self(folder.to_owned());
        for file in [output.checkpoint(), output.config(), output.model(), output.metrics(), output.report()] {
            formats::remove_leftovers(&file);
        }
        Ok(output)
    }

    /// The folder itself.
    pub fn folder(&self) -> &Path {
        &self.0
    }

    /// The checkpoint.
    pub fn checkpoint(&self) -> PathBuf {
        self.0.join("checkpoint.safetensors")
    }

    /// The configuration.
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// The trained model.
    pub fn model(&self) -> PathBuf {
        self.0.join("model.ply")
    }

    /// The model packed into a wanted size.
    pub fn packed(&self) -> PathBuf {
        self.0.join("model.sog")
    }

    /// The figures.
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.json")
    }

    /// The log of a run in progress.
    pub fn log(&self) -> PathBuf {
        self.0.join("log.jsonl")
    }

    /// The report.
    pub fn report(&self) -> PathBuf {
        self.0.join("report.html")
    }

    /// The folder of pictures.
    pub fn renders(&self) -> PathBuf {
        self.0.join("renders")
    }

    /// The scene of a run on photos without poses.
    pub fn scene(&self) -> PathBuf {
        self.0.join("scene")
    }

    /// Writes `document` as JSON, whole or not at all; `what` names it in errors.
    ///
    /// # Errors
    /// [`Error::Encode`]; [`Error::Write`].
    pub fn json(path: &Path, what: &'static str, document: &impl Serialize) -> Result<(), Error> {
        Self::text(path, &serde_json::to_string_pretty(document).map_err(|e| Error::encoding(what, e))?)
    }

    /// Writes a text file whole or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn text(path: &Path, text: &str) -> Result<(), Error> {
        formats::write_atomically(path, |out| out.write_all(text.as_bytes())).map_err(Error::writing)
    }
}

/// The same path from the root, for work in another folder.
///
/// # Errors
/// [`Error::Read`] if there is no current folder.
pub fn absolute(path: &Path) -> Result<PathBuf, Error> {
    std::path::absolute(path).map_err(|source| Error::Read { path: path.to_owned(), source })
}

/// Returns true if both paths lead to the same place on disk, however they are spelt.
pub fn same_place(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    a == b || real(a).is_some_and(|a| Some(a) == real(b))
}

/// Makes a scene's path absolute, and that of its photo folder where this is not one within the scene.
///
/// # Errors
/// As [`absolute`].
pub fn from_root(scene: &mut PathBuf, images: &mut Option<PathBuf>) -> Result<(), Error> {
    *scene = absolute(scene)?;
    if let Some(images) = images.as_mut().filter(|images| !scene.join(images).exists()) {
        *images = absolute(images)?;
    }
    Ok(())
}

/// Bytes of a model's file, or of all files in its folder; 0 if there is none.
pub fn bytes_on_disk(path: &Path) -> u64 {
    let file = |p: &Path| std::fs::metadata(p).map_or(0, |m| m.len());
    match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().map(|e| file(&e.path())).sum(),
        Err(_) => file(path),
    }
}
