//! Centre and extent of a model, regardless of outliers.

use super::{Gaussians, opacity};
use crate::scene::orbit::Outline;
use crate::scene::weighted_quantile;
use glam::DVec3;

/// Number of Gaussians sampled: enough for quantiles, and quick for models of millions.
const SAMPLES: usize = 200_000;
/// Number of heights at which a model's width is measured.
const RINGS: usize = 32;

/// Outline of a model by quantiles weighted by opacity, on which floaters and far background have little influence.
pub fn outline(model: &Gaussians, up: DVec3) -> Outline {
    let stride = model.len().div_ceil(SAMPLES).max(1);
    let samples: Vec<(DVec3, f64)> = (0..model.len())
        .step_by(stride)
        .map(|i| {
            let weight = opacity(model.opacity_logits[i]);
            (DVec3::from_array(model.means[i].map(f64::from)), weight + 1e-9)
        })
        .collect();
    if samples.is_empty() {
        return Outline { centre: DVec3::ZERO, up, rings: vec![(0.0, 1.0)] };
    }
    let quantile = |mut values: Vec<(f64, f64)>, share: f64| weighted_quantile(&mut values, share).unwrap_or_default();
    let along = |axis: DVec3, among: &[(DVec3, f64)], share: f64| {
        quantile(among.iter().map(|(p, w)| (p.dot(axis), *w)).collect(), share)
    };
    let side = up.any_orthonormal_vector();
    let axes = [side, up.cross(side), up];
    // First the bulk: all Gaussians within four times the median distance from the median point.
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
        // A height with only a few floaters does not belong to the outline.
        if slice.iter().map(|s| s.1).sum::<f64>() > 2e-4 * total {
            let height = low + (high - low) * (i as f64 + 0.5) / RINGS as f64 - centre.dot(up);
            rings.push((height, quantile(slice, 0.985)));
        }
    }
    if rings.iter().all(|r| r.1 <= 0.0) && high <= low {
        // A single Gaussian has only its own extent.
        let own = model.log_scales.first().map_or(0.0, |s| f64::from(s[0].max(s[1]).max(s[2])));
        rings = vec![(0.0, (3.0 * own.exp()).clamp(1e-6, 1e6))];
    }
    Outline { centre, up, rings }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::orbit::Look;

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
        Gaussians::balls(means, -4.0, 3.0, 0)
    }

    #[test]
    fn every_camera_sees_the_whole_in_the_middle() {
        let model = scene();
        let outline = outline(&model, DVec3::NEG_Y);
        for (elevation, size) in [(0.2, (1280, 720)), (-0.3, (300, 900)), (1.4, (640, 640)), (0.0, (50, 400))] {
            for camera in outline.cameras(5, &Look { fov: 0.7, elevation, size }) {
                let mut bounds = [f64::INFINITY, f64::NEG_INFINITY];
                for mean in &model.means[..2500] {
                    let seen = camera.rotation * DVec3::from_array(mean.map(f64::from)) + camera.translation;
                    assert!(seen.z > 0.0);
                    let share = camera.project(seen) / glam::DVec2::new(f64::from(size.0), f64::from(size.1));
                    assert!(share.min_element() > -0.01 && share.max_element() < 1.01, "{share} at {size:?}");
                    bounds = [bounds[0].min(share.y), bounds[1].max(share.y)];
                }
                assert!((bounds[0] + bounds[1] - 1.0).abs() < 0.06, "{bounds:?} at {size:?}");
            }
        }
    }

    #[test]
    fn strange_models_have_finite_cameras() {
        let lone = Gaussians::balls(vec![[1.0, 2.0, 3.0]], -3.0, -20.0, 0);
        let mut flyaway = lone.clone();
        flyaway.means[0] = [f32::MAX, f32::MIN, 1.0];
        flyaway.log_scales[0] = [f32::MAX; 3];
        let pair = scene().select(&[0, 2500]);
        for model in [Gaussians::default(), lone, flyaway, pair] {
            for up in [DVec3::Z, DVec3::NEG_Y, DVec3::X] {
                let look = Look { fov: 0.7, elevation: 0.2, size: (64, 48) };
                for camera in outline(&model, up).cameras(3, &look) {
                    assert!(camera.translation.is_finite() && camera.rotation.is_finite());
                }
            }
        }
    }
}
