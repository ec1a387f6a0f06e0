//! Records of a run: `metrics.json`, schema 1 (docs/metrics.md).

use super::cameras::CameraErrors;
use super::floaters::FloaterCounts;
use super::prune::PruneRecord;
use crate::effects::Decision;
use crate::gpu::TunedDevice;
use crate::metrics::Scores;
use crate::scene::Skipped;
use crate::train::method::Cut;
use crate::wording::counted;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// The contents of `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct RunRecord {
    /// Version of this layout.
    pub schema: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The device.
    pub device: TunedDevice,
    /// Conditions of the measurement.
    pub protocol: Protocol,
    /// Numbers of Gaussians.
    pub gaussians: Counts,
    /// Mean scores of the held-out views of which something counts; null without any.
    pub test: Option<Scores>,
    /// Mean PSNR of the whole held-out views as rendered, without fitted exposures, in dB; null if
    /// `test` has it already.
    #[serde(rename = "test_unfitted_psnr")]
    pub unfitted_psnr: Option<f64>,
    /// Mean PSNR of the training views, in dB.
    pub train: TrainScores,
    /// Scores of each held-out view.
    pub views: Vec<ViewScores>,
    /// Errors of the held-out views' cameras; null without any.
    pub camera_errors: Option<CameraErrors>,
    /// Pictures per second, rendering alone, of up to 20 views at their own sizes.
    pub frames_per_second: Option<f64>,
    /// Bytes of `model.ply`, or of the file that was evaluated.
    #[serde(rename = "ply_bytes")]
    pub model_bytes: u64,
    /// Each prune, in order; empty if nothing was pruned.
    pub prunes: Vec<PruneRecord>,
    /// The floaters removed in the end; absent if none were looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floaters: Option<FloaterCounts>,
    /// The cut that a method ended with; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut: Option<Cut>,
    /// Quality against time, evaluation excluded.
    pub curve: Vec<CurvePoint>,
    /// Seconds.
    pub time: Times,
    /// The decision on each effect, with the evidence; empty for an evaluation.
    pub effects: Vec<Decision>,
    /// Counts of what was repaired, skipped or left out.
    pub guards: Guards,
    /// Device memory in bytes.
    pub memory: Memory,
}

/// Conditions of the measurement.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Protocol {
    /// Rule for holding out views.
    pub test_split: String,
    /// Number of training views.
    pub train_views: usize,
    /// Number of held-out views.
    pub test_views: usize,
    /// Largest picture, width and height.
    pub image_size: [u32; 2],
    /// Method that scaled photos to that size.
    pub downscaling: &'static str,
    /// Background colour.
    pub background: [f32; 3],
    /// Weights of LPIPS.
    pub lpips: String,
    /// Treatment of held-out photos' exposures.
    pub exposure: &'static str,
    /// Iterations; null if nothing was trained.
    pub iterations: Option<u32>,
    /// Seed; null if nothing was trained.
    pub seed: Option<u32>,
}

/// Numbers of Gaussians.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Counts {
    /// At the start; null if nothing was trained.
    pub initial: Option<usize>,
    /// Before the first prune, or at the end of training if there was none; null if nothing was trained.
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// The view's name.
    pub name: String,
    /// Its scores.
    #[serde(flatten)]
    pub scores: Scores,
}

impl ViewScores {
    /// Number of these views of which something counts: the means are theirs.
    pub fn counting(views: &[Self]) -> usize {
        views.iter().filter(|view| view.scores.counts()).count()
    }
}

/// A point of the quality curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Iterations done.
    pub iteration: u32,
    /// Training time until then, in seconds.
    pub seconds: f64,
    /// Mean PSNR of the held-out views, in dB; infinite, and null in JSON, if all are equal to their photos.
    #[serde(deserialize_with = "infinite_for_null")]
    pub psnr: f64,
    /// The same of training views, of as many as are held out, evenly spread; null if it was not measured.
    #[serde(default)]
    pub train_psnr: Option<f64>,
    /// Gaussians.
    pub gaussians: usize,
}

/// Loss since the best PSNR of a run, in dB, from which it is reported.
const PAST: f64 = 0.1;

/// The best point of a curve with no more Gaussians than at its end, if it is well above that and above `end` in dB.
fn best_before(curve: &[CurvePoint], end: f64) -> Option<&CurvePoint> {
    let last = curve.last()?;
    let as_small = curve.iter().filter(|p| p.gaussians <= last.gaussians);
    let best = as_small.max_by(|a, b| a.psnr.total_cmp(&b.psnr))?;
    (best.psnr - last.psnr.max(end) >= PAST).then_some(best)
}

