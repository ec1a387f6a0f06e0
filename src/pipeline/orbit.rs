//! Cameras on a circle round a model, near enough to fill the picture and far enough to show the whole.

use crate::gaussians::Gaussians;
use crate::scene::camera::Camera;
use glam::DVec3;

/// Gaussians that are looked at: enough for quantiles, and quick for millions.
const SAMPLES: usize = 200_000;

/// Heights at which a model's width is taken.
const RINGS: usize = 32;
/// Points of a ring that are projected.
const RING_POINTS: u32 = 16;
/// How much of the picture a model may fill.
const FILL: f64 = 0.92;

/// Where a model stands, outliers ignored.
#[derive(Clone, Debug, PartialEq)]
pub struct Subject {
    /// Middle of its box.
    pub centre: DVec3,
    /// Up in the world.
    pub up: DVec3,
    /// Its outline when turned round `up`: (height over the centre, radius).
    rings: Vec<(f64, f64)>,
}

/// How to look at it.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Vertical field of view in radians.
    pub fov: f64,
    /// Height of the camera above the horizon in radians.
    pub elevation: f64,
    /// Width and height in pixels.
    pub size: (u32, u32),
}

/// Up where nothing else is said: captures keep COLMAP's axes, y down, in every file format.
pub const UP: DVec3 = DVec3::NEG_Y;

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
            return Self { centre: DVec3::ZERO, up, rings: vec![(0.0, 1.0)] };
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
        let (low, high) = (along(up, &bulk, 0.002), along(up, &bulk, 0.998));
        let mut slices: Vec<Vec<(f64, f64)>> = vec![Vec::new(); RINGS];
        for (point, weight) in &bulk {
            let part = (point.dot(up) - low) / (high - low).max(f64::MIN_POSITIVE);
            if (0.0..=1.0).contains(&part) {
                let radius = (*point - centre).reject_from(up).length();
                slices[((part * RINGS as f64) as usize).min(RINGS - 1)].push((radius, *weight));
            }
        }
        let total: f64 = bulk.iter().map(|b| b.1).sum();
        let mut rings = Vec::new();
        for (i, slice) in slices.into_iter().enumerate() {
            // Thin air with a few floaters is no part of the outline.
            if slice.iter().map(|s| s.1).sum::<f64>() > 2e-4 * total {
                let height = low + (high - low) * (i as f64 + 0.5) / RINGS as f64 - centre.dot(up);
                rings.push((height, quantile(slice, 0.985)));
            }
        }
        if rings.iter().all(|r| r.1 <= 0.0) && high <= low {
            // A lone Gaussian has no spread but its own.
            let own = model.log_scales.first().map_or(0.0, |s| f64::from(s[0].max(s[1]).max(s[2])));
            rings = vec![(0.0, (3.0 * own.exp()).clamp(1e-6, 1e6))];
        }
        Self { centre, up, rings }
    }

    /// Where to look (height over the centre) and from how far, so that the whole fills the picture and sits in its middle.
    pub fn framing(&self, look: &Look) -> (f64, f64) {
        let reach = self.rings.iter().map(|(h, r)| h.hypot(*r)).fold(0.0, f64::max);
        let (mut near, mut far) = (0.0, reach * 200.0 + f64::MIN_POSITIVE);
        for _ in 0..60 {
            let middle = 0.5 * (near + far);
            if self.fits(look, middle).1 { far = middle } else { near = middle }
        }
        (self.fits(look, far).0, far)
    }

    /// For a distance: the height to look at, and whether all is in the picture.
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

    /// `count` cameras at even steps round the subject, the first in front (towards -z, or -y where z is up).
    pub fn cameras(&self, count: u32, look: &Look) -> Vec<Camera> {
        let framing = self.framing(look);
        (0..count).map(|i| self.camera_at(f64::from(i) / f64::from(count), look, framing)).collect()
    }

    /// A camera after so many turns round the subject, from the front.
    pub fn camera(&self, turns: f64, look: &Look) -> Camera {
        self.camera_at(turns, look, self.framing(look))
    }

    fn camera_at(&self, turns: f64, look: &Look, (height, distance): (f64, f64)) -> Camera {
        let front = if self.up.z.abs() > 0.5 { DVec3::NEG_Y } else { DVec3::NEG_Z };
        let side = self.up.cross(front);
        let target = self.centre + self.up * height;
        let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
        let level = front * cos + side * sin;
        let eye = target + (level * look.elevation.cos() + self.up * look.elevation.sin()) * distance;
        Camera::look_at(eye, target, self.up, look.fov, look.size.0, look.size.1)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of radius 3 with a mast of height 2, and one opaque floater far away.
    fn scene() -> Gaussians {
        let mut means: Vec<[f32; 3]> = (0..2000)
            .map(|i| {
                let (r, a) = (3.0 * (i as f32 / 2000.0).sqrt(), i as f32 * 2.4);
                [r * a.cos(), 0.0, r * a.sin()]
            })
            .collect();
        means.extend((0..500).map(|i| [0.0, -2.0 * i as f32 / 500.0, 0.0]));
        means.push([500.0, -800.0, 90.0]);
        let n = means.len();
        Gaussians {
            means,
            log_scales: vec![[-4.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![3.0; n],
            sh: vec![vec![0.0; n * 3]],
        }
    }

    #[test]
    fn every_camera_sees_the_whole_in_the_middle() {
        let model = scene();
        let subject = Subject::of(&model, DVec3::NEG_Y);
        for (elevation, size) in [(0.2, (1280, 720)), (-0.3, (300, 900)), (1.4, (640, 640)), (0.0, (50, 400))] {
            for camera in subject.cameras(5, &Look { fov: 0.7, elevation, size }) {
                let mut bounds = [f64::INFINITY, f64::NEG_INFINITY];
                for mean in &model.means[..2500] {
                    let seen = camera.rotation * DVec3::from_array(mean.map(f64::from)) + camera.translation;
                    assert!(seen.z > 0.0);
                    let pixel = seen.truncate() / seen.z * camera.focal + camera.principal;
                    let share = pixel / glam::DVec2::new(f64::from(size.0), f64::from(size.1));
                    assert!(share.min_element() > -0.01 && share.max_element() < 1.01, "{share} at {size:?}");
                    bounds = [bounds[0].min(share.y), bounds[1].max(share.y)];
                }
                assert!((bounds[0] + bounds[1] - 1.0).abs() < 0.06, "{bounds:?} at {size:?}");
            }
        }
    }

    #[test]
    fn strange_models_have_finite_cameras() {
        let lone = Gaussians {
            means: vec![[1.0, 2.0, 3.0]],
            log_scales: vec![[-3.0; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacity_logits: vec![-20.0],
            sh: vec![vec![0.0; 3]],
        };
        let mut flyaway = lone.clone();
        flyaway.means[0] = [f32::MAX, f32::MIN, 1.0];
        flyaway.log_scales[0] = [f32::MAX; 3];
        let mut pair = scene();
        pair.retain(|i| *i == 0 || *i == 2500);
        for model in [Gaussians::default(), lone, flyaway, pair] {
            for up in [DVec3::Z, DVec3::NEG_Y, DVec3::X] {
                let look = Look { fov: 0.7, elevation: 0.2, size: (64, 48) };
                for camera in Subject::of(&model, up).cameras(3, &look) {
                    assert!(camera.translation.is_finite() && camera.rotation.is_finite());
                }
            }
        }
    }
}
