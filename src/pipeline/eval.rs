//! `qirf-vk eval`: a model of any format against a scene's held-out photos, or against another model's pictures.

use super::budget;
use super::config::Selection;
use super::evaluate::{Evaluator, HeldOut, exposure_note, protocol};
use super::output::{Output, bytes_on_disk};
use super::prepare::open;
use super::records::{Counts, Guards, Memory, Protocol, RunRecord, Times, TrainScores};
use super::virtual_views::{Around, OwnPictures};
use super::watcher::Watcher;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::render::Style;
use crate::scene::PhotoMemory;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// What is evaluated, and how it is rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// The scene and its held-out views.
    pub selection: Selection,
    /// How it is rendered: as the model was trained.
    pub style: Style,
    /// Whether photos have exposures of their own: fitted before scoring, as a run does it.
    pub exposure: bool,
}

/// Renders and scores the held-out views of a scene as a run of the same selection does; figures and pictures are
/// written where there is an `output`. `file` is where `model` was read from. Photos
/// take no more than `host_bytes` of the host's memory.
///
/// # Errors
/// Anything from scene to disk; no held-out view; [`Error::Interrupted`].
pub fn eval(
    device: &Device,
    (file, model): (&Path, &Gaussians),
    evaluation: &Evaluation,
    output: Option<&Output>,
    networks: &Networks,
    host_bytes: u64,
    watcher: &(dyn Watcher + Sync),
) -> Result<RunRecord, Error> {
    let begun = Instant::now();
    let selection = &evaluation.selection;
    let opened = open(selection)?;
    let estimated_bytes = budget::for_eval(device, &opened, (model.len(), model.degree()), evaluation.style)?;
    let elsewhere = std::env::temp_dir();
    let folder = output.map_or(elsewhere.as_path(), Output::folder);
    let prepared = opened.load(PhotoMemory { bytes: host_bytes, folder }, watcher)?;
    if prepared.test.is_empty() {
        return Err(Error::NothingHeldOut(selection.scene.clone()));
    }
    let load_s = begun.elapsed().as_secs_f64();
    let settings = evaluation.style.over(prepared.background);

    let evaluating = Instant::now();
    let resident = Resident::upload(device, model)?;
    let mut evaluator = Evaluator::new(device, settings, model.len(), prepared.views())?;
    evaluator.compare_as(evaluation.exposure);
    let renders = output.map(Output::renders);
    let mut follow = |done: usize| {
        watcher.evaluating(done, prepared.test.len());
        watcher.unless_stopped()
    };
    let held_out = evaluator.held_out(&resident, &prepared.test, renders.as_deref(), networks, &mut follow)?;
    held_out.warn(watcher);
    let unfitted_psnr = if evaluation.exposure {
        evaluator.compare_as(false);
        let psnr = evaluator.psnr(&resident, prepared.test.iter().map(|(_, view)| view))?;
        evaluator.compare_as(true);
        psnr
    } else {
        None
    };
    let train_psnr = evaluator.psnr(&resident, prepared.train.iter())?;
    let frames_per_second = evaluator.frames_per_second(&resident, &prepared)?;
    let results = RunRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.info().clone(),
        protocol: Protocol { exposure: exposure_note(evaluation.exposure), ..protocol(selection, &prepared, networks) },
        gaussians: Counts { initial: None, dense: None, last: model.len() },
        test: held_out.mean(),
        unfitted_psnr,
        train: TrainScores { psnr: train_psnr },
        guards: Guards {
            skipped_rows: 0,
            undrawable: model.undrawable(),
            empty_views: held_out.empty,
            scene: prepared.scene.skipped.clone(),
        },
        views: held_out.views,
        frames_per_second,
        model_bytes: bytes_on_disk(file),
        prunes: Vec::new(),
        curve: Vec::new(),
        time: Times {
            total_s: begun.elapsed().as_secs_f64(),
            load_s,
            train_s: 0.0,
            prune_s: 0.0,
            evaluate_s: evaluating.elapsed().as_secs_f64(),
            stages_s: BTreeMap::new(),
        },
        effects: Vec::new(),
        memory: Memory { estimated_bytes, peak_bytes: device.memory_used().1, limit_bytes: device.memory_limit() },
    };
    if let Some(output) = output {
        Output::json(&output.metrics(), "metrics.json", &results)?;
    }
    Ok(results)
}

/// Scores a model by the held-out views that `qirf-vk compress` would judge `original` by, against its pictures: what a
/// compression by any tool has lost. `style`: colour behind the Gaussians, and how both are rendered.
///
/// # Errors
/// Device memory; device errors; [`Error::Interrupted`].
pub fn against(
    device: &Device,
    model: &Gaussians,
    original: &Gaussians,
    style: ([f32; 3], Style),
    networks: &Networks,
    watcher: &(dyn Watcher + Sync),
) -> Result<HeldOut, Error> {
    let OwnPictures { test, settings, .. } =
        OwnPictures::new(device, original, &Around::default(), style, false, watcher)?;
    let resident = Resident::upload(device, model)?;
    let mut evaluator = Evaluator::new(device, settings, model.len(), test.iter().map(|(_, view)| view))?;
    let held_out = evaluator.held_out(&resident, &test, None, networks, &mut |done| {
        watcher.evaluating(done, test.len());
        watcher.unless_stopped()
    })?;
    held_out.warn(watcher);
    Ok(held_out)
}
