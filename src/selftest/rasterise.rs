//! Pictures against the float64 twin, against repeated ones, and against those without culling.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::random::Kind;
use crate::gaussians::{Gaussians, resident::Resident};
use crate::gpu::{Device, Result};
use crate::reference;
use crate::render::{Culling, Image, Renderer, Settings, Style};
use crate::scene::camera::Camera;
use glam::DVec3;

pub(super) const MILD: Kind = Kind {
    count: 500,
    seed: 11,
    log_scale: [-3.0, -1.2],
    axes: [0.0; 3],
    logit: [-3.0, 3.0],
    degree: 3,
    colour: [-1.0, 1.8],
};
pub(super) const NEEDLES: Kind = Kind { axes: [1.2, -4.0, -4.0], degree: 1, ..MILD };
pub(super) const DISCS: Kind = Kind { axes: [0.5, 0.5, -9.0], degree: 2, ..MILD };
pub(super) const SATURATED: Kind = Kind { logit: [2.0, 20.0], colour: [-3.0, 4.0], degree: 1, ..MILD };
/// Most of them are smaller than a pixel.
pub(super) const DUST: Kind = Kind { log_scale: [-9.0, -3.0], logit: [0.0, 8.0], degree: 0, ..MILD };
/// Long and intersecting, so that their order differs between tiles.
pub(super) const CROSSED: Kind = Kind { axes: [1.0, 1.0, -4.0], ..MILD };

pub(super) fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.5, -0.7, -3.5), DVec3::ZERO, DVec3::NEG_Y, 0.9, width, height)
}

/// The picture, and the side of its tiles.
fn draw_tiled(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings) -> Result<(Image, u32)> {
    let resident = Resident::upload(device, model)?;
    let mut renderer = Renderer::new(device, settings, model.len(), camera.width, camera.height)?;
    Ok((renderer.render(&resident, camera)?, renderer.tile()))
}

fn draw(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings) -> Result<Image> {
    draw_tiled(device, model, camera, settings).map(|(image, _)| image)
}

/// The same settings for the twin, except the size of tiles.
pub fn twin(settings: Settings) -> reference::Settings {
    reference::Settings {
        background: settings.background.map(f64::from),
        antialias: settings.style.antialias,
        dilation: f64::from(settings.dilation),
        transmittance_stop: f64::from(settings.stop),
        near: f64::from(settings.near),
        depth_order: settings.style.depth_order,
        ..reference::Settings::default()
    }
}

/// Errors of the device's picture, red, green, blue and alpha: mean, share beyond 1e-4, largest.
fn errors(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings) -> Result<[f64; 3]> {
    let (image, tile) = draw_tiled(device, model, camera, settings)?;
    let settings = reference::Settings { tile, ..twin(settings) };
    let expected = reference::render(&reference::Params::from(model), camera, &settings).composite;
    let (mut sum, mut beyond, mut largest, mut count) = (0.0, 0, 0.0_f64, 0);
    for (pixel, (rgb, alpha)) in image.pixels.iter().zip(expected.image.iter().zip(&expected.alpha)) {
        for (got, wanted) in pixel.iter().zip([rgb[0], rgb[1], rgb[2], *alpha]) {
            let error = (f64::from(*got) - wanted).abs();
            // NaN must not be lost in a maximum.
            let error = if error.is_nan() { f64::INFINITY } else { error };
            sum += error;
            beyond += usize::from(error > 1e-4);
            largest = largest.max(error);
            count += 1;
        }
    }
    let count = f64::from(count.max(1));
    Ok([sum / count, beyond as f64 / count, largest])
}

/// Float32 sometimes puts a contribution on the other side of the 1/255 cut-off, which moves a pixel by up to 4e-3.
pub(super) fn against_twin(device: &Device, kind: &Kind, settings: Settings) -> Result<Vec<Measure>> {
    errors(device, &kind.model(), &camera(96, 64), settings).map(measures)
}

fn measures([mean, share, largest]: [f64; 3]) -> Vec<Measure> {
    vec![
        ("mean", mean, Rounding(5e-6)),
        ("share beyond 1e-4", share, Rounding(5e-4)),
        ("largest", largest, Rounding(8e-3)),
    ]
}

