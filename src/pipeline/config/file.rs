//! `config.toml`, read and written.

use super::ranges;
use super::run::RunConfig;
use crate::error::Error;
use std::path::Path;

impl RunConfig {
    /// Reads a `config.toml`.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Usage`] with the file and the line or the field that cannot be.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        let wrong = |what: String| Error::Usage(format!("{}: {what}", path.display()));
        let config: Self = toml::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        ranges::check(&config).map_err(wrong)?;
        Ok(config)
    }

    /// The text of `config.toml`.
    ///
    /// # Errors
    /// [`Error::Encode`] for values that TOML cannot hold, such as a path that is not UTF-8.
    pub fn written(&self) -> Result<String, Error> {
        toml::to_string(self).map_err(|e| Error::encoding("config.toml", e))
    }
}
