//! Cameras on a circle round an object, near enough to fill the picture and far enough to show the whole.

use super::camera::Camera;
use glam::DVec3;

/// Points of a ring that are projected.
const RING_POINTS: u32 = 16;
/// Share of the picture's sides that a model may fill.
const FILL: f64 = 0.92;

/// An object's centre and extent.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Middle of its box.
    pub centre: DVec3,
    /// Up in the world.
    pub up: DVec3,
    /// The solid that it sweeps when turned round `up`: (height over the centre, radius).
    pub rings: Vec<(f64, f64)>,
}

/// The size, field of view and elevation of an orbit's cameras.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Vertical field of view in radians.
    pub fov: f64,
    /// Height of the camera above the horizon in radians.
    pub elevation: f64,
    /// Width and height in pixels.
    pub size: (u32, u32),
}

impl Default for Look {
    /// From 15 degrees above the horizon, 40 degrees high, 1280 x 720 pixels.
    fn default() -> Self {
        Self { fov: 40_f64.to_radians(), elevation: 15_f64.to_radians(), size: (1280, 720) }
    }
}

/// The point that a camera on the circle looks at, and its distance.
#[derive(Clone, Copy, Debug)]
pub struct Framing {
    /// Height of the viewed point above the centre, in world units.
    pub height: f64,
    /// Distance of the camera from that point, in world units.
    pub distance: f64,
}

/// The default up direction: captures keep COLMAP's axes, y down, in every file format.
pub const UP: DVec3 = DVec3::NEG_Y;

impl Outline {
    /// The view from which the whole object fills the picture, centred.
    pub fn framing(&self, look: &Look) -> Framing {
        let reach = self.rings.iter().map(|(h, r)| (h * h + r * r).sqrt()).fold(0.0, f64::max);
        let (mut near, mut far) = (0.0, reach * 200.0 + f64::MIN_POSITIVE);
        for _ in 0..60 {
            let middle = 0.5 * (near + far);
            if self.fits(look, middle).1 { far = middle } else { near = middle }
        }
        Framing { height: self.fits(look, far).0, distance: far }
    }

    /// Height to look at from a distance; true if the whole object is then in the picture.
    fn fits(&self, look: &Look, distance: f64) -> (f64, bool) {
        let tan = (0.5 * look.fov).tan();
        let aspect = f64::from(look.size.0) / f64::from(look.size.1);
        let (sin, cos) = look.elevation.sin_cos();
        let mut target = 0.0;
        for _ in 0..12 {
            let (mut low, mut high, mut across) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
            for (height, radius) in &self.rings {
                for i in 0..=RING_POINTS {
                    // Half a ring: the other half is its mirror image.
                    let (side, towards) = (std::f64::consts::PI * f64::from(i) / f64::from(RING_POINTS)).sin_cos();
                    let (side, towards, above) = (side * radius, towards * radius, height - target);
                    let depth = distance - (towards * cos + above * sin);
                    if depth <= 0.05 * distance {
                        return (target, false);
                    }
                    let y = (above * cos - towards * sin) / (depth * tan);
                    low = low.min(y);
                    high = high.max(y);
                    across = across.max(side / (depth * tan * aspect));
                }
            }
            let off = 0.5 * (low + high);
            if off.abs() < 1e-3 {
                return (target, high - low <= 2.0 * FILL && across <= FILL);
            }
            target += off * tan * distance / cos;
        }
        (target, false)
    }

    /// `count` cameras at even steps round the object, the first in front (towards -z, or -y where z is up).
    pub fn cameras(&self, count: u32, look: &Look) -> Vec<Camera> {
        let framing = self.framing(look);
        (0..count).map(|i| self.camera_at(f64::from(i) / f64::from(count), look, framing)).collect()
    }

    /// The camera after `turns` turns round the object, starting at the front.
    pub fn camera(&self, turns: f64, look: &Look) -> Camera {
        self.camera_at(turns, look, self.framing(look))
    }

    fn camera_at(&self, turns: f64, look: &Look, framing: Framing) -> Camera {
        let Framing { height, distance } = framing;
        let front = if self.up.z.abs() > 0.5 { DVec3::NEG_Y } else { DVec3::NEG_Z };
        // Up may be oblique, as the mean of photos is.
        let front = front.reject_from(self.up).try_normalize().unwrap_or(front);
        let side = self.up.cross(front);
        let target = self.centre + self.up * height;
        let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
        let level = front * cos + side * sin;
        let eye = target + (level * look.elevation.cos() + self.up * look.elevation.sin()) * distance;
        Camera::look_at(eye, target, self.up, look.fov, look.size.0, look.size.1)
    }
}
