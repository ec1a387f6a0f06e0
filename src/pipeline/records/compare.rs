//! Records of a comparison: `compare.json`, schema 1, each arm's `arm.json`, and the table as `compare.csv`.

use super::prune::PruneRecord;
use super::run::ViewScores;
use crate::gpu::TunedDevice;
use serde::{Deserialize, Serialize};

/// Results of one arm.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Its name.
    pub name: String,
    /// Mean PSNR of the held-out views in dB; null if all are equal or there are none.
    pub psnr: Option<f64>,
    /// Mean SSIM of the held-out views.
    pub ssim: Option<f64>,
    /// Mean LPIPS (VGG) of the held-out views; null without weights.
    pub lpips_vgg: Option<f64>,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// Share of the Gaussians at the prune point that were removed.
    pub removed: f64,
    /// Bytes of its `model.ply`.
    pub ply_bytes: u64,
    /// Frames per second: the median of rounds in which the arms took turns.
    pub fps: Option<f64>,
    /// Seconds of training and pruning, from the beginning.
    pub seconds: f64,
    /// PSNR right after the prune, before any fine-tuning; null for the dense arm.
    pub psnr_pruned: Option<f64>,
    /// Its prunes.
    pub prunes: Vec<PruneRecord>,
    /// Scores by view.
    pub views: Vec<ViewScores>,
}

/// Results of a comparison: `compare.json`.
#[derive(Clone, Debug, Serialize)]
pub struct CompareRecord {
    /// Version of this layout.
    pub schema: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The device.
    pub device: TunedDevice,
    /// The scene.
    pub scene: String,
    /// Iterations of every arm.
    pub iterations: u32,
    /// The iteration at which the arms fork.
    pub prune_point: u32,
    /// Gaussians at the prune point.
    pub gaussians: usize,
    /// The arms, in the order of the request.
    pub arms: Vec<ArmRecord>,
}

impl CompareRecord {
    /// The table as comma-separated values: one line per arm.
    pub fn csv(&self) -> String {
        let cell = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        let mut text = "name,psnr,ssim,lpips_vgg,gaussians,removed,ply_bytes,fps,seconds,psnr_pruned\n".to_owned();
        for a in &self.arms {
            let scores = [cell(a.psnr), cell(a.ssim), cell(a.lpips_vgg)].join(",");
            text += &format!("{},{scores},{},{:.4},{},", a.name, a.gaussians, a.removed, a.ply_bytes);
            text += &format!("{},{:.1},{}\n", cell(a.fps), a.seconds, cell(a.psnr_pruned));
        }
        text
    }
}
