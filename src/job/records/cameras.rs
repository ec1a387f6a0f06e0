//! Errors of held-out photos' cameras.

use crate::effects::MOVED;
use serde::{Deserialize, Serialize};

/// PSNR in dB of held-out photos below which a model is no witness: cameras then fit what it gets wrong.
const WITNESS: f64 = 17.0;

/// Errors of the cameras of held-out photos, as a model shows them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraErrors {
    /// Number of photos looked at.
    pub views: usize,
    /// Median over the photos of how far the fitted camera moves the picture, in pixels (root mean square over a photo).
    pub pixels: f64,
    /// Mean PSNR of every other square of 8 x 8 pixels with the given cameras, in dB.
    pub psnr: f64,
    /// The same with cameras fitted to the other squares.
    pub fitted_psnr: f64,
}

impl CameraErrors {
    /// Returns true if the model shows enough of the photos to be believed.
    pub fn tells(&self) -> bool {
        self.psnr >= WITNESS
    }

    /// A sentence for a user whose poses limit the result; none if they do not. It has no advice if `known`: where cameras are
    /// corrected already, or nothing is trained.
    pub fn note(&self, known: bool) -> Option<String> {
        let Self { pixels, psnr, fitted_psnr, .. } = *self;
        let advice = if known { "" } else { "; --effect poses=on corrects those of the training photos" };
        (self.tells() && pixels.min(fitted_psnr - psnr) >= MOVED).then(|| {
            format!(
                "the poses are inaccurate: held-out photos have {psnr:.2} dB, and {fitted_psnr:.2} dB if their cameras \
                 move by {pixels:.1} pixels (median){advice}"
            )
        })
    }
}
