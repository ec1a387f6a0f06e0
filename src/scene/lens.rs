//! Lenses: real cameras with their distortion, and the ideal pinhole that replaces each. What sees more than a pinhole can
//! show is cut into several ([`faces`](super::faces)).
//!
//! A ray (x, y, 1) in camera coordinates meets the image plane at the normalised point (x, y). The lens bends it:
//! fisheye models first replace the radius r = tan(theta) by theta, others by a [`Curve`] of it, then all models apply
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

use std::f64::consts::{PI, TAU};

use glam::{DMat2, DVec2};

/// Displacement in pixels above which a lens counts as distorting; below it, photos are used as they are.
pub const VISIBLE_DISPLACEMENT: f64 = 0.5;

/// Samples along one image edge when a lens is examined.
const EDGE_SAMPLES: u32 = 128;

/// Largest half-width of the ideal image, in units of the half-width seen by an undistorted lens of the same focal
/// length.
const WIDEST: f64 = 2.0;

/// COLMAP's camera models, by COLMAP's names.
#[allow(missing_docs)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LensModel {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    OpenCv,
    OpenCvFisheye,
    FullOpenCv,
    Fov,
    SimpleRadialFisheye,
    RadialFisheye,
    ThinPrismFisheye,
    RadTanThinPrismFisheye,
    SimpleDivision,
    Division,
    SimpleFisheye,
    Fisheye,
    Eucm,
    Equirectangular,
}

/// Model, COLMAP's number, COLMAP's name, number of parameters.
const MODELS: [(LensModel, i32, &str, usize); 18] = [
    (LensModel::SimplePinhole, 0, "SIMPLE_PINHOLE", 3),
    (LensModel::Pinhole, 1, "PINHOLE", 4),
    (LensModel::SimpleRadial, 2, "SIMPLE_RADIAL", 4),
    (LensModel::Radial, 3, "RADIAL", 5),
    (LensModel::OpenCv, 4, "OPENCV", 8),
    (LensModel::OpenCvFisheye, 5, "OPENCV_FISHEYE", 8),
    (LensModel::FullOpenCv, 6, "FULL_OPENCV", 12),
    (LensModel::Fov, 7, "FOV", 5),
    (LensModel::SimpleRadialFisheye, 8, "SIMPLE_RADIAL_FISHEYE", 4),
    (LensModel::RadialFisheye, 9, "RADIAL_FISHEYE", 5),
    (LensModel::ThinPrismFisheye, 10, "THIN_PRISM_FISHEYE", 12),
    (LensModel::RadTanThinPrismFisheye, 11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    (LensModel::SimpleDivision, 12, "SIMPLE_DIVISION", 4),
    (LensModel::Division, 13, "DIVISION", 5),
    (LensModel::SimpleFisheye, 14, "SIMPLE_FISHEYE", 3),
    (LensModel::Fisheye, 15, "FISHEYE", 4),
    (LensModel::Eucm, 16, "EUCM", 6),
    (LensModel::Equirectangular, 17, "EQUIRECTANGULAR", 2),
];

impl LensModel {
    /// All models, in COLMAP's order.
    pub fn all() -> impl Iterator<Item = Self> {
        MODELS.iter().map(|m| m.0)
    }

    /// The model with COLMAP's number `id`.
    pub fn from_id(id: i32) -> Option<Self> {
        MODELS.iter().find(|m| m.1 == id).map(|m| m.0)
    }

    /// The model with COLMAP's name.
    pub fn from_name(name: &str) -> Option<Self> {
        MODELS.iter().find(|m| m.2 == name).map(|m| m.0)
    }

    /// COLMAP's number.
    pub fn id(self) -> i32 {
        MODELS[self as usize].1
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        MODELS[self as usize].2
    }

    /// Number of parameters that COLMAP stores.
    pub fn parameters(self) -> usize {
        MODELS[self as usize].3
    }

    /// All names, for messages.
    pub(crate) fn names() -> String {
        MODELS.map(|m| m.2).join(", ")
    }
}

/// The radius r at which a lens shows the ideal radius, before its polynomials.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Curve {
    /// The ideal radius itself.
    #[default]
    Straight,
    /// COLMAP's FOV: the angle seen through a field of omega, in radians.
    Fov(f64),
    /// Fitzgibbon's division model: the ideal radius is r / (1 + k r^2).
    Division(f64),
    /// The enhanced unified model: alpha and beta.
    Unified(f64, f64),
}

