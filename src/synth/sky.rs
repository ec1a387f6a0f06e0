//! The background: a painted dome at a finite distance, so that points on it have a position.

use glam::Vec3;

use super::{
    geometry::Ray,
    noise::{fbm, noise, rgb, step},
};

/// Radius of the dome about the origin: twelve times the scene's own four metres.
pub(super) const DOME: f32 = 48.0;

/// Unit vector towards the sun's centre.
pub(super) const fn sun() -> Vec3 {
    Vec3::new(0.52, -0.56, 0.644981)
}

/// Distance to a dome of this radius from a point within it.
pub(super) fn hit_dome(ray: &Ray, radius: f32) -> f32 {
    let b = ray.origin.dot(ray.direction);
    (b * b - ray.origin.length_squared() + radius * radius).max(0.0).sqrt() - b
}

/// Linear radiance of the dome towards its centre, at the unit direction `d` from the centre.
pub(super) fn radiance(d: Vec3) -> Vec3 {
    let (horizon, zenith) = (rgb(0xdfe8ea), rgb(0x4f8fd0));
    let mut sky = horizon.lerp(zenith, step(-0.05, 0.45, d.z).sqrt());
    let towards = d.dot(sun()).max(0.0);
    let glow =
        Vec3::new(1.0, 0.85, 0.62) * (0.35 * towards.powi(6) + 0.9 * towards.powi(60) + 6.0 * towards.powi(1500));
    sky += glow;
    // Soft clouds, stretched along the horizon.
    let billow = fbm(Vec3::new(d.x * 5.0, d.y * 5.0, d.z * 16.0) + 3.0, 4);
    let cover = step(0.46, 0.68, billow) * step(0.0, 0.12, d.z);
    let cloud = Vec3::new(1.0, 0.97, 0.93) * (0.78 + 0.35 * towards * towards);
    sky = sky.lerp(cloud, 0.85 * cover);
    // Two ridges of hills; their edges are soft like those of distant objects.
    let flat = Vec3::new(d.x, d.y, 0.0).normalize_or(Vec3::X);
    let far = 0.035 + 0.085 * fbm(flat * 3.1 + 5.0, 4);
    let near = 0.008 + 0.05 * fbm(flat * 5.3 + 40.0, 3);
    let hill = rgb(0x8aa3b8) * (0.92 + 0.16 * noise(flat * 40.0 + d.z * 60.0));
    let wood = rgb(0x6f8f74) * (0.8 + 0.4 * noise(flat * 60.0 + d.z * 90.0));
    sky = sky.lerp(hill, step(far + 0.004, far - 0.004, d.z));
    sky.lerp(wood, step(near + 0.003, near - 0.003, d.z))
}

/// Light that reaches a matte surface from the sky and, from below, from the ground; the direct sun is left out.
pub(super) fn ambient(normal: Vec3) -> Vec3 {
    let up = 0.5 + 0.5 * normal.z;
    rgb(0x8a8468).lerp(rgb(0xb4cbe6), up) * 0.62
}
