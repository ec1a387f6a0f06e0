//! Records of quality against bytes: `curve.json`, schema 1 (docs/metrics.md).

use super::{CompressProtocol, ModelFile};
use crate::gpu::TunedDevice;
use crate::metrics::Scores;
use serde::{Deserialize, Serialize};

/// Quality against bytes.
#[derive(Clone, Debug, Serialize)]
pub struct CurveRecord {
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
    /// The files, by tool and format.
    pub files: Vec<FileRecord>,
    /// The loss by the settings of each attribute alone.
    pub attributes: Vec<AttributeLoss>,
}

/// A file and its pictures.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FileRecord {
    /// The program that made it.
    pub tool: String,
    /// Extension of its format.
    pub format: String,
    /// Bytes that were asked for; null if a share of the Gaussians was.
    pub wanted: Option<u64>,
    /// Bytes.
    pub bytes: u64,
    /// Gaussians.
    pub gaussians: usize,
    /// Mean scores of the held-out views.
    pub scores: Scores,
    /// Bytes of each attribute, by name; empty for formats that keep a Gaussian's attributes together.
    #[serde(skip_deserializing)]
    pub parts: Vec<(&'static str, u64)>,
}

/// The loss of the whole model's pictures if only one attribute is stored as in a file.
#[derive(Clone, Debug, Serialize)]
pub struct AttributeLoss {
    /// Extension of the format.
    pub format: String,
    /// Bytes that were asked for: the attribute is stored as finely as in that file.
    pub wanted: u64,
    /// The attribute.
    pub attribute: &'static str,
    /// PSNR in dB; null if pictures are equal.
    pub psnr: Option<f64>,
}

impl CurveRecord {
    /// The files as comma-separated values, with a line of titles.
    pub fn csv(&self) -> String {
        let number = |v: Option<f64>, places: usize| v.map_or_else(String::new, |v| format!("{v:.places$}"));
        let mut lines = vec!["tool,format,wanted_bytes,bytes,gaussians,psnr_db,ssim,lpips_vgg".to_owned()];
        lines.extend(self.files.iter().map(|file| {
            let FileRecord { tool, format, wanted, bytes, gaussians, scores, .. } = file;
            let wanted = wanted.map_or_else(String::new, |w| w.to_string());
            let [psnr, lpips] = [scores.psnr, scores.lpips_vgg].map(|v| number(v, 4));
            let ssim = number(scores.ssim, 5);
            format!("{tool},{format},{wanted},{bytes},{gaussians},{psnr},{ssim},{lpips}")
        }));
        lines.join("\n") + "\n"
    }
}
