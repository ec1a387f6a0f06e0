//! An earlier run in the folder of a new one.

use super::config::RunConfig;
use super::output::Output;
use crate::job::Error;

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

/// Checks that `config` is that of the earlier run in `output`, as far as this is known before the scene is read.
///
/// # Errors
/// [`Error::OtherRun`]; a `config.toml` that cannot be read.
pub fn check(output: &Output, config: &RunConfig) -> Result<(), Error> {
    let written = output.config();
    if !written.exists() {
        return Ok(());
    }
    let changes = config.changes_before_decisions(&RunConfig::read(&written)?);
    if changes.is_empty() { Ok(()) } else { Err(Error::OtherRun { folder: output.folder().to_owned(), changes }) }
}
