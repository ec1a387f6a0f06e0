//! Learnt masks: hiding masked Gaussians, and gradients by masks and by their scores.

use super::densify::hash;
use super::project::sigmoid;
use super::rasterise::rasterise;
use super::rasterise_backward::ImageGradient;
use super::{Rendered, Settings};
use crate::scene::camera::Camera;
use glam::DVec3;

/// Random number added to a score if masks are drawn: standard logistic, by key.
pub fn logistic(key: [u32; 3]) -> f64 {
    let bits = [key[0], key[1], key[2], 4].into_iter().rev().fold(0, |h, k| hash(k ^ h));
    let u = (f64::from(bits >> 9) + 0.5) / f64::from(1 << 23);
    (u / (1.0 - u)).ln()
}

/// Whether a mask is 1: with a random number, if the score plus that is positive; otherwise if the sigmoid of the score
/// exceeds 0.01.
pub fn shows(score: f64, random: Option<f64>) -> bool {
    random.map_or_else(|| sigmoid(score) > 0.01, |r| score + r > 0.0)
}

/// Gradient by the mask of every Gaussian, if a mask multiplies alpha. A picture is linear in each mask alone, so the
/// slope is the difference between the pictures with and without the Gaussian. Stops break this and must be off.
pub fn gradients(
    rendered: &Rendered,
    shown: &[bool],
    camera: &Camera,
    settings: &Settings,
    gradient: ImageGradient<'_>,
) -> Vec<f64> {
    let loss = |shown: &[bool]| -> f64 {
        let mut projected = rendered.projected.clone();
        for (p, _) in projected.iter_mut().zip(shown).filter(|(_, shown)| !**shown) {
            *p = Err(super::project::Culled::Faint);
        }
        let picture = rasterise(&projected, &rendered.tiles, camera, settings);
        let colours: f64 =
            picture.image.iter().zip(gradient.colour).map(|(c, g)| DVec3::from(*c).dot(DVec3::from(*g))).sum();
        let by_alpha = gradient.alpha.map_or(0.0, |g| picture.alpha.iter().zip(g).map(|(a, g)| a * g).sum());
        colours + by_alpha
    };
    let one = |i: usize| {
        let with = |on: bool| {
            let mut masks = shown.to_vec();
            masks[i] = on;
            loss(&masks)
        };
        with(true) - with(false)
    };
    (0..shown.len()).map(one).collect()
}

/// Gradient by a score, from the gradient by its mask: the mask is taken to change as its sigmoid does. `weight` is
/// that of the masks' mean in the loss, or of its square if masks are drawn at random; `mean` is the mean of `n` masks.
pub fn by_score(slope: f64, score: f64, random: Option<f64>, weight: f64, [mean, n]: [f64; 2]) -> f64 {
    let soft = score + random.unwrap_or(0.0);
    let by_mean = if random.is_some() { 2.0 * weight * mean } else { weight };
    (slope + by_mean / n) * sigmoid(soft) * sigmoid(-soft)
}
