//! What a run measured: `metrics.json`, schema 1 (docs/metrics.md).

use super::config::Selection;
use super::output::Output;
use super::prepare::Prepared;
use crate::error::Error;
use crate::gpu::{DeviceInfo, Timings};
use crate::metrics::{Networks, Scores};
use crate::scene::Skipped;
use crate::scene::camera::Camera;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
    /// Mean PSNR of the training views, in dB.
    pub train: TrainScores,
    /// Scores of each held-out view.
    pub views: Vec<ViewScores>,
    /// Pictures a second at the test views' size, rendering alone.
    pub frames_per_second: Option<f64>,
    /// Bytes of `model.ply`, or of the file that was evaluated.
    #[serde(rename = "ply_bytes")]
    pub model_bytes: u64,
    /// Quality against time, evaluation excluded.
    pub curve: Vec<CurvePoint>,
    /// Seconds.
    pub time: Times,
    /// Effects that this run simulated; none are detected yet.
    pub effects: Vec<String>,
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
        let json = serde_json::to_string_pretty(self).map_err(|e| Error::Usage(format!("metrics.json: {e}")))?;
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
            iterations: None,
            seed: None,
        }
    }
}

/// Numbers of Gaussians.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Counts {
    /// At the start; null where nothing was trained.
    pub initial: Option<usize>,
    /// When training ended, before any pruning; null where nothing was trained.
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
#[derive(Clone, Debug, Serialize)]
pub struct ViewScores {
    /// The view's name.
    pub name: String,
    /// Its scores.
    #[serde(flatten)]
    pub scores: Scores,
}

/// Where the run stood at some moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Iterations done.
    pub iteration: u32,
    /// Training time until then, in seconds.
    pub seconds: f64,
    /// Mean PSNR of the held-out views, in dB.
    pub psnr: f64,
    /// Gaussians.
    pub gaussians: usize,
}

/// Seconds.
#[derive(Clone, Debug, Serialize)]
pub struct Times {
    /// The whole run.
    pub total_s: f64,
    /// Reading the scene and its photos.
    pub load_s: f64,
    /// Training alone, resumed parts included.
    pub train_s: f64,
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
