//! The solids that a tile of the picture can show, so that its rays need not search the whole scene.

use glam::{DVec2, Vec3};

use super::{geometry::Solid, path::View};

/// Side of a tile in pixels.
pub(super) const TILE: u32 = 8;

/// For each solid, the direction to its bounding sphere and the sphere's angular radius, as one photo sees them.
pub(super) struct Outlook {
    spheres: Vec<(Vec3, f32)>,
}

impl Outlook {
    pub fn new(solids: &[Solid], origin: Vec3) -> Self {
        let sphere = |solid: &Solid| {
            let (low, high) = solid.bounds();
            let (to, radius) = (0.5 * (low + high) - origin, 0.5 * low.distance(high));
            let far = to.length();
            // An angular radius of pi stands for all directions: the eye is within the sphere.
            let radius = if far <= radius { std::f32::consts::PI } else { (radius / far).asin() };
            (to / far.max(1e-6), radius)
        };
        Self { spheres: solids.iter().map(sphere).collect() }
    }

    /// Indices of the solids that may show in the tile whose upper left pixel is (x, y), in ascending order.
    pub fn tile(&self, view: &View, x: u32, y: u32, list: &mut Vec<u32>) {
        let ray = |dx: u32, dy: u32| view.ray(DVec2::new(f64::from(x + dx), f64::from(y + dy))).direction;
        let middle = ray(TILE / 2, TILE / 2);
        // 1.5 times the angle to the furthest corner: lenses may bend the tile's sides outwards.
        let corners = [ray(0, 0), ray(TILE, 0), ray(0, TILE), ray(TILE, TILE)];
        let reach = corners.into_iter().map(|c| c.angle_between(middle)).fold(0.0, f32::max) * 1.5 + 1e-3;
        list.clear();
        for (i, &(towards, radius)) in self.spheres.iter().enumerate() {
            let angle = reach + radius;
            if angle >= std::f32::consts::PI || towards.dot(middle) >= angle.cos() {
                list.push(i as u32);
            }
        }
    }
}
