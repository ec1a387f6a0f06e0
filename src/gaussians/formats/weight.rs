//! Estimate of a Gaussian's contribution without pictures.

use super::Gaussians;

/// Size of a Gaussian over one plus its distance from the origin, along its shortest (0), middle (1) or longest axis (2): far ones
/// look small.
pub(super) fn size(model: &Gaussians, i: usize, axis_by_size: usize) -> f64 {
    let mut scales = model.log_scales[i];
    scales.sort_unstable_by(f32::total_cmp);
    let far = model.means[i].iter().fold(0.0_f32, |far, x| far.max(x.abs()));
    f64::from(scales[axis_by_size]).exp() / (1.0 + f64::from(far))
}

/// Estimated contribution of a Gaussian: opacity times area.
pub(super) fn weight(model: &Gaussians, i: usize) -> f64 {
    let area = size(model, i, 1) * size(model, i, 2);
    let weight = area.min(1.0) / (1.0 + f64::from(-model.opacity_logits[i]).exp());
    if weight.is_finite() { weight } else { 0.0 }
}
