//! Dropout: which Gaussians a picture leaves out.

use super::densify::hash;

/// Whether the picture of an iteration leaves Gaussian `i` out, with `share` as the chance.
pub fn leaves_out([seed, iteration]: [u32; 2], i: u32, share: f64) -> bool {
    let bits = [iteration, seed, i, 5].into_iter().rev().fold(0, |h, k| hash(k ^ h));
    (f64::from(bits >> 8) + 0.5) / f64::from(1 << 24) < share
}