impl Curve {
    fn parameters(self) -> [f64; 3] {
        match self {
            Self::Straight => [0.0; 3],
            Self::Fov(omega) => [1.0, omega, 0.0],
            Self::Division(k) => [2.0, k, 0.0],
            Self::Unified(alpha, beta) => [3.0, alpha, beta],
        }
    }

    /// The radius shown; NaN where the lens shows none.
    fn shown(self, ideal: f64) -> f64 {
        match self {
            Self::Straight => ideal,
            Self::Fov(omega) if omega.abs() < 1e-6 => ideal,
            Self::Fov(omega) => (2.0 * ideal * (0.5 * omega).tan()).atan() / omega,
            Self::Division(k) => 2.0 * ideal / (1.0 + (1.0 - 4.0 * k * ideal * ideal).sqrt()),
            Self::Unified(alpha, beta) => ideal / (alpha * (beta * ideal * ideal + 1.0).sqrt() + 1.0 - alpha),
        }
    }

    /// The ideal radius, if a ray in front of the camera arrives at this one.
    fn ideal(self, shown: f64) -> Option<f64> {
        let squared = shown * shown;
        let ideal = match self {
            Self::Straight => shown,
            Self::Fov(omega) if omega.abs() < 1e-6 => shown,
            Self::Fov(omega) => {
                let angle = shown * omega;
                let ahead = angle.abs() < std::f64::consts::FRAC_PI_2 - 1e-6;
                if ahead { angle.tan() / (2.0 * (0.5 * omega).tan()) } else { return None }
            }
            Self::Division(k) => {
                // Behind the camera, or beyond the radius at which the model folds.
                if 1.0 + k * squared > 1e-9 && k * squared < 1.0 { shown / (1.0 + k * squared) } else { return None }
            }
            Self::Unified(alpha, beta) => {
                let (rest, inside) = (1.0 - alpha, 1.0 - (2.0 * alpha - 1.0) * beta * squared);
                let depth = (1.0 - alpha * alpha * beta * squared) / (alpha * inside.max(0.0).sqrt() + rest);
                if inside >= 0.0 && depth > 1e-9 { shown / depth } else { return None }
            }
        };
        ideal.is_finite().then_some(ideal)
    }
}

/// The coefficients that bend rays; zero where a model lacks them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// True if the radius is the ray's angle (equidistant projection) rather than its tangent.
    pub fisheye: bool,
    /// What the radius becomes otherwise.
    pub curve: Curve,
    /// Radial k1..k6, of r^2, r^4 and so on to r^12.
    pub radial: [f64; 6],
    /// Coefficients of the rational model's denominator, of r^2, r^4, r^6.
    pub denominator: [f64; 3],
    /// Tangential p1, p2.
    pub tangential: [f64; 2],
    /// Thin prism s1 (on x), s2 (on y).
    pub prism: [f64; 2],
    /// Tangential p0, p1 and thin prism s0..s3 of the point that the radial terms have moved already.
    pub after: [f64; 6],
}

