//! Records of a comparison: `compare.json`, schema 1, each arm's `arm.json`, and the table as `compare.csv`.

use super::Paired;
use crate::gpu::TunedDevice;
use crate::job::records::{PruneRecord, ViewScores};
use crate::pipeline::evaluate::mean;
use crate::train::method::Cut;
use serde::{Deserialize, Serialize};

/// Results of one arm.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Its name.
    pub name: String,
    /// Mean PSNR of the held-out views in dB; null if all are equal or there are none.
    pub psnr: Option<f64>,
    /// Standard deviation, in dB, of the PSNRs of several seeds; null if one of them has none.
    #[serde(default)]
    pub psnr_spread: Option<f64>,
    /// PSNR with each of several seeds, in their order.
    #[serde(default)]
    pub psnr_by_seed: Vec<Option<f64>>,
    /// PSNR with each of several seeds of each held-out view.
    #[serde(default)]
    pub psnr_by_view: Vec<Vec<Option<f64>>>,
    /// Its difference from the first arm; null for that one, and without held-out views.
    #[serde(default)]
    pub paired: Option<Paired>,
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
    /// The cut that ended its method; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut: Option<Cut>,
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
    /// The seeds; figures of arms are means over them, prunes and views are those of the first.
    pub seeds: Vec<u32>,
    /// The iteration at which the arms fork.
    pub prune_point: u32,
    /// Gaussians at the prune point.
    pub gaussians: usize,
    /// The arms, in the order of the request.
    pub arms: Vec<ArmRecord>,
}

/// Mean and sample standard deviation of values; `None` unless all values exist, and no deviation for fewer than two.
fn statistics(values: &[Option<f64>]) -> (Option<f64>, Option<f64>) {
    let Some(values) = values.iter().copied().collect::<Option<Vec<f64>>>().filter(|v| !v.is_empty()) else {
        return (None, None);
    };
    (mean(&values), deviation(&values))
}

/// Sample standard deviation; none of fewer than two values.
pub(super) fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() as f64 - 1.0)).sqrt())
}

impl ArmRecord {
    /// This arm's record with means over `of`, the same arm with each seed.
    fn mean(self, of: &[&Self]) -> Self {
        let option = |value: fn(&Self) -> Option<f64>| of.iter().map(|a| value(a)).collect::<Vec<_>>();
        let mean = |value: fn(&Self) -> Option<f64>| statistics(&option(value)).0;
        let number = |value: fn(&Self) -> f64| of.iter().map(|a| value(a)).sum::<f64>() / of.len() as f64;
        Self {
            psnr: mean(|a| a.psnr),
            psnr_spread: statistics(&option(|a| a.psnr)).1,
            psnr_by_seed: option(|a| a.psnr),
            psnr_by_view: of.iter().map(|a| a.views.iter().map(|view| view.scores.psnr).collect()).collect(),
            ssim: mean(|a| a.ssim),
            lpips_vgg: mean(|a| a.lpips_vgg),
            psnr_pruned: mean(|a| a.psnr_pruned),
            fps: mean(|a| a.fps),
            gaussians: number(|a| a.gaussians as f64).round() as usize,
            removed: number(|a| a.removed),
            ply_bytes: number(|a| a.ply_bytes as f64).round() as u64,
            seconds: number(|a| a.seconds),
            ..self
        }
    }
}

impl CompareRecord {
    /// Returns true if each seed has a folder of its own.
    pub fn by_seed(&self) -> bool {
        self.arms.iter().any(|a| !a.psnr_by_seed.is_empty())
    }

    /// The folder of seed `seed` inside that of a comparison with several seeds.
    pub fn folder_of(seed: u32) -> String {
        format!("seed-{seed}")
    }

    /// This comparison merged with `others`, the same arms with other seeds, into one with means.
    #[must_use]
    pub fn mean(&self, others: &[Self]) -> Self {
        let all = || std::iter::once(self).chain(others);
        let arm = |k: usize, first: &ArmRecord| {
            let seeds: Vec<&ArmRecord> = all().filter_map(|c| c.arms.get(k)).collect();
            first.clone().mean(&seeds)
        };
        Self {
            seeds: all().flat_map(|c| c.seeds.clone()).collect(),
            gaussians: all().map(|c| c.gaussians).sum::<usize>() / (others.len() + 1),
            arms: self.arms.iter().enumerate().map(|(k, first)| arm(k, first)).collect(),
            ..self.clone()
        }
        .with_differences()
    }

    /// This comparison with the difference of each arm from the first one.
    #[must_use]
    pub fn with_differences(mut self) -> Self {
        if let Some((first, others)) = self.arms.split_first_mut() {
            first.paired = None;
            for arm in others {
                arm.paired = Paired::of(arm, first);
            }
        }
        self
    }

    /// The table as comma-separated values: one line per arm.
    pub fn csv(&self) -> String {
        let cell = |v: Option<f64>| v.filter(|v| v.is_finite()).map(|v| v.to_string()).unwrap_or_default();
        let mut text = "name,psnr,psnr_spread,ssim,lpips_vgg,gaussians,removed,ply_bytes,fps,seconds,psnr_pruned,\
             difference,difference_error,tie\n"
            .to_owned();
        for a in &self.arms {
            let scores = [a.psnr, a.psnr_spread, a.ssim, a.lpips_vgg].map(cell).join(",");
            text += &format!("{},{scores},{},{:.4},{},", a.name, a.gaussians, a.removed, a.ply_bytes);
            let [difference, error] = [a.paired.map(|p| p.difference), a.paired.and_then(|p| p.error)].map(cell);
            let tie = a.paired.map_or_else(String::new, |p| p.tie.to_string());
            text += &format!("{},{:.1},{},{difference},{error},{tie}\n", cell(a.fps), a.seconds, cell(a.psnr_pruned));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::statistics;

    #[test]
    fn means_and_sample_deviations() {
        assert_eq!(statistics(&[Some(30.0), Some(32.0), Some(31.0)]), (Some(31.0), Some(1.0)));
        assert_eq!(statistics(&[Some(30.0)]), (Some(30.0), None));
        assert_eq!((statistics(&[Some(30.0), None]), statistics(&[])), ((None, None), (None, None)));
    }
}
