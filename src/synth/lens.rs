//! Lenses: from directions in front of a camera to the picture plane and back, by COLMAP's formulas. Written apart from those of
//! [`scene::lens`](crate::scene::lens), which readers use, so that a synthetic capture tests them.

use std::str::FromStr;

use glam::{DMat2, DVec2, DVec3};

use super::Error;
use crate::scene::lens::{self, LensModel};

/// Coefficients of a lens after its focal lengths and principal point, in COLMAP's order; zeros after the last.
pub(super) type Coefficients = [f64; 12];

/// A lens as its distortion of the ideal picture, in coordinates on the plane z = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lens {
    /// A lens in front of the picture.
    Front(LensModel, Coefficients),
    /// All directions: longitude and latitude, in radians (COLMAP `EQUIRECTANGULAR`).
    Panorama,
}

impl Lens {
    /// The ideal pinhole.
    pub const PINHOLE: Self = Self::Front(LensModel::Pinhole, [0.0; 12]);

    /// The image of a point in camera coordinates; none if the lens cannot see it: if its distortion folds back so far from the axis.
    pub fn image(&self, p: DVec3) -> Option<DVec2> {
        match *self {
            Self::Panorama => Some(DVec2::new(p.x.atan2(p.z), p.y.atan2(DVec2::new(p.x, p.z).length()))),
            Self::Front(model, k) => {
                let u = p.truncate() / p.z;
                let image = distorted(model, k, u);
                let unfolded =
                    || self.direction(image).truncate().distance_squared(u) < 1e-12 * (1.0 + u.length_squared());
                (p.z >= 0.05 && unfolded()).then_some(image)
            }
        }
    }

    /// The direction (of any length) whose image is `v`: the inverse of [`Lens::image`].
    pub fn direction(&self, v: DVec2) -> DVec3 {
        let (model, k) = match *self {
            Self::Panorama => {
                let ((sin, cos), (low, level)) = (v.x.sin_cos(), v.y.sin_cos());
                return DVec3::new(sin * level, low, cos * level);
            }
            Self::Front(LensModel::SimplePinhole | LensModel::Pinhole, _) => return v.extend(1.0),
            Self::Front(model, k) => (model, k),
        };
        // Newton's steps; the slopes are differences, as exact as the lenses here are mild.
        let (mut u, h) = (v, 1e-6);
        for _ in 0..40 {
            let off = distorted(model, k, u) - v;
            let slope = |d: DVec2| (distorted(model, k, u + d) - distorted(model, k, u - d)) / (2.0 * h);
            let change = DMat2::from_cols(slope(DVec2::new(h, 0.0)), slope(DVec2::new(0.0, h))).inverse() * off;
            u -= change;
            if change.length_squared() < 1e-24 {
                break;
            }
        }
        u.extend(1.0)
    }
}

/// The image of the ideal point `u`, in units of the focal lengths.
fn distorted(model: LensModel, k: Coefficients, u: DVec2) -> DVec2 {
    let r = u.length();
    let a = if r < 1e-9 { u } else { u * (r.atan() / r) };
    match model {
        LensModel::SimplePinhole | LensModel::Pinhole | LensModel::Equirectangular => u,
        LensModel::SimpleRadial => u * series(u, &k[..1]),
        LensModel::Radial => u * series(u, &k[..2]),
        LensModel::OpenCv => u * series(u, &k[..2]) + tangential(u, k[2], k[3]),
        LensModel::FullOpenCv => u * (series(u, &[k[0], k[1], k[4]]) / series(u, &k[5..8])) + tangential(u, k[2], k[3]),
        LensModel::Fov if k[0].abs() < 1e-6 => u,
        LensModel::Fov if r < 1e-9 => u * (2.0 * (0.5 * k[0]).tan() / k[0]),
        LensModel::Fov => u * ((2.0 * r * (0.5 * k[0]).tan()).atan() / (k[0] * r)),
        LensModel::SimpleFisheye | LensModel::Fisheye => a,
        LensModel::SimpleRadialFisheye => a * series(a, &k[..1]),
        LensModel::RadialFisheye => a * series(a, &k[..2]),
        LensModel::OpenCvFisheye => a * series(a, &k[..4]),
        LensModel::ThinPrismFisheye => {
            let prism = DVec2::new(k[6], k[7]) * a.length_squared();
            a * series(a, &[k[0], k[1], k[4], k[5]]) + tangential(a, k[2], k[3]) + prism
        }
        LensModel::RadTanThinPrismFisheye => {
            let w = a * series(a, &k[..6]);
            let r2 = w.length_squared();
            let prism = DVec2::new(k[8] * r2 + k[9] * r2 * r2, k[10] * r2 + k[11] * r2 * r2);
            w + tangential(w, k[7], k[6]) + prism
        }
        LensModel::SimpleDivision | LensModel::Division => u * (2.0 / (1.0 + (1.0 - 4.0 * k[0] * r * r).sqrt())),
        LensModel::Eucm => u / (k[0] * (k[1] * r * r + 1.0).sqrt() + 1.0 - k[0]),
    }
}

