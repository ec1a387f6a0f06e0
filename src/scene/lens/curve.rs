//! Curves: at which radius a lens shows a ray, before its polynomials.

use std::f64::consts::PI;

/// The radius at which a lens shows a ray, by the ray's distance from the optical axis and its depth along it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Curve {
    /// The ray's slope, as a pinhole.
    #[default]
    Straight,
    /// The ray's angle: the equidistant projection of fisheyes.
    Angle,
    /// COLMAP's FOV: the angle seen through a field of omega, in radians.
    Fov(f64),
    /// Fitzgibbon's division model: the slope is r / (1 + k r^2).
    Division(f64),
    /// The enhanced unified model: alpha and beta.
    Unified(f64, f64),
}

impl Curve {
    /// Numbers that differ where curves do.
    pub(super) fn parameters(self) -> [f64; 3] {
        match self {
            Self::Straight => [0.0; 3],
            Self::Fov(omega) => [1.0, omega, 0.0],
            Self::Division(k) => [2.0, k, 0.0],
            Self::Unified(alpha, beta) => [3.0, alpha, beta],
            Self::Angle => [4.0, 0.0, 0.0],
        }
    }

    /// The curve, without parameters at which it is a pinhole's but its formula is not.
    fn proper(self) -> Self {
        if matches!(self, Self::Fov(omega) if omega.abs() < 1e-6) { Self::Straight } else { self }
    }

    /// The radius at which a ray is shown that is `away` from the axis at `depth` along it, which may be negative; NaN
    /// where the lens shows none.
    pub(super) fn shown(self, away: f64, depth: f64) -> f64 {
        match self.proper() {
            Self::Straight if depth > 0.0 => away / depth,
            Self::Straight => f64::NAN,
            Self::Angle => away.atan2(depth),
            Self::Fov(omega) => (2.0 * away * (0.5 * omega).tan()).atan2(depth) / omega,
            Self::Division(k) => {
                let below = depth + (depth * depth - 4.0 * k * away * away).sqrt();
                if below > 0.0 { 2.0 * away / below } else { f64::NAN }
            }
            Self::Unified(alpha, beta) => {
                let (far, rest) = ((beta * away * away + depth * depth).sqrt(), 1.0 - alpha);
                let last = if alpha <= 0.5 { alpha / rest } else { rest / alpha };
                if depth > -last * far { away / (alpha * far + rest * depth) } else { f64::NAN }
            }
        }
    }

    /// A ray that is shown at a radius: how far it is from the axis at which depth. None where none is.
    pub(super) fn ray(self, shown: f64) -> Option<(f64, f64)> {
        let squared = shown * shown;
        let ray = match self.proper() {
            Self::Straight => (shown, 1.0),
            Self::Angle if shown < PI => (shown.sin(), shown.cos()),
            Self::Fov(omega) if (shown * omega).abs() < PI => {
                ((shown * omega).sin() / (2.0 * (0.5 * omega).tan()), (shown * omega).cos())
            }
            // Beyond the radius at which the model folds there is none.
            Self::Division(k) if k * squared < 1.0 => (shown, 1.0 + k * squared),
            Self::Unified(alpha, beta) => {
                // NaN beyond the last radius.
                let inside = 1.0 - (2.0 * alpha - 1.0) * beta * squared;
                (shown, (1.0 - alpha * alpha * beta * squared) / (alpha * inside.sqrt() + 1.0 - alpha))
            }
            Self::Angle | Self::Fov(_) | Self::Division(_) => return None,
        };
        (ray.0.is_finite() && ray.1.is_finite()).then_some(ray)
    }
}
