//! The score of the detail safeguard, which favours small, visible, opaque Gaussians with large gradients.

use crate::gaussians::{Gaussians, opacity};
use crate::response::CHANNELS;
use rayon::prelude::*;

/// Channel of the visibility v.
const VISIBILITY: usize = 0;
/// Channel of the norm g of the positional gradient.
const GRADIENT: usize = 4;
/// Exponent of v, 1/s and alpha.
const EXPONENT: f64 = 0.5;

/// d = g v^1/2 s^-1/2 alpha^1/2 of each Gaussian of a model with these responses, n; s = sqrt(s1 s2) over the two largest axes. Gradient and visibility are divided by their maxima; scores that are not
/// finite become 0.
///
/// # Panics
/// If there is not one response for each Gaussian.
pub fn scores(model: &Gaussians, responses: &[[f32; CHANNELS]]) -> Vec<f64> {
    assert_eq!(responses.len(), model.len(), "one response for each Gaussian");
    let of = |c: usize| responses.iter().map(move |row| row[c]);
    let greatest = |c: usize| f64::from(of(c).filter(|x| x.is_finite()).fold(f32::MIN_POSITIVE, f32::max));
    let (most_gradient, most_visible) = (greatest(GRADIENT), greatest(VISIBILITY));
    let share = |x: f32, most: f64| f64::from(x.max(0.0)) / most;
    let score = |(i, row): (usize, &[f32; CHANNELS])| {
        let mut axes = model.log_scales[i].map(f64::from);
        axes.sort_unstable_by(f64::total_cmp);
        let ln_s = 0.5 * (axes[1] + axes[2]);
        let d = share(row[GRADIENT], most_gradient)
            * share(row[VISIBILITY], most_visible).powf(EXPONENT)
            * (-EXPONENT * ln_s).exp()
            * opacity(model.opacity_logits[i]).powf(EXPONENT);
        if d.is_finite() { d } else { 0.0 }
    };
    responses.par_iter().enumerate().map(score).collect()
}
