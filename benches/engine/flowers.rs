//! An orbit around a model, and its pairs counted by the float64 twin.

use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::reference::{self, bin, project};
use qirf_vk::scene::camera::Camera;

/// Pictures of an orbit.
pub const VIEWS: u32 = 8;

/// Cameras at even steps on a circle around the model's median, near enough for its bulk to fill the picture.
pub fn orbit(model: &Gaussians, width: u32, height: u32) -> Vec<Camera> {
    let quantile = |axis: usize, share: usize| {
        let mut values: Vec<f32> = model.means.iter().map(|m| m[axis]).collect();
        values.sort_by(f32::total_cmp);
        f64::from(values[(values.len() - 1) * share / 100])
    };
    let centre = DVec3::from_array([0, 1, 2].map(|axis| quantile(axis, 50)));
    let radius = (0..3).map(|axis| quantile(axis, 95) - quantile(axis, 5)).fold(0.0, f64::max);
    (0..VIEWS)
        .map(|view| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(view) / f64::from(VIEWS)).sin_cos();
            let eye = centre + DVec3::new(cos, -0.3, sin) * radius * 1.3;
            Camera::look_at(eye, centre, DVec3::NEG_Y, 0.9, width, height)
        })
        .collect()
}

/// (exact, 3-sigma) pairs over tiles of 16 x 16 in float64, whatever the device's tiles: the exact ellipse, and the
/// square of three times the larger standard deviation, rounded up, over the tiles whose pixel centres it contains.
pub fn pairs_at_16(model: &Gaussians, cameras: &[Camera]) -> (u64, u64) {
    let params = reference::Params::from(model);
    let settings = reference::Settings { sh_degree: 0, tile: 16, ..reference::Settings::default() };
    let (mut exact, mut three_sigma) = (0, 0);
    for camera in cameras {
        for p in project::project(&params, camera, &settings).iter().flatten() {
            bin::touched(p, camera, &settings, |_| exact += 1);
            let [xx, xy, yy] = p.covariance;
            let middle = 0.5 * (xx + yy);
            let largest = middle + (middle * middle - (xx * yy - xy * xy)).max(0.1).sqrt();
            let radius = (3.0 * largest.sqrt()).ceil();
            let span = |centre: f64, pixels: u32| {
                let first = (centre - radius - 0.5).ceil().clamp(0.0, f64::from(pixels)) as u32;
                let end = ((centre + radius - 0.5).floor() + 1.0).clamp(0.0, f64::from(pixels)) as u32;
                if first < end { u64::from(end.div_ceil(settings.tile) - first / settings.tile) } else { 0 }
            };
            three_sigma += span(p.mean.x, camera.width) * span(p.mean.y, camera.height);
        }
    }
    (exact, three_sigma)
}

/// Decrease from `before` to `now`, in percent.
pub fn fewer(now: u64, before: u64) -> f64 {
    100.0 * (1.0 - now as f64 / before as f64)
}
