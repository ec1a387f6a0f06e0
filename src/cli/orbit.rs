//! Cameras on a circle round a model, near enough to fill the picture and far enough to show the whole.

use super::values::Up;
use crate::gaussians::{Gaussians, formats::Format};
use crate::scene::camera::Camera;
use glam::DVec3;

/// Gaussians that are looked at: enough for quantiles, and quick for millions.
const SAMPLES: usize = 200_000;

/// Where a model stands, outliers ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Subject {
    /// Middle of its box.
    pub centre: DVec3,
    /// Up in the world.
    pub up: DVec3,
    /// Radius of the upright cylinder round the centre that holds nearly all of it.
    pub radius: f64,
    /// Half that cylinder's height.
    pub half_height: f64,
}

/// How to look at it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// Vertical field of view in radians.
    pub fov: f64,
    /// Height of the camera above the horizon in radians.
    pub elevation: f64,
    /// Width and height in pixels.
    pub size: (u32, u32),
}

/// The direction that is up in files of a format: PLY and its kin keep COLMAP's y-down axes, SPZ is y-up.
pub(super) fn up(asked: Up, format: Format) -> DVec3 {
    match (asked, format) {
        (Up::Axis(axis), _) => axis,
        (Up::Auto, _) => DVec3::NEG_Y,
    }
}

impl Subject {
    /// Finds a model's middle and size by quantiles weighted with opacity: floaters and far background count little.
    pub fn of(model: &Gaussians, up: DVec3) -> Self {
        let stride = model.len().div_ceil(SAMPLES).max(1);
        let samples: Vec<(DVec3, f64)> = (0..model.len())
            .step_by(stride)
            .map(|i| {
                let weight = 1.0 / (1.0 + (-f64::from(model.opacity_logits[i])).exp());
                (DVec3::from_array(model.means[i].map(f64::from)), weight + 1e-9)
            })
            .collect();
        if samples.is_empty() {
            return Self { centre: DVec3::ZERO, up, radius: 1.0, half_height: 1.0 };
        }
        let along = |axis: DVec3, among: &[(DVec3, f64)], share: f64| {
            quantile(among.iter().map(|(p, w)| (p.dot(axis), *w)).collect(), share)
        };
        let side = up.any_orthonormal_vector();
        let axes = [side, up.cross(side), up];
        // First the bulk: what lies within four times the median distance from the median point.
        let median: DVec3 = axes.iter().map(|a| *a * along(*a, &samples, 0.5)).sum();
        let typical = quantile(samples.iter().map(|(p, w)| (p.distance(median), *w)).collect(), 0.5);
        let bulk: Vec<_> = samples.iter().copied().filter(|(p, _)| p.distance(median) <= 4.0 * typical).collect();
        // Then the bulk's box.
        let centre: DVec3 = axes.iter().map(|a| *a * 0.5 * (along(*a, &bulk, 0.01) + along(*a, &bulk, 0.99))).sum();
        let half_height = 0.5 * (along(up, &bulk, 0.99) - along(up, &bulk, 0.01));
        let flat = |p: DVec3| (p - centre).reject_from(up).length();
        let radius = quantile(bulk.iter().map(|(p, w)| (flat(*p), *w)).collect(), 0.98);
        // A lone Gaussian has no spread but its own.
        let own = model.log_scales.first().map_or(1.0, |s| f64::from(s[0].max(s[1]).max(s[2])).exp() * 3.0);
        let least = if radius.max(half_height) > 0.0 { 0.0 } else { own.clamp(1e-6, 1e6) };
        Self { centre, up, radius: radius.max(least), half_height: half_height.max(least) }
    }

    /// Distance of a camera from the centre that shows the whole.
    pub fn distance(&self, look: &Look) -> f64 {
        let aspect = f64::from(look.size.0) / f64::from(look.size.1);
        let half = 0.5 * look.fov;
        let half_across = (half.tan() * aspect).atan();
        // The cylinder's front rim is nearer than its middle by what the elevation leaves of the radius.
        let nearer = self.radius * look.elevation.cos() + self.half_height * look.elevation.sin().abs();
        let tall = self.half_height * look.elevation.cos() + self.radius * look.elevation.sin().abs();
        let across = self.radius / half_across.sin();
        (across.max(tall / half.tan() + 0.5 * nearer)) * 1.05
    }

    /// `count` cameras at even steps round the subject, the first in front (towards -z, or +y where z is up).
    pub fn cameras(&self, count: u32, look: &Look) -> Vec<Camera> {
        let front = if self.up.z.abs() > 0.5 { DVec3::NEG_Y } else { DVec3::NEG_Z };
        let side = self.up.cross(front);
        let distance = self.distance(look);
        (0..count)
            .map(|i| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
                let level = front * cos + side * sin;
                let eye = self.centre + (level * look.elevation.cos() + self.up * look.elevation.sin()) * distance;
                Camera::look_at(eye, self.centre, self.up, look.fov, look.size.0, look.size.1)
            })
            .collect()
    }
}

/// The value below which this share of the weight lies; `values` are (value, weight), at least one.
fn quantile(mut values: Vec<(f64, f64)>, share: f64) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|v| v.1).sum();
    let mut sum = 0.0;
    for (value, weight) in &values {
        sum += weight;
        if sum >= share * total {
            return *value;
        }
    }
    values.last().map_or(0.0, |v| v.0)
}
