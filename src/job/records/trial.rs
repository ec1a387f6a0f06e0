//! A short training ahead of a run.

use super::CameraErrors;
use serde::{Deserialize, Serialize};

/// What a short training tells of photos that it withheld.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Length of the training in iterations.
    pub iterations: u32,
    /// Errors of the withheld photos' cameras; none if nothing of the photos counts.
    pub cameras: Option<CameraErrors>,
}
