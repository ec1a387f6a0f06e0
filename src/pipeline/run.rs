//! `qirf-vk run`: from photos to a trained model, its pictures and its figures.

use super::active_run::ActiveRun;
use super::config::{Init, RunConfig};
use super::output::Output;
use super::records::RunRecord;
use super::session::Session;
use super::setup::Setup;
use crate::error::Error;
use crate::gaussians::formats;

/// Trains, prunes where the configuration says so, evaluates and writes a run. With `resume` it goes on from the folder's
/// checkpoint, if there is one, and ends with the same bytes as the unbroken run.
///
/// # Errors
/// Anything from scene to disk; [`Error::Interrupted`] after a checkpoint.
pub fn run(session: &Session<'_>, config: &RunConfig, output: &Output, resume: bool) -> Result<RunRecord, Error> {
    if let Init::Model(model) = &config.init {
        formats::refuse_overwrite(model, &output.model()).map_err(Error::writing)?;
    }
    let (setup, start) = Setup::load(session, config, output, resume)?;
    setup.write_config(&start, output)?;
    let mut run = ActiveRun::start(&setup, &setup.config, output, start)?;
    run.train(setup.config.schedule.iterations)?;
    let record = run.finish()?;
    // The run is whole: nothing is left to go on from.
    let _ = std::fs::remove_file(output.checkpoint());
    Ok(record)
}
