//! Projection of Gaussians to the image (Q1): view transform, EWA covariance, conic, opacity, colour, extent.
//!
//! With W the view rotation, M = R(q) diag(s), V = W M and ux, uy the clamped x/z, y/z, the rows of T = J V are
//!   t0 = fx/z (V_0 - ux V_2),   t1 = fy/z (V_1 - uy V_2),
//! and covariance2d = T T^T + d I, d being the dilation. Its determinant needs no difference of large numbers (Cauchy-Binet):
//!   det0 = |t0 x t1|^2,   det = det0 + d (|t0|^2 + |t1|^2) + d^2,
//! In float32, on the thinnest needles tried, the relative error of det is then 4e-7 and that of det0 6e-5. Computed as
//! xx yy - xy^2, det is off by 1.5e-2 and det0 by a factor of 2e4.

use glam::{DMat3, DVec2, DVec3};

use super::{Params, Settings};
use crate::gaussians::{MAX_SH_DEGREE, sh};
use crate::kernels::constants::blending::float64::{ALPHA_MIN, ALPHA_MIN_INVERSE};
use crate::kernels::constants::projection::float64::{MIN_ANTIALIAS, MIN_QUATERNION};
use crate::kernels::constants::view::float64::{FIELD_BEYOND, FIELD_MARGIN};
use crate::scene::camera::Camera;

/// Reason for leaving a Gaussian out of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Culled {
    /// The centre lies at the near plane or before it.
    Near,
    /// The quaternion's largest component is below [`MIN_QUATERNION`].
    Quaternion,
    /// The determinant of the image covariance is not positive.
    Determinant,
    /// A parameter, or a value computed from it, is infinite or not a number.
    NonFinite,
    /// Its opacity never reaches [`ALPHA_MIN`].
    Faint,
}

/// A projected Gaussian, as the rasteriser reads it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// Centre in pixels.
    pub mean: DVec2,
    /// Camera-space z.
    pub depth: f64,
    /// Finds its densest point on each ray.
    pub densest: Densest,
    /// Image covariance, dilation included, in square pixels: xx, xy, yy.
    pub covariance: [f64; 3],
    /// Inverse of `covariance`: xx, xy, yy.
    pub conic: [f64; 3],
    /// Opacity at the centre, anti-aliasing factor included.
    pub opacity: f64,
    /// Colour, not negative.
    pub colour: DVec3,
    /// ln(255 opacity): the power at which alpha falls to 1/255.
    pub extent: f64,
}

/// Finds the point on a ray from the camera at which a Gaussian is densest. With A the map from camera space to
/// standard deviations along the axes, density falls with |A (t ray - position)|^2, which is least at t = (A ray . A
/// position) / |A ray|^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Densest {
    /// A times the least standard deviation: no entry is greater than 1.
    whitened: DMat3,
    /// Camera-space centre.
    position: DVec3,
    /// Largest distance along z of a drawn part from the centre: sqrt(2 ln 255) standard deviations along z.
    reach: f64,
}

impl Densest {
    /// `depth_row` is row 2 of V.
    fn new(camera: &Camera, position: DVec3, log_scale: DVec3, quaternion: [f64; 4], depth_row: DVec3) -> Self {
        let narrow = DVec3::from((log_scale.min_element() - log_scale).to_array().map(f64::exp));
        let whitened = DMat3::from_diagonal(narrow) * (camera.rotation * rotation(quaternion)).transpose();
        Self { whitened, position, reach: (2.0 * ALPHA_MIN_INVERSE.ln()).sqrt() * depth_row.length() }
    }

    /// Camera-space z of that point on the ray (x, y, 1); the centre's for a disc seen edge-on.
    pub fn depth_along(&self, ray: DVec2) -> f64 {
        let along = self.whitened * ray.extend(1.0);
        let depth = along.dot(self.whitened * self.position) / along.length_squared();
        let centre = self.position.z;
        if depth.is_nan() { centre } else { depth.clamp(centre - self.reach, centre + self.reach) }
    }
}

