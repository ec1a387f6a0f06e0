//! Where a job's files lie.

use crate::error::Error;
use crate::gaussians::formats;
use std::path::{Path, PathBuf};

/// A folder of results.
pub struct Output(PathBuf);

impl Output {
    /// A folder, made where it is absent. What a killed program had begun to write there goes: nobody else would remove it.
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

    /// The figures.
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.json")
    }

    /// The page of it all.
    pub fn report(&self) -> PathBuf {
        self.0.join("report.html")
    }

    /// The folder of pictures.
    pub fn renders(&self) -> PathBuf {
        self.0.join("renders")
    }

    /// Writes a text file whole or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn text(path: &Path, text: &str) -> Result<(), Error> {
        formats::write_atomically(path, |out| out.write_all(text.as_bytes())).map_err(Error::writing)
    }
}
