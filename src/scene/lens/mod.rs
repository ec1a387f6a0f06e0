//! Lenses: real cameras with their distortion, and the ideal pinhole that replaces each. What sees more than a pinhole can
//! show is cut into several ([`faces`](super::faces)).
//!
//! A ray (x, y, 1) in camera coordinates meets the image plane at the normalised point (x, y). The lens bends it: a
//! [`Curve`] first replaces its radius r = tan(theta), by theta for fisheyes, then all models apply
//! `w (1 + k1 r2 + k2 r4 + k3 r6 + k4 r8) / (1 + d1 r2 + d2 r4 + d3 r6)` plus tangential (p1, p2) and thin-prism
//! (s1, s2) terms, all of the point w itself; focal lengths and principal point then give pixels. These are COLMAP's
//! camera models, which are OpenCV's with the pixel centre at + 0.5.
//!
//! # Undistortion protocol
//! The ideal pinhole has the photo's size in pixels. The photo's border (its outermost pixel centres) is undistorted
//! and bounds a rectangle that the photo covers entirely. This rectangle is cut to twice the field that an undistorted
//! lens of the same focal lengths would see, as a rectilinear image of a fisheye's rim would be mostly blur. One zoom
//! factor for both axes (pixels keep their shape) makes the image fit into that rectangle, centred: every output pixel
//! has a source. Sampling is bilinear, in the stored 8-bit values, averaged over as many samples per pixel as the
//! reduction requires.

mod curve;
mod distortion;
pub(super) mod ideal;
mod model;

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

pub use curve::Curve;
pub use distortion::Distortion;
use distortion::LEAST;
pub use ideal::Pinhole;
pub use model::LensModel;

/// Displacement in pixels above which a lens counts as distorting; below it, photos are used as they are.
pub const VISIBLE_DISPLACEMENT: f64 = 0.5;

/// The intrinsics of a real camera: image size, focal lengths, principal point and distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The model that it was calibrated with.
    pub model: LensModel,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels from the upper left corner.
    pub principal: DVec2,
    /// Coefficients that bend rays.
    pub distortion: Distortion,
}

impl Lens {
    /// A lens of COLMAP's `model` from its parameters in COLMAP's order.
    ///
    /// # Errors
    /// A sentence that states the fault: the number of parameters, a value that is not finite, an impossible size or
    /// focal length.
    pub fn from_colmap(model: LensModel, width: u64, height: u64, p: &[f64]) -> Result<Self, String> {
        if p.len() != model.parameters() {
            return Err(format!("{} takes {} parameters, found {}", model.name(), model.parameters(), p.len()));
        }
        if model == LensModel::Equirectangular {
            // Its parameters repeat the size.
            return Self::panorama(width, height);
        }
        let mut distortion = Distortion::default();
        let lengths = model.focal_lengths();
        match (model, &p[lengths + 2..]) {
            (LensModel::OpenCv, &[k1, k2, p1, p2]) => {
                distortion.radial[..2].copy_from_slice(&[k1, k2]);
                distortion.tangential = [p1, p2];
            }
            (LensModel::FullOpenCv, &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
                distortion.radial[..3].copy_from_slice(&[k1, k2, k3]);
                distortion.denominator = [k4, k5, k6];
                distortion.tangential = [p1, p2];
            }
            (LensModel::ThinPrismFisheye, &[k1, k2, p1, p2, k3, k4, s1, s2]) => {
                distortion.radial[..4].copy_from_slice(&[k1, k2, k3, k4]);
                distortion.tangential = [p1, p2];
                distortion.prism = [s1, s2];
            }
            (LensModel::RadTanThinPrismFisheye, all) => {
                distortion.radial.copy_from_slice(&all[..6]);
                distortion.after.copy_from_slice(&all[6..]);
            }
            (LensModel::Fov, &[omega]) => distortion.curve = Curve::Fov(omega),
            (LensModel::SimpleDivision | LensModel::Division, &[k]) if k != 0.0 => {
                distortion.curve = Curve::Division(k);
            }
            (LensModel::SimpleDivision | LensModel::Division, _) => {}
            (LensModel::Eucm, &[alpha, beta]) => distortion.curve = Curve::Unified(alpha, beta),
            (_, radial) => distortion.radial[..radial.len()].copy_from_slice(radial),
        }
        if model.is_fisheye() {
            distortion.curve = Curve::Angle;
        }
        let (focal, principal) = (DVec2::new(p[0], p[lengths - 1]), DVec2::new(p[lengths], p[lengths + 1]));
        let [width, height] = [width, height].map(saturated);
        Self { model, width, height, focal, principal, distortion }.checked()
    }

    /// A panorama of all directions: longitude and latitude give a pixel. The middle looks along z.
    pub fn panorama(width: u64, height: u64) -> Result<Self, String> {
        let [width, height] = [width, height].map(saturated);
        let size = DVec2::new(f64::from(width), f64::from(height));
        let (focal, principal) = (size / DVec2::new(TAU, PI), 0.5 * size);
        let model = LensModel::Equirectangular;
        Self { model, width, height, focal, principal, distortion: Distortion::default() }.checked()
    }

