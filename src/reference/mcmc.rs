//! Growth by relocation, in every iteration: slopes of opacities and scales, and noise.

use super::densify::normals;
use super::project::{rotation, sigmoid};
use glam::DVec3;

/// Additions to the gradients by the logit and by the log-scales: the gradients of `opacity` times the opacity and of
/// `scale` times the sum of the scales.
pub fn regularise(logit: f64, log_scales: [f64; 3], opacity: f64, scale: f64) -> (f64, [f64; 3]) {
    let shown = sigmoid(logit);
    (opacity * shown * (1.0 - shown), log_scales.map(|s| scale * s.exp()))
}

/// The random step of Gaussian `row`: `factor` times its covariance times a normal vector, times a logistic function of
/// its opacity, which is 1/2 at 0.005 and falls to almost 0 within some hundredths. `None` if a value is not finite.
pub fn noise(
    logit: f64,
    log_scales: [f64; 3],
    stored: [f64; 4],
    factor: f64,
    [seed, iteration, row]: [u32; 3],
) -> DVec3 {
    let length = stored.iter().map(|q| q * q).sum::<f64>().sqrt();
    let turn = rotation(stored.map(|q| q / length));
    let [x, y] = normals([seed, iteration, row, 2]);
    let draw = DVec3::new(x, y, normals([seed, iteration, row, 3])[0]);
    let variances = DVec3::from(log_scales.map(|s| (2.0 * s).exp()));
    factor * sigmoid(-100.0 * (sigmoid(logit) - 0.005)) * (turn * (variances * (turn.transpose() * draw)))
}
