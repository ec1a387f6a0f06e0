//! A short training ahead of a run.

use super::CameraErrors;
use serde::{Deserialize, Serialize};

/// Findings of a short training about the photos that it withheld.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Length of the training in iterations.
    pub iterations: u32,
    /// Mean PSNR in dB of the withheld photos' right halves, with colours fitted to the left ones: after a training without and one with
    /// an exposure of each photo. None if something else told of exposures, or if nothing of the photos counts.
    pub exposures: Option<[f64; 2]>,
    /// Errors of the withheld photos' cameras; none if nothing of the photos counts.
    pub cameras: Option<CameraErrors>,
}
