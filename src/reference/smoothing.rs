//! 3D smoothing: the least scale of a Gaussian, given the intervals at which photos sample it.

use crate::kernels::constants::smoothing::float64::MARGIN;
use crate::scene::camera::Camera;
use glam::{DVec2, DVec3};

/// Least scale of a Gaussian at `mean`, in world units: sqrt(0.2) pixels of the photo that samples it most finely (Yu
/// et al., Mip-Splatting, 2024, whose filter widens every Gaussian by as much). `None` if no photo sees it; Gaussians
/// up to [`MARGIN`] of a photo's size beyond its border count as seen.
pub fn least_scale(mean: DVec3, cameras: &[Camera], near: f64) -> Option<f64> {
    let interval = |c: &Camera| {
        let p = c.rotation * mean + c.translation;
        let pixel = c.focal * DVec2::new(p.x, p.y) / p.z + c.principal;
        let size = DVec2::new(f64::from(c.width), f64::from(c.height));
        let inside = pixel.cmpge(-MARGIN * size).all() && pixel.cmple((1.0 + MARGIN) * size).all();
        (p.z > near && inside).then(|| p.z / c.focal.max_element())
    };
    cameras.iter().filter_map(interval).min_by(f64::total_cmp).map(|interval| 0.2_f64.sqrt() * interval)
}
