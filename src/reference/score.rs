//! Scores of each Gaussian, for one view.

use glam::DVec3;

use super::respond::{Sample, each_sample};
use super::{Params, Settings};
use crate::scene::camera::Camera;

/// Scores of a Gaussian in a view; [`crate::response::Score`] explains each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of w = T alpha, its largest value, the number of pixels that blend the Gaussian, the sum of opacity x T.
    pub weights: [f64; 4],
    /// Sums of w^2, of |phi|^2, and of phi . residual.
    pub changes: [f64; 3],
    /// Sum of w b, b the colour behind.
    pub behind: [f64; 3],
}

/// Scores of a view, n. `residual` is the picture minus its photo, by pixel.
pub fn score(params: &Params, camera: &Camera, settings: &Settings, residual: &[[f64; 3]]) -> Vec<Score> {
    let mut scores = vec![Score::default(); params.len()];
    each_sample(params, camera, settings, |sample| {
        let Sample { weight, behind, phi, .. } = *sample;
        let score = &mut scores[sample.gaussian];
        let [contribution, peak, hits, significance] = &mut score.weights;
        *contribution += weight;
        *peak = peak.max(weight);
        *hits += 1.0;
        *significance += sample.opacity * sample.transmittance;
        let residual = DVec3::from(residual[sample.pixel]);
        for (sum, term) in score.changes.iter_mut().zip([weight * weight, phi.length_squared(), phi.dot(residual)]) {
            *sum += term;
        }
        for (sum, term) in score.behind.iter_mut().zip(behind.to_array()) {
            *sum += term;
        }
    });
    scores
}
