//! `qirf-vk run`: from photos to a trained model, its pictures and its figures.

use super::budget;
use super::checkpoint::Checkpoint;
use super::config::{Init, RunConfig};
use super::job::{Job, Stage};
use super::output::Output;
use super::prepare::{Start, open};
use super::records::RunRecord;
use super::watcher::Watcher;
use crate::error::Error;
use crate::gaussians::formats;
use crate::gpu::Device;
use crate::metrics::Networks;
use std::time::Instant;

/// Trains, prunes where the configuration says so, evaluates and writes a run. With `resume` it goes on from the folder's
/// checkpoint, if there is one, and ends with the same bytes as the unbroken run. Photos take no more than `host_bytes` of
/// the host's memory.
///
/// # Errors
/// Anything from scene to disk; [`Error::Interrupted`] after a checkpoint.
pub fn run(
    device: &Device,
    config: &RunConfig,
    output: &Output,
    networks: &Networks,
    host_bytes: u64,
    resume: bool,
    watcher: &(dyn Watcher + Sync),
) -> Result<RunRecord, Error> {
    let begun = Instant::now();
    if let Init::Model(model) = &config.init {
        formats::refuse_overwrite(model, &output.model()).map_err(Error::writing)?;
    }
    let checkpoint = found(output, resume, watcher)?;
    let of = checkpoint.as_ref().map(|c| c.notes.config.clone());
    let opened = open(&config.selection())?;
    let start = match checkpoint {
        Some(c) => Start::Resumed(Box::new(c)),
        None => Start::of(config, &opened)?,
    };
    let estimated_bytes = budget::for_run(device, config, &opened, &start)?;
    let means = (host_bytes, output);
    let (stage, config) = Stage::load(device, (opened, config), means, networks, watcher, (begun, estimated_bytes))?;
    let written = config.written()?;
    same_run(output, of, &written)?;
    Output::text(&output.config(), &written)?;
    let mut job = Job::start(&stage, &config, output, start)?;
    job.train(config.schedule.iterations)?;
    let results = job.finish()?;
    // The run is whole: nothing is left to go on from.
    let _ = std::fs::remove_file(output.checkpoint());
    Ok(results)
}

/// The checkpoint to go on from, if that is asked for and there is one.
pub(super) fn found(output: &Output, resume: bool, watcher: &dyn Watcher) -> Result<Option<Checkpoint>, Error> {
    if !resume {
        return Ok(None);
    }
    let path = output.checkpoint();
    if !path.exists() {
        watcher.note("no checkpoint is there yet: starting afresh");
        return Ok(None);
    }
    let checkpoint = Checkpoint::read(&path)?;
    watcher.note(&format!("going on after iteration {}", checkpoint.snapshot.iteration));
    Ok(Some(checkpoint))
}

/// Refuses to go on from a checkpoint `of` another configuration than `written`.
pub(super) fn same_run(output: &Output, of: Option<String>, written: &str) -> Result<(), Error> {
    if of.is_none_or(|of| of == written) {
        return Ok(());
    }
    Err(Error::OtherRun { checkpoint: output.checkpoint(), config: output.config() })
}
