//! Errors of held-out photos' cameras.

use crate::effects::MOVED;
use serde::{Deserialize, Serialize};

/// PSNR in dB of held-out photos below which a model is no witness: cameras then fit what it gets wrong.
const WITNESS: f64 = 17.0;
/// Iterations per training photo below which a model is no witness: moved cameras then fit what it has not learnt yet.
const LEARNT: f64 = 30.0;

/// Errors of the cameras of held-out photos, as a model shows them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraErrors {
    /// Number of photos looked at.
    pub views: usize,
    /// Median over the photos, the upper one of two, of how far the fitted camera moves the picture, in pixels (root mean square over a photo).
    pub pixels: f64,
    /// Mean PSNR of every other square of 8 x 8 pixels with the given cameras, in dB, over views with finite ones.
    pub psnr: f64,
    /// The same with cameras fitted to the other squares.
    pub fitted_psnr: f64,
}

impl CameraErrors {
    /// Returns true if the model shows enough of the photos to be believed.
    pub fn tells(&self) -> bool {
        self.psnr >= WITNESS
    }

    /// A sentence for a user whose poses may limit the result; none if they do not. `passes` is the length of the training in
    /// iterations per training photo, where it is known. There is no advice if `known`: where cameras are corrected already, or
    /// nothing is trained.
    pub fn note(&self, passes: Option<f64>, known: bool) -> Option<String> {
        let Self { pixels, psnr, fitted_psnr, .. } = *self;
        let advice = if known { "" } else { "; --effect poses=on corrects those of the training photos" };
        let is_witness = self.tells() && passes.is_none_or(|passes| passes >= LEARNT);
        (is_witness && pixels >= MOVED && fitted_psnr - psnr >= MOVED).then(|| {
            format!(
                "the poses may be inaccurate, or the training was too short: held-out photos have {psnr:.2} dB, and \
                 {fitted_psnr:.2} dB if their cameras move by {pixels:.1} pixels (median){advice}"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_training_says_nothing_about_poses() {
        let errors = CameraErrors { views: 2, pixels: 0.5, psnr: 17.18, fitted_psnr: 17.69 };
        let told = [None, Some(20.0 / 14.0), Some(30.0)].map(|passes| errors.note(passes, false).is_some());
        assert_eq!(told, [true, false, true]);
        let equal = CameraErrors { psnr: f64::INFINITY, fitted_psnr: f64::INFINITY, ..errors };
        assert_eq!(equal.note(None, false), None);
        assert!(errors.note(None, true).is_some_and(|note| note.contains("or the training was too short")));
    }
}