/// Intermediate results of one Gaussian's projection, from which the backward pass starts.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Centre in camera coordinates.
    pub position: DVec3,
    /// x/z and y/z, clamped for the Jacobian.
    pub slope: DVec2,
    /// True for x/z and for y/z if they lie within the clamp's bounds.
    pub free: [bool; 2],
    /// Unit quaternion w, x, y, z.
    pub quaternion: [f64; 4],
    /// Length of the stored quaternion.
    pub quaternion_length: f64,
    /// Standard deviations of the axes.
    pub scale: DVec3,
    /// M = R(q) diag(s): columns are the axes.
    pub axes: DMat3,
    /// Row 2 of V = W M.
    pub depth_row: DVec3,
    /// t0 and t1, the rows of J V.
    pub rows: [DVec3; 2],
    /// det0 = |t0 x t1|^2.
    pub det0: f64,
    /// True if det0/det is above its floor, so that the anti-aliasing factor has a derivative.
    pub factor_free: bool,
    /// Sigmoid of the logit, without the anti-aliasing factor.
    pub sigmoid: f64,
    /// Unit vector from the camera to the centre, world coordinates.
    pub direction: DVec3,
    /// Distance from the camera to the centre.
    pub distance: f64,
    /// SH + 0.5 before the clamp at zero.
    pub raw_colour: DVec3,
    /// The result.
    pub projected: Projected,
}

/// The ellipse of one Gaussian in the image: its covariance, and values derived from it.
struct Ellipse {
    covariance: [f64; 3],
    conic: [f64; 3],
    det0: f64,
    /// det0/det.
    area_ratio: f64,
}

impl Ellipse {
    /// The ellipse with these rows of T = J V.
    fn new(t0: DVec3, t1: DVec3, dilation: f64) -> Result<Self, Culled> {
        let (xx, xy, yy) = (t0.length_squared(), t0.dot(t1), t1.length_squared());
        let det0 = t0.cross(t1).length_squared();
        let det = det0 + dilation * (xx + yy) + dilation * dilation;
        if !det.is_finite() {
            return Err(Culled::NonFinite);
        }
        if det <= 0.0 {
            return Err(Culled::Determinant);
        }
        let covariance = [xx + dilation, xy, yy + dilation];
        let conic = [covariance[2] / det, -xy / det, covariance[0] / det];
        Ok(Self { covariance, conic, det0, area_ratio: det0 / det })
    }
}

/// Projects every Gaussian of `params`; the result has one entry per Gaussian.
pub fn project(params: &Params, camera: &Camera, settings: &Settings) -> Vec<Result<Projected, Culled>> {
    (0..params.len()).map(|i| geometry(params, i, camera, settings).map(|g| g.projected)).collect()
}