impl Distortion {
    /// The polynomial part, in the plane where the lens bends rays.
    pub(super) fn bend(&self, w: DVec2) -> DVec2 {
        let r2 = w.length_squared();
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [d1, d2, d3] = self.denominator;
        let [p1, p2] = self.tangential;
        let [s1, s2] = self.prism;
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * (k4 + r2 * (k5 + r2 * k6)))));
        let denominator = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
        let xy = 2.0 * w.x * w.y;
        let moved = w * (numerator / denominator)
            + DVec2::new(
                p1 * xy + p2 * (r2 + 2.0 * w.x * w.x) + s1 * r2,
                p2 * xy + p1 * (r2 + 2.0 * w.y * w.y) + s2 * r2,
            );
        if self.after == [0.0; 6] { moved } else { moved + self.bend_again(moved) }
    }

    /// The terms of the point that the radial ones have moved.
    fn bend_again(&self, w: DVec2) -> DVec2 {
        let [p0, p1, s0, s1, s2, s3] = self.after;
        let (r2, xy) = (w.length_squared(), 2.0 * w.x * w.y);
        DVec2::new(
            p1 * xy + p0 * (r2 + 2.0 * w.x * w.x) + r2 * (s0 + s1 * r2),
            p0 * xy + p1 * (r2 + 2.0 * w.y * w.y) + r2 * (s2 + s3 * r2),
        )
    }

    /// The point at which the polynomials act, of an ideal one.
    fn curved(&self, point: DVec2) -> DVec2 {
        let r = point.length();
        let shown = if self.fisheye { r.atan() } else { self.curve.shown(r) };
        let straight = !self.fisheye && self.curve == Curve::Straight;
        if straight {
            point
        } else if r <= 1e-12 {
            point * self.centre()
        } else {
            point * (shown / r)
        }
    }

    /// What the curve multiplies small radii by.
    fn centre(&self) -> f64 {
        match self.curve {
            Curve::Fov(omega) if omega.abs() >= 1e-6 => 2.0 * (0.5 * omega).tan() / omega,
            _ => 1.0,
        }
    }

    /// Derivative of [`Self::bend`], by central differences: exact enough to steer Newton steps and to see folds.
    pub(super) fn jacobian(&self, w: DVec2) -> DMat2 {
        let h = 1e-6 * (1.0 + w.length());
        let column = |d: DVec2| (self.bend(w + d) - self.bend(w - d)) / (2.0 * h);
        DMat2::from_cols(column(DVec2::new(h, 0.0)), column(DVec2::new(0.0, h)))
    }

    /// Inverse of [`Self::bend`] on the branch that contains the axis, by damped Newton steps from the bent point.
    fn unbend(&self, bent: DVec2) -> Option<DVec2> {
        let mut w = bent;
        let mut error = self.bend(w) - bent;
        for _ in 0..60 {
            if error.length() <= 1e-15 * (1.0 + bent.length()) {
                break;
            }
            let step = self.jacobian(w).inverse() * error;
            let mut share = 1.0;
            let next = loop {
                let next = w - step * share;
                let next_error = self.bend(next) - bent;
                if next_error.length() < error.length() {
                    break Some((next, next_error));
                }
                share *= 0.5;
                if share < 1e-4 {
                    break None; // stuck: at rounding level, or in a fold
                }
            };
            match next {
                Some((next, next_error)) => (w, error) = (next, next_error),
                None => break,
            }
        }
        (error.length() <= 1e-11 * (1.0 + bent.length()) && self.jacobian(w).determinant() > 0.0).then_some(w)
    }
}

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

