//! Models in units and places that SPZ's limits and steps would spoil: a page moves and scales them, and shows the same.

use super::PageOptions;
use crate::gaussians::Gaussians;
use crate::gaussians::outline::outline;
use crate::scene::camera::Camera;
use crate::scene::median;
use glam::{DMat3, DVec3};
use std::f64::consts::LN_2;
use std::ops::RangeInclusive;

/// Logarithms of the median Gaussian's size, its largest standard deviation in world units, for which SPZ's limits of exp(-10)
/// and exp(5.94) are far from most Gaussians.
const ORDINARY: RangeInclusive<f64> = -7.5..=1.5;
/// The logarithm that a model of another size gets.
const USUAL: f64 = -4.0;
/// SPZ's steps of coordinates from the origin to the farthest mean: 24 bits with a sign.
const STEPS: f64 = 8_388_607.0;
/// A step of this share of the median Gaussian's size moves nothing visibly.
const FINE: f64 = 1.0 / 16.0;

/// How a page moves and scales its model: x becomes (x - centre) scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The new origin, in world units.
    centre: DVec3,
    /// A power of two.
    scale: f64,
}

impl Fit {
    /// The move and scale that a model needs; `None` for models of ordinary size and place, and for empty ones.
    pub fn of(model: &Gaussians) -> Option<Self> {
        let largest = model.log_scales.iter().map(|s| s.iter().fold(f32::MIN, |a, b| a.max(*b)));
        let size = f64::from(median(&mut largest.collect::<Vec<f32>>())?);
        let (centre, reach) = origin(model, size.exp());
        let halvings = ((size - USUAL) / LN_2).round().clamp(-300.0, 300.0) as i32;
        // No scale helps where a step is longer than the Gaussians.
        let ordinary = ORDINARY.contains(&size) || reach > STEPS * size.exp();
        let scale = if ordinary { 1.0 } else { 0.5_f64.powi(halvings) };
        (scale != 1.0 || centre != DVec3::ZERO).then_some(Self { centre, scale })
    }

    /// Moves and scales a model and the options of its page alike.
    pub fn apply(&self, model: &mut Gaussians, options: &mut PageOptions) {
        let Self { centre, scale } = *self;
        model.transform(DMat3::IDENTITY, scale, -centre * scale);
        options.start = options.start.take().map(|camera| {
            let moved = camera.relative_to(centre);
            Camera { translation: moved.translation * scale, ..moved }
        });
        options.target = options.target.map(|target| (target - centre) * scale);
        options.near = options.near.map(|near| (f64::from(near) * scale) as f32);
    }
}

/// The new origin of a model whose median Gaussian has this size, and the distance of the farthest mean from it: the model's
/// middle, if SPZ's steps are too coarse at its place and half as long there or less; else the old one.
fn origin(model: &Gaussians, size: f64) -> (DVec3, f64) {
    let reach = |from: DVec3| {
        let distances = model.means.iter().map(|m| (DVec3::from(m.map(f64::from)) - from).abs().max_element());
        distances.fold(0.0, f64::max)
    };
    let own = reach(DVec3::ZERO);
    // A step is a power of two: up to twice as long.
    if 2.0 * own / STEPS > FINE * size {
        let middle = outline(model, DVec3::NEG_Y).centre;
        let there = reach(middle);
        if there <= 0.5 * own {
            return (middle, there);
        }
    }
    (DVec3::ZERO, own)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blob(place: DVec3, unit: f64) -> Gaussians {
        let spots = (0..50).map(|i| DVec3::new(f64::from(i).sin(), f64::from(i).cos(), 0.02 * f64::from(i)));
        let means = spots.map(|p| (place + p * unit).as_vec3().to_array()).collect();
        Gaussians::balls(means, (0.05 * unit).ln() as f32, 2.0, 0)
    }

    #[test]
    fn only_models_of_unusual_size_or_place_are_moved_and_their_pictures_stay() {
        for ordinary in [Gaussians::default(), Gaussians::zeroed(3, 1), blob(DVec3::new(9.0, -70.0, 3.0), 1.0)] {
            assert_eq!(Fit::of(&ordinary), None);
        }
        let far = DVec3::new(400_000.0, -90_000.0, 300.0);
        let near = DVec3::ZERO;
        for (place, unit) in [(near, 1e-4), (near, 1e6), (far, 1.0), (0.1 * far, 1e3), (100.0 * far, 100.0)] {
            let mut model = blob(place, unit);
            let eye = place + DVec3::new(0.5, 1.0, -4.0) * unit;
            let camera = Camera::look_at(eye, place, DVec3::NEG_Y, 0.7, 64, 48);
            let seen = |model: &Gaussians, camera: &Camera, i: usize| {
                let mean = DVec3::from(model.means[i].map(f64::from));
                camera.project(camera.rotation * mean + camera.translation)
            };
            let before = [0, 7, 49].map(|i| seen(&model, &camera, i));
            let mut options = PageOptions { start: Some(camera), ..PageOptions::default() };
            (options.target, options.near) = (Some(place), Some((0.02 * unit) as f32));
            let fit = Fit::of(&model).unwrap_or_else(|| panic!("{place} {unit} needs it"));
            fit.apply(&mut model, &mut options);
            let start = options.start.unwrap();
            for (i, pixel) in [0, 7, 49].into_iter().zip(before) {
                assert!(pixel.distance(seen(&model, &start, i)) < 0.1, "{place} {unit}: mean {i}");
            }
            assert!((-5.0..1.6).contains(&model.log_scales[0][0]), "{place} {unit}: {}", model.log_scales[0][0]);
            assert!(model.means.as_flattened().iter().all(|x| x.abs() < 150.0), "{place} {unit}");
            let length = options.target.unwrap().distance(start.centre()) * f64::from(options.near.unwrap()).recip();
            assert!((length / (DVec3::new(0.5, 1.0, -4.0).length() / 0.02) - 1.0).abs() < 1e-3, "{length}");
            assert_eq!(Fit::of(&model), None, "once is enough");
        }
        // What no scale helps is left for SPZ to refuse.
        let mut dust = blob(near, 1.0);
        dust.log_scales.fill([-87.0; 3]);
        assert_eq!(Fit::of(&dust), None);
    }
}