/// Projects Gaussian `i`, with the intermediate results that its derivative needs.
///
/// # Errors
/// The reason, if the Gaussian is culled.
pub fn geometry(params: &Params, i: usize, camera: &Camera, settings: &Settings) -> Result<Geometry, Culled> {
    let mean = DVec3::from(params.means[i]);
    let position = camera.rotation * mean + camera.translation;
    let log_scale = DVec3::from(params.log_scales[i]);
    let stored = params.rotations[i];
    let finite = position.is_finite() && log_scale.is_finite() && stored.iter().all(|v| v.is_finite());
    if !finite || params.opacity_logits[i].is_nan() {
        return Err(Culled::NonFinite);
    }
    let z = position.z;
    if z <= settings.near {
        return Err(Culled::Near);
    }

    let (quaternion, quaternion_length) = unit_quaternion(stored).ok_or(Culled::Quaternion)?;
    let scale = DVec3::from(log_scale.to_array().map(f64::exp));
    let axes = rotation(quaternion) * DMat3::from_diagonal(scale);
    let v = camera.rotation * axes;

    let densest = Densest::new(camera, position, log_scale, quaternion, v.row(2));
    let limit = FIELD_MARGIN * 0.5 * DVec2::new(f64::from(camera.width), f64::from(camera.height)) / camera.focal;
    let middle = DVec2::new(f64::from(camera.width / 2), f64::from(camera.height / 2));
    let middle = (middle - camera.principal) / camera.focal;
    let beyond = FIELD_BEYOND / FIELD_MARGIN * limit;
    let (least, most) = ((-limit).min(middle - beyond), limit.max(middle + beyond));
    let unclamped = position.truncate() / z;
    let slope = unclamped.clamp(least, most);
    let free = (unclamped.cmpge(least) & unclamped.cmple(most)).into();
    let t0 = camera.focal.x / z * (v.row(0) - slope.x * v.row(2));
    let t1 = camera.focal.y / z * (v.row(1) - slope.y * v.row(2));

    let Ellipse { covariance, conic, det0, area_ratio } = Ellipse::new(t0, t1, settings.dilation)?;

    let sigmoid = sigmoid(params.opacity_logits[i]);
    let factor = if settings.antialias { area_ratio.max(MIN_ANTIALIAS).sqrt() } else { 1.0 };
    let opacity = sigmoid * factor;
    let extent = (ALPHA_MIN_INVERSE * opacity).ln();
    if !settings.smooth_cutoff && opacity < ALPHA_MIN {
        return Err(Culled::Faint);
    }

    let offset = mean - camera.centre();
    let distance = offset.length();
    let direction = offset / distance;
    let raw_colour = DVec3::splat(0.5) + radiance(params, i, direction, settings.sh_degree);
    if !raw_colour.is_finite() {
        return Err(Culled::NonFinite);
    }

    let mean = camera.focal * unclamped + camera.principal;
    if !mean.is_finite() {
        return Err(Culled::NonFinite);
    }
    let colour = raw_colour.max(DVec3::ZERO);
    Ok(Geometry {
        position,
        slope,
        free,
        quaternion,
        quaternion_length,
        scale,
        axes,
        depth_row: v.row(2),
        rows: [t0, t1],
        det0,
        factor_free: area_ratio > MIN_ANTIALIAS,
        sigmoid,
        direction,
        distance,
        raw_colour,
        projected: Projected { mean, depth: z, densest, covariance, conic, opacity, colour, extent },
    })
}

/// 1 / (1 + exp(-x)) without overflow at either end.
pub fn sigmoid(x: f64) -> f64 {
    let e = (-x.abs()).exp();
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

/// The unit quaternion and the stored length; `None` if the largest component is below [`MIN_QUATERNION`].
///
/// Dividing by the largest component first keeps |q|^2 in range (1e20 squared overflows float32).
pub fn unit_quaternion(q: [f64; 4]) -> Option<([f64; 4], f64)> {
    let largest = q.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    if largest < MIN_QUATERNION {
        return None;
    }
    let q = q.map(|v| v / largest);
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    Some((q.map(|v| v / length), length * largest))
}

/// Rotation matrix of a unit quaternion w, x, y, z.
pub fn rotation([w, x, y, z]: [f64; 4]) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// Bands in use: those stored, up to degree `sh_degree`.
pub fn bands(params: &Params, sh_degree: usize) -> usize {
    params.sh.len().min(sh_degree.min(MAX_SH_DEGREE) + 1)
}

fn radiance(params: &Params, i: usize, direction: DVec3, sh_degree: usize) -> DVec3 {
    let basis = sh::basis(direction);
    let mut sum = DVec3::ZERO;
    for l in 0..bands(params, sh_degree) {
        for m in 0..=2 * l {
            let at = (i * (2 * l + 1) + m) * 3;
            sum += basis[l * l + m] * DVec3::from_slice(&params.sh[l][at..at + 3]);
        }
    }
    sum
}