    /// The lens itself, if a camera could have it.
    pub(crate) fn checked(self) -> Result<Self, String> {
        let pixels = u64::from(self.width) * u64::from(self.height);
        if pixels == 0 || pixels > 1 << 30 {
            return Err(format!("image size {} x {} is not a valid photo size", self.width, self.height));
        }
        let largest = 1e6 * f64::from(self.width.max(self.height));
        if !self.focal.is_finite() || self.focal.min_element() <= 1e-3 || self.focal.max_element() >= largest {
            return Err(format!("focal lengths {}, {} px are not valid", self.focal.x, self.focal.y));
        }
        if !self.principal.is_finite() || self.principal.abs().max_element() >= largest {
            return Err(format!("principal point {}, {} px is out of range", self.principal.x, self.principal.y));
        }
        let d = &self.distortion;
        let curve = d.curve.parameters();
        let all = d.radial.iter().chain(&d.denominator).chain(&d.tangential).chain(&d.prism);
        if let Some(bad) = all.chain(&d.after).chain(&curve).find(|c| c.is_nan() || c.abs() >= 1e6) {
            return Err(format!("distortion coefficient {bad} is out of range"));
        }
        Ok(self)
    }

    /// All numbers of the lens, as bits: equal lenses have equal keys.
    pub(crate) fn key(&self) -> Vec<u64> {
        let d = &self.distortion;
        let flags = [f64::from(self.width), f64::from(self.height), self.model as i32 as f64];
        let lengths = self.focal.to_array().into_iter().chain(self.principal.to_array());
        let bends = d.radial.into_iter().chain(d.denominator).chain(d.tangential).chain(d.prism);
        let bends = bends.chain(d.after).chain(d.curve.parameters());
        flags.into_iter().chain(lengths).chain(bends).map(f64::to_bits).collect()
    }

    /// The same lens on an image of another size; distortion does not depend on the size.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let ratio = DVec2::new(f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self { width, height, focal: self.focal * ratio, principal: self.principal * ratio, ..*self }
    }

    /// True if a photo of this size fits the lens, perhaps enlarged or reduced: sides in proportion within rounding and
    /// 1 %.
    pub fn fits(&self, width: u32, height: u32) -> bool {
        let (ratio, height) = (f64::from(width) / f64::from(self.width), f64::from(height));
        // Rounding says little of a few pixels.
        let rounding = if ratio < 1.0 { 2.0_f64.min(0.1 * height) } else { 1.0 + ratio };
        (height - f64::from(self.height) * ratio).abs() <= rounding + 0.01 * height
    }

    /// The normalised image of the normalised point (x / z, y / z).
    pub fn distort(&self, point: DVec2) -> DVec2 {
        self.distortion.bend(self.distortion.curved(point))
    }

    /// The normalised point (x / z, y / z) whose image is `distorted`; none if no ray in front of the camera arrives
    /// there on the branch that contains the optical axis.
    pub fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        let w = self.distortion.unbend(distorted)?;
        if self.distortion.curve == Curve::Straight {
            return Some(w);
        }
        let shown = w.length().max(LEAST);
        let (away, depth) = self.distortion.curve.ray(shown)?;
        (depth > 1e-6).then(|| w * (away / (depth * shown)))
    }

    /// Pixel at which the normalised point (x / z, y / z) appears.
    pub fn project(&self, point: DVec2) -> DVec2 {
        self.distort(point) * self.focal + self.principal
    }

    /// The pixel at which the lens shows a ray from the camera, of any length and perhaps from behind; NaN if none does.
    pub fn pixel_of(&self, ray: DVec3) -> DVec2 {
        let away = ray.truncate().length();
        let normalised = if self.model == LensModel::Equirectangular {
            DVec2::new(ray.x.atan2(ray.z), ray.y.atan2(DVec2::new(ray.x, ray.z).length()))
        } else if ray.z > 0.0 {
            self.distort(ray.truncate() / ray.z)
        } else if away > 0.0 {
            self.distortion.bend(ray.truncate() * (self.distortion.curve.shown(away, ray.z) / away))
        } else {
            DVec2::NAN
        };
        normalised * self.focal + self.principal
    }

    /// The largest angle in radians from the axis up to which the distortion does not fold, in steps of half a degree.
    pub(super) fn unfolded(&self) -> f64 {
        let sound = |degrees: f64| {
            let (away, depth) = degrees.to_radians().sin_cos();
            let shown = self.distortion.curve.shown(away, depth);
            let directions = (0..8).map(|k| DVec2::from_angle(0.125 * TAU * f64::from(k)));
            shown.is_finite() && directions.into_iter().all(|d| self.distortion.jacobian(d * shown).determinant() > 0.0)
        };
        let steps = (1..360).map(|half| 0.5 * f64::from(half));
        steps.take_while(|degrees| sound(*degrees)).last().unwrap_or(0.0).to_radians()
    }

    /// The angle in radians between the axis and the ray that is shown at a pixel, none if none is.
    pub(super) fn angle_at(&self, pixel: DVec2) -> Option<f64> {
        let w = self.distortion.unbend((pixel - self.principal) / self.focal)?;
        self.distortion.curve.ray(w.length()).map(|(away, depth)| away.atan2(depth))
    }
}

fn saturated(pixels: u64) -> u32 {
    u32::try_from(pixels).unwrap_or(u32::MAX)
}
