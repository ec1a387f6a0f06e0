//! Wanted and tried sizes of a file.

use serde::Serialize;

/// The target for a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aim {
    /// The highest PSNR in at most this many bytes.
    Bytes(u64),
    /// The fewest bytes for at least this PSNR in dB, the mean over views.
    Psnr(f64),
}

/// A file that was tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Rung of the settings; 0 is the coarsest.
    pub rung: usize,
    /// Gaussians.
    pub gaussians: usize,
    /// Bytes of the file.
    pub bytes: u64,
    /// PSNR in dB, if it was measured; null if pictures are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr: Option<f64>,
}
