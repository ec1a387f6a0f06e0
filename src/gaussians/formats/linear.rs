//! The quantities of formats that store scales and opacities as they are, and unit quaternions: glTF, USD.

/// The unit quaternion w, x, y, z; that of zero or NaN is the identity.
pub(super) fn unit(rotation: [f32; 4]) -> [f32; 4] {
    let q = rotation.map(f64::from);
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    let sound = length.is_finite() && length > 0.0;
    if sound { q.map(|c| (c / length) as f32) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// A scale of its logarithm.
pub(super) fn scale(log: f32) -> f32 {
    f64::from(log).exp() as f32
}

/// The logarithm of a scale, whose square matters, so that a sign is none.
pub(super) fn log_scale(scale: f32) -> f32 {
    f64::from(scale.abs()).ln() as f32
}

/// An opacity, 0 to 1, of its logit.
pub(super) fn opacity(logit: f32) -> f32 {
    crate::gaussians::opacity(logit) as f32
}

/// The logit of an opacity; infinite at 0 and 1, and beyond them.
pub(super) fn logit(opacity: f32) -> f32 {
    let p = f64::from(opacity).clamp(0.0, 1.0);
    (p / (1.0 - p)).ln() as f32
}