impl RunRecord {
    /// The best point of the quality curve with no more Gaussians than at the end, if the run ended well below it:
    /// training longer was a loss. If the end is no loss, the same up to the last point with the most Gaussians, from
    /// which prunes begin, unless the end makes up for it.
    fn past_best(&self) -> Option<&CurvePoint> {
        let largest = self.curve.iter().enumerate().max_by_key(|(_, p)| p.gaussians)?.0;
        let end = self.curve.last()?.psnr;
        best_before(&self.curve, end).or_else(|| best_before(&self.curve[..=largest], end))
    }

    /// A phrase on a run that ended well below the best point of its quality curve; each with its number of Gaussians.
    pub fn told_past_best(&self) -> Option<String> {
        Some(told(self.past_best()?, self.curve.last()?))
    }
}

fn told(best: &CurvePoint, end: &CurvePoint) -> String {
    format!(
        "past its best: after iteration {} held-out views had {:.2} dB, with {}, and at the end {:.2} dB, with {}",
        best.iteration,
        best.psnr,
        counted(best.gaussians, "Gaussian"),
        end.psnr,
        counted(end.gaussians, "Gaussian"),
    )
}

fn infinite_for_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Option::deserialize(deserializer).map(|psnr| psnr.unwrap_or(f64::INFINITY))
}

/// Reads a list in which infinity stands as null.
///
/// # Errors
/// Values that are neither numbers nor null.
pub fn infinite_for_nulls<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let values = Vec::<Option<f64>>::deserialize(deserializer)?;
    Ok(values.into_iter().map(|psnr| psnr.unwrap_or(f64::INFINITY)).collect())
}

/// Seconds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Times {
    /// From the opening of the scene until the pictures of its report are made, including resumed parts.
    pub total_s: f64,
    /// Reading the scene and its photos.
    pub load_s: f64,
    /// From there until training starts: decisions on effects, with their trial, and the trainer's start.
    pub start_s: f64,
    /// Training and pruning, including resumed parts, without evaluations on the way.
    pub train_s: f64,
    /// Pruning, a part of `train_s`.
    pub prune_s: f64,
    /// Evaluations on the way: the curve, and frame rates before prunes.
    pub curve_s: f64,
    /// Evaluation at the end, with the pictures of held-out views.
    pub evaluate_s: f64,
    /// Writing the other files: the model, checkpoints, and the photos and dense pictures for the report.
    pub write_s: f64,
    /// Encoding the report's pictures, and its viewer; 0 without a report.
    pub report_s: f64,
    /// Device time of training by stage.
    pub stages_s: BTreeMap<&'static str, f64>,
}

impl Times {
    /// Adds the time of a report that is made after the run.
    pub fn add_report(&mut self, time: Duration) {
        self.report_s = time.as_secs_f64();
        self.total_s += self.report_s;
    }
}

/// Counts of what was repaired, skipped or left out.
#[derive(Clone, Debug, Serialize)]
pub struct Guards {
    /// Updates skipped because gradients were not finite.
    pub skipped_rows: u64,
    /// Gaussians of the final model that pictures leave out or may leave out: see [`crate::gaussians::Gaussians::undrawable`].
    pub undrawable: usize,
    /// Held-out views that rendered empty.
    pub empty_views: usize,
    /// Parts that the scene's readers left out.
    pub scene: Skipped,
}

/// Device memory in bytes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Memory {
    /// Estimated before the start.
    pub estimated_bytes: u64,
    /// Largest amount in use at a time.
    pub peak_bytes: u64,
    /// Limit.
    pub limit_bytes: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before the prune the PSNR may have been higher still: the best is that of as few Gaussians.
    #[test]
    fn the_best_is_told_with_its_gaussians() {
        let point =
            |(iteration, psnr, gaussians)| CurvePoint { iteration, seconds: 0.0, psnr, train_psnr: None, gaussians };
        let curve = [(100, 31.0, 5000), (200, 28.0, 1400), (300, 27.5, 1400)].map(point);
        let best = best_before(&curve, 27.5).unwrap();
        assert_eq!(
            told(best, &curve[2]),
            "past its best: after iteration 200 held-out views had 28.00 dB, with 1400 Gaussians, and at the end 27.50 dB, \
             with 1400 Gaussians"
        );
    }
}
