//! What a run measured: `metrics.json`, schema 1 (docs/metrics.md).

use super::config::Selection;
use super::output::Output;
use super::prepare::Prepared;
use crate::effects::Decision;
use crate::error::Error;
use crate::gpu::{DeviceInfo, Timings};
use crate::metrics::{Networks, Scores};
use crate::qirf::CHANNELS;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Choice;
use crate::qirf::study::{Merging, Study};
use crate::scene::Skipped;
use crate::scene::camera::Camera;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The whole of `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// Version of this layout.
    pub schema: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The device.
    pub device: DeviceInfo,
    /// How the figures came about.
    pub protocol: Protocol,
    /// Numbers of Gaussians.
    pub gaussians: Counts,
    /// Mean scores of the held-out views; null without any.
    pub test: Option<Scores>,
    /// Mean PSNR of the held-out views as they are rendered, whole and without fitted exposures, in dB; null where
    /// `test` is of that already.
    #[serde(rename = "test_unfitted_psnr")]
    pub unfitted_psnr: Option<f64>,
    /// Mean PSNR of the training views, in dB.
    pub train: TrainScores,
    /// Scores of each held-out view.
    pub views: Vec<ViewScores>,
    /// Pictures a second at the test views' size, rendering alone.
    pub frames_per_second: Option<f64>,
    /// Bytes of `model.ply`, or of the file that was evaluated.
    #[serde(rename = "ply_bytes")]
    pub model_bytes: u64,
    /// Each prune, in order; empty where nothing was pruned.
    pub prunes: Vec<Pruned>,
    /// Quality against time, evaluation excluded.
    pub curve: Vec<CurvePoint>,
    /// Seconds.
    pub time: Times,
    /// What was decided on each effect, with the evidence; empty from an evaluation.
    pub effects: Vec<Decision>,
    /// What was repaired, skipped or left out on the way.
    pub guards: Guards,
    /// Device memory in bytes.
    pub memory: Memory,
}

impl Results {
    /// Writes `metrics.json`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, output: &Output) -> Result<(), Error> {
        let json = serde_json::to_string_pretty(self).map_err(|e| Error::encoding("metrics.json", e))?;
        Output::text(&output.metrics(), &json)
    }
}

/// How the figures came about.
#[derive(Clone, Debug, Serialize)]
pub struct Protocol {
    /// Views held out.
    pub test_split: String,
    /// Number of training views.
    pub train_views: usize,
    /// Number of held-out views.
    pub test_views: usize,
    /// Largest picture, width and height.
    pub image_size: [u32; 2],
    /// How photos came to that size.
    pub downscaling: &'static str,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// What LPIPS was computed with.
    pub lpips: String,
    /// How exposures of held-out photos were dealt with.
    pub exposure: &'static str,
    /// Iterations; null where nothing was trained.
    pub iterations: Option<u32>,
    /// Seed; null where nothing was trained.
    pub seed: Option<u32>,
}

impl Protocol {
    /// The protocol of an evaluation without training.
    pub fn new(selection: &Selection, prepared: &Prepared, networks: &Networks) -> Self {
        let larger = |[w, h]: [u32; 2], c: &Camera| [w.max(c.width), h.max(c.height)];
        Self {
            test_split: format!("the data set's own, else every {} by name", selection.eval_every),
            train_views: prepared.train.len(),
            test_views: prepared.test.len(),
            image_size: prepared.views().map(|v| &v.camera).fold([0, 0], larger),
            downscaling: "exact area average of the 8-bit photos; distorted photos resampled once to an ideal pinhole",
            background: prepared.background,
            lpips: networks.note().unwrap_or("VGG16, inputs in [0, 1]").to_owned(),
            exposure: Self::exposure(false),
            iterations: None,
            seed: None,
        }
    }

    /// How photos' exposures are dealt with where they have their own, and where not.
    pub fn exposure(own: bool) -> &'static str {
        if own { super::exposed::PROTOCOL } else { "none: pictures are scored as they are rendered" }
    }
}

/// Numbers of Gaussians.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Counts {
    /// At the start; null where nothing was trained.
    pub initial: Option<usize>,
    /// Before the first prune, or when training ended where there was none; null where nothing was trained.
    pub dense: Option<usize>,
    /// In `model.ply`, or in the model that was evaluated.
    #[serde(rename = "final")]
    pub last: usize,
}

/// Scores of the views trained on.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TrainScores {
    /// Mean PSNR in dB.
    pub psnr: Option<f64>,
}

/// Scores of one held-out view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ViewScores {
    /// The view's name.
    pub name: String,
    /// Its scores.
    #[serde(flatten)]
    pub scores: Scores,
}

/// Where the run stood at some moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Iterations done.
    pub iteration: u32,
    /// Training time until then, in seconds.
    pub seconds: f64,
    /// Mean PSNR of the held-out views, in dB; infinite, and null in JSON, where all are equal to their photos.
    #[serde(deserialize_with = "infinite_for_null")]
    pub psnr: f64,
    /// Gaussians.
    pub gaussians: usize,
}

fn infinite_for_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Option::deserialize(deserializer).map(|psnr| psnr.unwrap_or(f64::INFINITY))
}

/// One prune: what was there, what was kept, and what the blocks told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pruned {
    /// After this iteration.
    pub iteration: u32,
    /// What Gaussians were ranked by.
    pub selector: Selector,
    /// Gaussians before.
    pub before: usize,
    /// Gaussians kept.
    pub after: usize,
    /// Of these, by the detail safeguard.
    pub detail: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Edge of the finest voxels in world units.
    pub voxel: f64,
    /// Blocks of 1, 2 to 3, 4 to 7, ... members.
    pub occupancy: Vec<usize>,
    /// Blocks of which less than 1/10, 2/10, ... or up to all was kept.
    pub kept_shares: [usize; 10],
    /// Mean over blocks of the eight largest eigenvalues, each block's as shares of their sum; zeros where none was solved.
    pub spectrum: [f64; CHANNELS],
    /// Blocks by how many eigenvalues reach the threshold, 1 to 8; zeros where none was solved.
    pub modes: [usize; CHANNELS],
    /// What was repaired.
    pub guards: PruneGuards,
    /// Blocks in which the kept now stand for the dropped; null where merging was not asked for.
    pub merged: Option<Merging>,
    /// Pictures a second just before the prune; null where that was not measured.
    pub frames_per_second_before: Option<f64>,
    /// Seconds.
    pub seconds: PruneSeconds,
}

/// What a prune had to repair.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PruneGuards {
    /// Blocks whose metric was not positive definite: solved in its canonical form.
    pub canonical_blocks: usize,
    /// Blocks without any response: ranked by opacity.
    pub unseen_blocks: usize,
    /// Overlaps and responses that were not finite.
    pub repaired_values: usize,
}

/// Seconds of a prune.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PruneSeconds {
    /// The pass over the training views, where there was one.
    pub responses: f64,
    /// Normalisation and partition.
    pub partition: f64,
    /// Device: overlaps.
    pub assemble: f64,
    /// Host: blocks solved.
    pub solve: f64,
    /// Assembly and solution, side by side.
    pub assemble_and_solve: f64,
    /// From ranks to a mask.
    pub select: f64,
    /// Merging, and compaction of parameters and moments.
    pub merge: f64,
    /// All of it.
    pub total: f64,
}

impl Pruned {
    /// What a study and the choice made of it tell.
    pub fn new(iteration: u32, selector: Selector, study: &Study, choice: &Choice) -> Self {
        let blocks = &study.partitioned.blocks;
        let (mut occupancy, mut kept_shares, mut modes) = (Vec::new(), [0; 10], [0; CHANNELS]);
        let solved = study.collected.spectrum.iter().any(|l| *l > 0.0);
        for (members, r) in blocks.iter().zip(&study.collected.r) {
            let bin = members.len().max(1).ilog2() as usize;
            occupancy.resize(occupancy.len().max(bin + 1), 0);
            occupancy[bin] += 1;
            let kept = members.iter().filter(|i| choice.keep[**i as usize]).count();
            kept_shares[(10 * kept / members.len().max(1)).min(9)] += 1;
            modes[(*r as usize).clamp(1, CHANNELS) - 1] += usize::from(solved);
        }
        let c = &study.collected;
        let whole: f64 = c.spectrum.iter().sum();
        Self {
            iteration,
            selector,
            before: choice.keep.len(),
            after: choice.kept(),
            detail: choice.detail,
            blocks: blocks.len(),
            voxel: study.partitioned.voxel,
            occupancy,
            kept_shares,
            spectrum: c.spectrum.map(|l| if whole > 0.0 { l / whole } else { 0.0 }),
            modes,
            guards: PruneGuards { canonical_blocks: c.canonical, unseen_blocks: c.unseen, repaired_values: c.repaired },
            merged: None,
            frames_per_second_before: None,
            seconds: PruneSeconds {
                partition: study.seconds.partition,
                assemble: study.seconds.assemble,
                solve: study.seconds.solve,
                assemble_and_solve: study.seconds.wall,
                ..PruneSeconds::default()
            },
        }
    }
}

/// Seconds.
#[derive(Clone, Debug, Serialize)]
pub struct Times {
    /// The whole run.
    pub total_s: f64,
    /// Reading the scene and its photos.
    pub load_s: f64,
    /// Training and pruning, resumed parts included; evaluations on the way are not.
    pub train_s: f64,
    /// Pruning, a part of `train_s`.
    pub prune_s: f64,
    /// Evaluation.
    pub evaluate_s: f64,
    /// Device time of training by stage.
    pub stages_s: BTreeMap<&'static str, f64>,
}

impl Times {
    /// Device seconds by stage.
    pub fn stages(timings: &Timings) -> BTreeMap<&'static str, f64> {
        timings.iter().map(|(name, seconds, _)| (name, seconds)).collect()
    }
}

/// What was repaired, skipped or left out.
#[derive(Clone, Debug, Serialize)]
pub struct Guards {
    /// Updates skipped for gradients that were not finite.
    pub skipped_rows: u64,
    /// Gaussians of the final model that no picture shows: see [`crate::gaussians::Gaussians::undrawable`].
    pub undrawable: usize,
    /// Held-out views that rendered empty.
    pub empty_views: usize,
    /// What the scene's readers left out.
    pub scene: Skipped,
}

/// Device memory in bytes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Memory {
    /// What was expected before the start.
    pub estimated_bytes: u64,
    /// At most in use at a time.
    pub peak_bytes: u64,
    /// Allowed.
    pub limit_bytes: u64,
}

/// Bytes of a model's file, or of all files in its folder.
pub fn bytes(path: &Path) -> u64 {
    let file = |p: &Path| std::fs::metadata(p).map_or(0, |m| m.len());
    match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().map(|e| file(&e.path())).sum(),
        Err(_) => file(path),
    }
}
