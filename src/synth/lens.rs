//! Lenses: from directions in front of a camera to the picture plane and back, by COLMAP's formulas.

use glam::{DVec2, DVec3};

/// A lens as its distortion of the ideal picture, in coordinates on the plane z = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lens {
    /// The ideal pinhole.
    Pinhole,
    /// Radial k1, k2 and tangential p1, p2 (COLMAP `OPENCV`).
    OpenCv { k1: f64, k2: f64, p1: f64, p2: f64 },
    /// Equidistant with four radial terms (COLMAP `OPENCV_FISHEYE`).
    Fisheye { k: [f64; 4] },
    /// All directions: longitude and latitude, in radians (COLMAP `EQUIRECTANGULAR`).
    Panorama,
}

impl Lens {
    /// The image of a point in camera coordinates; none if the lens cannot see it.
    pub fn image(&self, p: DVec3) -> Option<DVec2> {
        if *self == Self::Panorama {
            return Some(DVec2::new(p.x.atan2(p.z), p.y.atan2(DVec2::new(p.x, p.z).length())));
        }
        (p.z >= 0.05).then(|| self.distort(p.truncate() / p.z))
    }

    /// The image of the ideal point `u`.
    fn distort(&self, u: DVec2) -> DVec2 {
        match *self {
            Self::Pinhole | Self::Panorama => u,
            Self::OpenCv { k1, k2, .. } => {
                let r2 = u.length_squared();
                u * (1.0 + k1 * r2 + k2 * r2 * r2) + self.tangential(u)
            }
            Self::Fisheye { k } => {
                let r = u.length();
                if r < 1e-9 { u } else { u * (fisheye(r.atan(), k).0 / r) }
            }
        }
    }

    /// The direction (of any length) whose image is `v`: the inverse of [`Lens::image`].
    pub fn direction(&self, v: DVec2) -> DVec3 {
        let ideal = match *self {
            Self::Panorama => {
                let ((sin, cos), (low, level)) = (v.x.sin_cos(), v.y.sin_cos());
                return DVec3::new(sin * level, low, cos * level);
            }
            Self::Pinhole => v,
            Self::OpenCv { k1, k2, .. } => {
                // Fixed point: the lenses here are mild, each round gains about a digit.
                let mut u = v;
                for _ in 0..40 {
                    let r2 = u.length_squared();
                    let next = (v - self.tangential(u)) / (1.0 + k1 * r2 + k2 * r2 * r2);
                    let moved = (next - u).length_squared();
                    u = next;
                    if moved < 1e-20 {
                        break;
                    }
                }
                u
            }
            Self::Fisheye { k } => {
                let bent = v.length();
                let mut theta = bent;
                for _ in 0..20 {
                    let (value, slope) = fisheye(theta, k);
                    let change = (value - bent) / slope;
                    theta -= change;
                    if change.abs() < 1e-12 {
                        break;
                    }
                }
                if bent < 1e-9 { v } else { v * (theta.tan() / bent) }
            }
        };
        ideal.extend(1.0)
    }

    fn tangential(&self, u: DVec2) -> DVec2 {
        let &Self::OpenCv { p1, p2, .. } = self else { return DVec2::ZERO };
        let (r2, xy) = (u.length_squared(), u.x * u.y);
        DVec2::new(2.0 * p1 * xy + p2 * (r2 + 2.0 * u.x * u.x), 2.0 * p2 * xy + p1 * (r2 + 2.0 * u.y * u.y))
    }
}

/// Bent angle of `theta` and its slope.
fn fisheye(theta: f64, k: [f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let (mut value, mut slope, mut power) = (1.0, 1.0, 1.0);
    for (i, k) in k.into_iter().enumerate() {
        power *= t2;
        value += k * power;
        slope += (2 * i + 3) as f64 * k * power;
    }
    (theta * value, slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::path::{FISHEYE, OPENCV};

    #[test]
    fn directions_land_where_they_came_from() {
        for lens in [Lens::Pinhole, OPENCV, FISHEYE, Lens::Panorama] {
            for i in 0..200 {
                let v = DVec2::new(f64::from(i % 20) * 0.05 - 0.5, f64::from(i / 20) * 0.08 - 0.4);
                let d = lens.direction(v);
                assert!((lens.image(d).unwrap() - v).length() < 1e-9, "{lens:?} at {v}");
            }
        }
    }
}