/// The pinhole that replaces a lens: focal lengths and principal point in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels from the upper left corner.
    pub principal: DVec2,
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
        let (single, rest) = match model {
            LensModel::SimplePinhole
            | LensModel::SimpleRadial
            | LensModel::Radial
            | LensModel::SimpleRadialFisheye
            | LensModel::RadialFisheye
            | LensModel::SimpleDivision
            | LensModel::SimpleFisheye => (true, &p[3..]),
            _ => (false, &p[4..]),
        };
        match (model, rest) {
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
        distortion.fisheye = matches!(
            model,
            LensModel::OpenCvFisheye
                | LensModel::SimpleRadialFisheye
                | LensModel::RadialFisheye
                | LensModel::ThinPrismFisheye
                | LensModel::RadTanThinPrismFisheye
                | LensModel::SimpleFisheye
                | LensModel::Fisheye
        );
        let (focal, principal) = if single {
            (DVec2::splat(p[0]), DVec2::new(p[1], p[2]))
        } else {
            (DVec2::new(p[0], p[1]), DVec2::new(p[2], p[3]))
        };
        let [width, height] = [width, height].map(saturated);
        Self { model, width, height, focal, principal, distortion }.checked()
    }

    /// A panorama of all directions: longitude and latitude give a pixel. The middle looks along z.
    ///
    /// # Errors
    /// As [`Lens::from_colmap`].
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
            return Err(format!("image size {} x {} is not one that a photo has", self.width, self.height));
        }
        let largest = 1e6 * f64::from(self.width.max(self.height));
        if !self.focal.is_finite() || self.focal.min_element() <= 1e-3 || self.focal.max_element() >= largest {
            return Err(format!("focal lengths {}, {} px are not ones that a lens has", self.focal.x, self.focal.y));
        }
        if !self.principal.is_finite() || self.principal.abs().max_element() >= largest {
            return Err(format!("principal point {}, {} px lies out of reach", self.principal.x, self.principal.y));
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
        let flags =
            [f64::from(self.width), f64::from(self.height), self.model as i32 as f64, f64::from(u8::from(d.fisheye))];
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
        let ratio = f64::from(width) / f64::from(self.width);
        (f64::from(height) - f64::from(self.height) * ratio).abs() <= 1.0 + ratio.max(1.0) + 0.01 * f64::from(height)
    }

    /// The normalised image of the normalised point (x / z, y / z).
    pub fn distort(&self, point: DVec2) -> DVec2 {
        self.distortion.bend(self.distortion.curved(point))
    }

    /// The normalised point (x / z, y / z) whose image is `distorted`; none if no ray in front of the camera arrives
    /// there on the branch that contains the optical axis.
    pub fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        let w = self.distortion.unbend(distorted)?;
        let theta = w.length();
        if !self.distortion.fisheye {
            let scale = |ideal: f64| if theta < 1e-12 { 1.0 / self.distortion.centre() } else { ideal / theta };
            let straight = self.distortion.curve == Curve::Straight;
            return if straight { Some(w) } else { self.distortion.curve.ideal(theta).map(|ideal| w * scale(ideal)) };
        }
        if theta < 1e-12 {
            return Some(w);
        }
        (theta < std::f64::consts::FRAC_PI_2 - 1e-6).then(|| w * (theta.tan() / theta))
    }

    /// Pixel at which the normalised point (x / z, y / z) appears.
    pub fn project(&self, point: DVec2) -> DVec2 {
        self.distort(point) * self.focal + self.principal
    }

    /// The largest displacement, in pixels, against a pinhole image of the same intrinsics (129 x 129 grid over the
    /// image, edges included); infinite if the distortion has a pole.
    pub fn max_displacement(&self) -> f64 {
        if self.distortion == Distortion::default() {
            return 0.0;
        }
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let mut farthest = 0.0_f64;
        for j in 0..=EDGE_SAMPLES {
            for i in 0..=EDGE_SAMPLES {
                let pixel = size * DVec2::new(f64::from(i), f64::from(j)) / f64::from(EDGE_SAMPLES);
                let moved = (self.project((pixel - self.principal) / self.focal) - pixel).length();
                farthest = farthest.max(if moved.is_nan() { f64::INFINITY } else { moved });
            }
        }
        farthest
    }

    /// The ideal pinhole for an image of the same size (see the module's protocol); none if the distortion folds the
    /// image so that it covers no rectangle entirely.
    pub fn ideal(&self) -> Option<Pinhole> {
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let reach = WIDEST * 0.5 * size / self.focal;
        let (mut low, mut high) = (-reach, reach);
        let last = size - 0.5;
        let steps = |n: u32| (0..=n.min(EDGE_SAMPLES)).map(move |i| f64::from(i) / f64::from(n.min(EDGE_SAMPLES)));
        let ray = |x: f64, y: f64| self.undistort((DVec2::new(x, y) - self.principal) / self.focal);
        for t in steps(self.height) {
            let y = 0.5 + t * (last.y - 0.5);
            low.x = ray(0.5, y).map_or(low.x, |p| low.x.max(p.x));
            high.x = ray(last.x, y).map_or(high.x, |p| high.x.min(p.x));
        }
        for t in steps(self.width) {
            let x = 0.5 + t * (last.x - 0.5);
            low.y = ray(x, 0.5).map_or(low.y, |p| low.y.max(p.y));
            high.y = ray(x, last.y).map_or(high.y, |p| high.y.min(p.y));
        }
        // A single pixel has no extent between centres: its width on the plane is one pixel's.
        let span = (high - low) + DVec2::select(size.cmple(DVec2::ONE), 1.0 / self.focal, DVec2::ZERO);
        if !span.is_finite() || span.min_element() <= 0.0 {
            return None;
        }
        let fitting = (size - 1.0).max(DVec2::ONE) / span;
        let centre = 0.5 * (low + high);
        let mut zoom = (fitting / self.focal).max_element();
        for _ in 0..100 {
            let focal = self.focal * zoom;
            let pinhole = Pinhole { focal, principal: 0.5 * size - centre * focal };
            if self.covers(&pinhole) {
                return Some(pinhole);
            }
            zoom *= 1.02;
        }
        None
    }

    /// True if every pixel centre of `pinhole`'s image (a grid of them, border included) has its source in the photo,
    /// on the unfolded branch.
    fn covers(&self, pinhole: &Pinhole) -> bool {
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let slack = 1e-6 * size.max_element();
        (0..=EDGE_SAMPLES).all(|j| {
            (0..=EDGE_SAMPLES).all(|i| {
                let share = DVec2::new(f64::from(i), f64::from(j)) / f64::from(EDGE_SAMPLES);
                let pixel = 0.5 + share * (size - 1.0);
                let point = (pixel - pinhole.principal) / pinhole.focal;
                let source = self.project(point);
                let inside = source.cmpge(DVec2::splat(0.5 - slack)).all() && source.cmple(size - 0.5 + slack).all();
                let bent = self.distortion.curved(point);
                inside && self.distortion.jacobian(bent).determinant() > 0.0
            })
        })
    }
}

fn saturated(pixels: u64) -> u32 {
    u32::try_from(pixels).unwrap_or(u32::MAX)
}