/// Anti-aliased Gaussians smaller than a pixel, with both dilations.
pub(super) fn antialiased(device: &Device) -> Result<Vec<Measure>> {
    let kind = Kind { count: 3000, seed: 15, ..DUST };
    let mut worst = [0.0_f64; 3];
    for dilation in Style::DILATIONS {
        let style = Style { antialias: true, dilation: Some(dilation), ..Style::default() };
        let errors = errors(device, &kind.model(), &camera(96, 64), style.over([0.0; 3]))?;
        worst = [0, 1, 2].map(|i| worst[i].max(errors[i]));
    }
    Ok(measures(worst))
}

pub(super) fn odd_sizes(device: &Device) -> Result<Vec<Measure>> {
    let model = Kind { count: 200, seed: 16, degree: 0, ..MILD }.model();
    let (mut mean, mut largest) = (0.0_f64, 0.0_f64);
    for (width, height) in [(1, 1), (17, 3), (3, 33), (2048, 4)] {
        let [m, _, l] = errors(device, &model, &camera(width, height), Settings::default())?;
        mean = mean.max(m);
        largest = largest.max(l);
    }
    Ok(vec![("mean", mean, Rounding(5e-6)), ("largest", largest, Rounding(8e-3))])
}

/// More tiles than a dispatch has groups in one dimension, and Gaussians half a million pixels from the corner, where
/// float32 resolves positions to 1/16 of a pixel: relative to the corner, the largest error would be 1e-2.
pub(super) fn widest(device: &Device) -> Result<Vec<Measure>> {
    let model = Kind { count: 200, seed: 16, degree: 0, ..MILD }.model();
    let [_, _, largest] = errors(device, &model, &camera(1_048_592, 1), Settings::default())?;
    Ok(vec![("largest", largest, Rounding(1e-4))])
}

/// `count` layers before one small tile.
pub(super) fn stack(count: usize, depth: f32, logit: f32) -> Gaussians {
    let means = (0..count).map(|i| [0.0, 0.0, 2.0 + i as f32 * depth]).collect();
    Gaussians {
        sh: vec![(0..count).flat_map(|i| [i as f32 / count as f32, 0.2, -(i as f32 / count as f32)]).collect()],
        ..Gaussians::balls(means, -1.0, logit, 0)
    }
}

pub(super) fn straight_on() -> Camera {
    Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.5, 8, 8)
}

pub(super) fn deep(device: &Device) -> Result<Vec<Measure>> {
    let settings = Settings { stop: 0.0, ..Settings::default() };
    let [_, _, largest] = errors(device, &stack(100_000, 1e-5, -5.5), &straight_on(), settings)?;
    Ok(vec![("largest", largest, Rounding(1e-4))])
}

pub(super) fn ties(device: &Device) -> Result<Vec<Measure>> {
    let [_, _, largest] = errors(device, &stack(10_000, 0.0, -3.0), &straight_on(), Settings::default())?;
    Ok(vec![("largest", largest, Rounding(1e-5))])
}

fn differing(a: &Image, b: &Image) -> f64 {
    let bits = |p: &[f32; 4]| p.map(f32::to_bits);
    a.pixels.iter().zip(&b.pixels).filter(|(a, b)| bits(a) != bits(b)).count() as f64
}

pub(super) fn repeat(device: &Device) -> Result<Vec<Measure>> {
    let model = Kind { count: 5000, seed: 17, degree: 1, ..MILD }.model();
    let camera = camera(320, 200);
    let first = draw(device, &model, &camera, Settings::default())?;
    let mut wrong = 0.0;
    for _ in 0..3 {
        wrong += differing(&first, &draw(device, &model, &camera, Settings::default())?);
    }
    Ok(vec![("pixels that changed", wrong, Exact(0.0))])
}

pub(super) fn culling(device: &Device) -> Result<Vec<Measure>> {
    let model = Kind { seed: 18, axes: [1.0, -1.0, -3.0], degree: 0, ..MILD }.model();
    let camera = camera(173, 99);
    let with = |culling| draw(device, &model, &camera, Settings { culling, ..Settings::default() });
    let all = with(Culling::Off)?;
    let exact = differing(&with(Culling::Exact)?, &all);
    Ok(vec![("exact: pixels changed", exact, Exact(0.0))])
}
