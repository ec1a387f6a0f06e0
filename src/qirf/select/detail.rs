//! The score of the detail safeguard, which favours small, visible, opaque Gaussians with large gradients.

use crate::gaussians::opacity;
use rayon::prelude::*;

/// Exponents of d = g^gamma v^nu s^-rho alpha^delta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponents {
    /// Exponent of the gradient g.
    pub gamma: f64,
    /// Exponent of the visibility v.
    pub nu: f64,
    /// Exponent of 1/s, s = sqrt(s1 s2) over the two largest axes.
    pub rho: f64,
    /// Exponent of the opacity.
    pub delta: f64,
}

impl Default for Exponents {
    fn default() -> Self {
        Self { gamma: 1.0, nu: 0.5, rho: 0.5, delta: 0.5 }
    }
}

/// Inputs of the score, n each.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// Norm of the positional gradient, in any unit.
    pub gradient: &'a [f32],
    /// Visibility, in any unit.
    pub visibility: &'a [f32],
    /// Natural logarithms of the axes' standard deviations.
    pub log_scales: &'a [[f32; 3]],
    /// Opacity before the sigmoid.
    pub opacity_logits: &'a [f32],
}

/// d of each Gaussian, n. Gradient and visibility are divided by their maxima; scores that are not finite become 0.
///
/// # Panics
/// If the arrays differ in length.
pub fn scores(inputs: &Inputs<'_>, exponents: Exponents) -> Vec<f64> {
    let n = inputs.gradient.len();
    assert!(inputs.visibility.len() == n && inputs.log_scales.len() == n && inputs.opacity_logits.len() == n);
    let greatest = |values: &[f32]| values.iter().copied().filter(|x| x.is_finite()).fold(f32::MIN_POSITIVE, f32::max);
    let (most_gradient, most_visible) = (greatest(inputs.gradient), greatest(inputs.visibility));
    let share = |x: f32, most: f32| f64::from(x.max(0.0)) / f64::from(most);
    let score = |i: usize| {
        let mut axes = inputs.log_scales[i].map(f64::from);
        axes.sort_unstable_by(f64::total_cmp);
        let ln_s = 0.5 * (axes[1] + axes[2]);
        let opacity = opacity(inputs.opacity_logits[i]);
        let d = share(inputs.gradient[i], most_gradient).powf(exponents.gamma)
            * share(inputs.visibility[i], most_visible).powf(exponents.nu)
            * (-exponents.rho * ln_s).exp()
            * opacity.powf(exponents.delta);
        if d.is_finite() { d } else { 0.0 }
    };
    (0..n).into_par_iter().map(score).collect()
}
