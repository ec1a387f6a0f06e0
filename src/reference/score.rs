//! Scores of other pruning methods, for one view.

use super::respond::each_sample;
use super::{Params, Settings};
use crate::scene::camera::Camera;

/// Scores of a view; n rows: sum of T alpha, its largest, pixels that blend the Gaussian, sum of opacity x T.
pub fn score(params: &Params, camera: &Camera, settings: &Settings) -> Vec<[f64; 4]> {
    let mut scores = vec![[0.0_f64; 4]; params.len()];
    each_sample(params, camera, settings, |i, _, opacity, alpha, transmittance| {
        let (score, weight) = (&mut scores[i], transmittance * alpha);
        score[0] += weight;
        score[1] = score[1].max(weight);
        score[2] += 1.0;
        score[3] += opacity * transmittance;
    });
    scores
}
