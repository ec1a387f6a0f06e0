//! Estimates without pictures: of a Gaussian's contribution, and of a change of colours.

use super::Gaussians;

/// Change of the colours of single Gaussians, with white as 1, that pictures in SPZ show with 44 dB or more: those of flowers and playbot have
/// 13 to 15 dB more than this number says, because neighbours are rounded up and down. SOG's palettes are held to the same.
pub(super) const FAINT: f64 = 0.028;

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

/// Root mean square of the change of Gaussians' colours: over all directions and over the Gaussians, as far as pictures show them.
/// `square` gives the sum of the squared changes of a Gaussian's coefficients.
pub(super) fn colour_change(model: &Gaussians, square: impl Fn(usize) -> f64) -> f64 {
    let (mut squares, mut weights) = (0.0, 0.0);
    for i in 0..model.len() {
        let (weight, own) = (weight(model, i), square(i));
        if own.is_finite() {
            squares += weight * own;
            weights += weight;
        }
    }
    // Basis functions have unit norm over the sphere; three colours.
    if weights > 0.0 { (squares / weights / (12.0 * std::f64::consts::PI)).sqrt() } else { 0.0 }
}
