//! The Gaussians that a picture may show, found on the host by a conservative test.

use super::settings::{Culling, Settings};
use crate::gaussians::Gaussians;
use crate::kernels::constants::view::float64::{FIELD_BEYOND, FIELD_MARGIN};
use crate::scene::camera::{Camera, Whole};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Standard deviations beyond which no Gaussian's alpha reaches 1/255: sqrt(2 ln 255), rounded up as in `tiles.glsl`.
const DEVIATIONS: f64 = 3.34;
/// Margin around a picture within which Gaussians count as shown, in pixels; many times the kernels' rounding.
const MARGIN: f64 = 2.0;
/// Relative error of a position: many times that of the kernels' float32.
const ROUNDING: f64 = 1e-4;

/// Visible range of one axis of a picture.
struct Axis {
    /// Slopes of the picture's edges.
    low: f64,
    high: f64,
    /// Reach of a Gaussian with a deviation of one world unit, in world units at its own depth.
    reach: f64,
    /// Error of a position at a distance of one world unit.
    slack: f64,
}

impl Axis {
    /// The axis with this focal length and principal point of a picture `whole` pixels wide, of which `from..to` is drawn.
    fn new(focal: f64, principal: f64, whole: u32, [from, to]: [u32; 2], dilation: f32) -> Self {
        let margin = MARGIN + DEVIATIONS * f64::from(dilation).sqrt();
        let slope = |pixel: f64| (pixel - principal) / focal;
        let (low, high) = (slope(f64::from(from) - margin), slope(f64::from(to) + margin));
        let half = 0.5 * f64::from(whole) / focal;
        let steepest = (FIELD_MARGIN * half).max(slope(f64::from(whole / 2)).abs() + FIELD_BEYOND * half);
        let slack = ROUNDING * (1.0 + low.abs().max(high.abs()));
        Self { low, high, reach: DEVIATIONS * (1.0 + steepest * steepest).sqrt(), slack }
    }

    /// Whether a Gaussian may reach into the picture; also true if a value is NaN.
    fn may_show(&self, at: f64, depth: f64, deviation: f64, distance: f64) -> bool {
        let reach = self.reach * deviation + self.slack * distance;
        let (left, right) = (at + reach < self.low * depth, at - reach > self.high * depth);
        !left && !right
    }
}

/// The Gaussians among `candidates` that a camera's picture may show, in their order; none of the others has a pixel in
/// it. Drawing these alone gives the same picture, bit for bit.
pub fn visible(model: &Gaussians, candidates: &[u32], camera: &Camera, settings: &Settings) -> Vec<u32> {
    if settings.culling != Culling::Exact {
        return candidates.to_vec();
    }
    let Whole { size, corner } = camera.whole();
    let part = [camera.width, camera.height];
    let axis = |a: usize, focal: f64, principal: f64| {
        Axis::new(focal, principal, size[a], [corner[a], corner[a] + part[a]], settings.dilation)
    };
    let (focal, principal) = (camera.focal, camera.principal);
    let (x, y) = (axis(0, focal.x, principal.x), axis(1, focal.y, principal.y));
    let (centre, rotation): (DVec3, DMat3) = (camera.centre(), camera.rotation);
    let near = f64::from(settings.near);
    let shows = |i: &u32| {
        let i = *i as usize;
        let offset = DVec3::from(model.means[i].map(f64::from)) - centre;
        let seen = rotation * offset;
        let distance = offset.length();
        let [a, b, c] = model.log_scales[i];
        let deviation = f64::from(a.max(b).max(c)).exp();
        let behind = seen.z + ROUNDING * distance < near;
        !behind && x.may_show(seen.x, seen.z, deviation, distance) && y.may_show(seen.y, seen.z, deviation, distance)
    };
    candidates.par_iter().copied().filter(shows).collect()
}