/// 1 + k1 r^2 + k2 r^4 + ...
fn series(u: DVec2, k: &[f64]) -> f64 {
    let r2 = u.length_squared();
    1.0 + k.iter().rev().fold(0.0, |sum, k| r2 * (k + sum))
}

fn tangential(u: DVec2, p1: f64, p2: f64) -> DVec2 {
    let (r2, xy) = (u.length_squared(), u.x * u.y);
    DVec2::new(2.0 * p1 * xy + p2 * (r2 + 2.0 * u.x * u.x), 2.0 * p2 * xy + p1 * (r2 + 2.0 * u.y * u.y))
}

/// A camera model of COLMAP with its parameters in COLMAP's order: focal lengths and principal point in pixels, then coefficients. As
/// text: `OPENCV:500,505,320,240,0.06,-0.08,0,0`.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The model.
    pub model: LensModel,
    /// Its parameters.
    pub parameters: Vec<f64>,
}

impl Calibration {
    /// Focal lengths, principal point and lens, for photos of this size.
    pub(super) fn device(&self, width: u32, height: u32) -> Result<(DVec2, DVec2, Lens), Error> {
        let Self { model, parameters: p } = self;
        let whole = lens::Lens::from_colmap(*model, width.into(), height.into(), p).map_err(Error::Lens)?;
        if *model == LensModel::Equirectangular {
            return Ok((whole.focal, whole.principal, Lens::Panorama));
        }
        let mut k = Coefficients::default();
        let more = &p[model.focal_lengths() + 2..];
        k[..more.len()].copy_from_slice(more);
        Ok((whole.focal, whole.principal, Lens::Front(*model, k)))
    }
}

impl FromStr for Calibration {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let (name, numbers) = text.split_once(':').unwrap_or((text, ""));
        let model = LensModel::from_name(name).ok_or_else(|| {
            let all = LensModel::ALL.map(LensModel::name).join(", ");
            Error::Lens(format!("\"{name}\" is not a camera model of COLMAP; possible models: {all}"))
        })?;
        let parameters = numbers.split(',').map(|number| {
            number.trim().parse().map_err(|_| {
                let n = model.parameters();
                Error::Lens(format!(
                    "\"{number}\" is not a number; write {name}: and {n} parameters, separated by commas"
                ))
            })
        });
        Ok(Self { model, parameters: parameters.collect::<Result<_, _>>()? })
    }
}

impl std::fmt::Display for Calibration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let numbers: Vec<String> = self.parameters.iter().map(ToString::to_string).collect();
        write!(f, "{}:{}", self.model.name(), numbers.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::path::{FISHEYE, OPENCV};

    #[test]
    fn directions_land_where_they_came_from() {
        let radial = Lens::Front(LensModel::Eucm, [0.6, 1.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        for lens in [Lens::PINHOLE, OPENCV, FISHEYE, radial, Lens::Panorama] {
            for i in 0..200 {
                let v = DVec2::new(f64::from(i % 20) * 0.05 - 0.5, f64::from(i / 20) * 0.08 - 0.4);
                let d = lens.direction(v);
                assert!((lens.image(d).unwrap() - v).length() < 1e-9, "{lens:?} at {v}");
            }
        }
    }

    /// r (1 + 0.058 r^2 - 0.08 r^4) falls from r = 1.35 on: such rays would come back into the picture.
    #[test]
    fn what_a_lens_folds_is_not_seen() {
        let lens = Lens::Front(LensModel::OpenCv, [0.058, -0.08, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(lens.image(DVec3::new(0.9, 0.9, 1.0)).is_some());
        assert_eq!(lens.image(DVec3::new(1.2, 1.2, 1.0)), None);
    }

    #[test]
    fn calibrations_are_read_or_refused() {
        let text = "SIMPLE_RADIAL:500,320,240,-0.1";
        let read: Calibration = text.parse().unwrap();
        assert_eq!((read.model, read.to_string().as_str()), (LensModel::SimpleRadial, text));
        for bad in ["RADIAL", "RADIAL:", "LOMO:1,2", "RADIAL:1,x"] {
            assert!(bad.parse::<Calibration>().unwrap_err().to_string().contains("is not a"), "{bad}");
        }
        let short = Calibration { model: LensModel::Radial, parameters: vec![1.0] };
        assert!(short.device(64, 48).unwrap_err().to_string().contains("takes 5 parameters"));
    }
}
