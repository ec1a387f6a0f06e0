//! `qirf-vk run`: from photos to a trained model, its pictures and its figures.

use super::active_run::ActiveRun;
use super::setup::{Setup, tuned};
use crate::gaussians::formats;
use crate::job::records::RunRecord;
use crate::job::{Error, Init, Output, RunConfig, Session};

/// Trains, prunes if configured, evaluates and writes a run. With `resume` it continues from the folder's checkpoint,
/// if there is one, and gives the same bytes as an uninterrupted run. The checkpoint stays: once all that is made from the
/// results is written, [`Output::complete`] removes it.
///
/// # Errors
/// Any error from reading the scene to writing results; [`Error::Interrupted`] after a checkpoint.
pub fn run(session: &Session<'_>, config: &RunConfig, output: &Output, resume: bool) -> Result<RunRecord, Error> {
    if let Init::Model(model) = &config.init {
        formats::refuse_overwrite(model, &output.model()).map_err(Error::writing)?;
    }
    let device = tuned(session, config, output, resume)?;
    let session = &Session { device: &device, ..*session };
    let (setup, start) = Setup::load(session, config, output, resume)?;
    setup.write_config(&start, output)?;
    let mut run = ActiveRun::start(&setup, &setup.config, output, start)?;
    run.log()?;
    run.train(setup.config.schedule.iterations)?;
    let record = run.finish()?;
    if setup.config.prune.is_some() && record.prunes.is_empty() {
        session.watcher.note("the run is too short for its prune: the model is not pruned; give more --iterations");
    }
    let asked = setup.config.schedule.growth.and_then(|plan| plan.gaussians).unwrap_or(0);
    let grown = record.gaussians.dense.unwrap_or(record.gaussians.last);
    // Without a prune, floaters are removed before Gaussians are counted.
    let is_counted = !setup.config.clean || !record.prunes.is_empty();
    if is_counted && grown < asked.min(setup.config.max_gaussians) {
        session.watcher.note(&format!(
            "--grow-to {asked}: the model grew to {grown} Gaussians. A density step at most doubles their number: train longer, or begin \
             with more"
        ));
    }
    Ok(record)
}
