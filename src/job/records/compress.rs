//! Records of a compression: its JSON, schema 1 (docs/metrics.md).

use super::aim::{Aim, Point};
use super::prune::PruneRecord;
use super::run::Memory;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::Precision;
use crate::gpu::TunedDevice;
use crate::job::config::PruneRule;
use crate::job::output::bytes_on_disk;
use crate::metrics::{Scores, mean};
use crate::render::Style;
use serde::{Deserialize, Serialize, Serializer};
use std::path::{Path, PathBuf};

/// A compression's JSON report.
#[derive(Clone, Debug, Serialize)]
pub struct CompressRecord {
    /// Version of this layout.
    pub schema: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The device.
    pub device: TunedDevice,
    /// Conditions of the measurement.
    pub protocol: CompressProtocol,
    /// The original model.
    pub input: ModelFile,
    /// The compressed model.
    pub output: ModelFile,
    /// Gaussians whose colours the file's format cuts off.
    pub clipped: usize,
    /// Gaussians whose sizes the file's format cuts off.
    pub outsized: usize,
    /// The prune: its choice, and statistics of its blocks.
    pub prune: PruneRecord,
    /// The search for a file of a wanted size or PSNR; absent if none was wanted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aim: Option<AimRecord>,
    /// Mean scores of the held-out views.
    pub test: StageScores,
    /// Each held-out view.
    pub views: Vec<ViewStages>,
    /// Seconds.
    pub time: CompressTimes,
    /// Device memory in bytes.
    pub memory: Memory,
}

/// The search for a file of a wanted size or PSNR.
#[derive(Clone, Debug, Serialize)]
pub struct AimRecord {
    /// The target.
    #[serde(flatten)]
    pub aim: Aim,
    /// True if the input's own bytes were written, because it is a file of the same format and of at most the size
    /// wanted: then no file was tried.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub original: bool,
    /// The file chosen, before fine-tuning; its PSNR is of the views that files are compared by.
    pub chosen: Point,
    /// The file written; absent without fine-tuning, where it is the one chosen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub written: Option<Point>,
    /// The effect of fine-tuning on the file; absent without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fine_tuning: Option<FineTuning>,
    /// Precision of the values of the file written.
    pub precision: Precision,
    /// Rungs of the format's ladder of settings.
    pub rungs: usize,
    /// The files tried.
    pub tried: Vec<Point>,
}

/// The effect of fine-tuning on the file of a search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FineTuning {
    /// True if the tuned file was written; false if it was worse than the one without fine-tuning, which was written instead.
    pub written: bool,
    /// PSNR of the tuned file in dB, the mean of the held-out views, or, without any, of those that files are compared by; null if pictures are
    /// equal.
    pub psnr: f64,
    /// The same of the file without fine-tuning.
    pub psnr_without: f64,
}

/// Conditions of the measurement.
#[derive(Clone, Debug, Serialize)]
pub struct CompressProtocol {
    /// Ground truth of the scores.
    pub truth: Truth,
    /// Views used for responses and fine-tuning.
    pub train_views: usize,
    /// Views held out.
    pub test_views: usize,
    /// Largest picture, width and height.
    pub image_size: [u32; 2],
    /// Background colour.
    pub background: [f32; 3],
    /// Effects that pictures were rendered with.
    #[serde(flatten)]
    pub style: Style,
    /// Treatment of photos' exposures.
    pub exposure: &'static str,
    /// Iterations of fine-tuning.
    pub fine_tune: u32,
    /// Key of all random numbers.
    pub seed: u32,
    /// Choice of Gaussians.
    pub compression: PruneRule,
}

/// Ground truth of the scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Truth {
    /// A scene's photos.
    Photos,
    /// The original model's own pictures.
    OwnPictures,
}

/// A model on disk.
#[derive(Clone, Debug, Serialize)]
pub struct ModelFile {
    /// Path.
    #[serde(serialize_with = "lossy")]
    pub path: PathBuf,
    /// Size in bytes.
    pub bytes: u64,
    /// Gaussians.
    pub gaussians: usize,
    /// Degree of the spherical harmonics.
    pub sh_degree: usize,
}

impl ModelFile {
    /// A model and its file.
    pub fn of(path: &Path, model: &Gaussians) -> Self {
        Self { path: path.to_owned(), bytes: bytes_on_disk(path), gaussians: model.len(), sh_degree: model.degree() }
    }
}

/// Scores at each stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageScores {
    /// Scores of the original model; null if its own pictures are the truth, or without held-out views.
    pub before: Option<Scores>,
    /// Scores after the prune; null without held-out views, and if a divided compression wrote a format that rounds
    /// values.
    pub pruned: Option<Scores>,
    /// Scores after fine-tuning; null if there was none.
    pub fine_tuned: Option<Scores>,
    /// Scores of the file as it is read back; null if a divided compression wrote a format that stores floats.
    #[serde(default)]
    pub written: Option<Scores>,
}

impl StageScores {
    /// The means of the views' scores.
    pub fn mean(views: &[ViewStages]) -> Self {
        let over = |stage: fn(&StageScores) -> &Option<Scores>| {
            mean(&views.iter().filter_map(|v| stage(&v.scores).clone()).collect::<Vec<_>>())
        };
        Self {
            before: over(|s| &s.before),
            pruned: over(|s| &s.pruned),
            fine_tuned: over(|s| &s.fine_tuned),
            written: over(|s| &s.written),
        }
    }
}

/// A held-out view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewStages {
    /// Its name.
    pub name: String,
    /// Its scores.
    #[serde(flatten)]
    pub scores: StageScores,
}

/// Seconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct CompressTimes {
    /// Total.
    pub total_s: f64,
    /// Reading the model, and finding the origin of its scene.
    pub read_s: f64,
    /// Reading photos, or drawing the original's own pictures.
    pub truth_s: f64,
    /// The pass over the views that gives responses.
    pub responses_s: f64,
    /// Choosing the Gaussians, from the partition to the keep mask.
    pub keep_mask_s: f64,
    /// Merging dropped Gaussians into kept ones.
    pub merge_s: f64,
    /// Fine-tuning.
    pub fine_tune_s: f64,
    /// Scoring held-out views.
    pub evaluate_s: f64,
    /// Writing the model.
    pub write_s: f64,
}

/// Serialises a path; bytes of its name that are not UTF-8 are replaced.
fn lossy<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}
