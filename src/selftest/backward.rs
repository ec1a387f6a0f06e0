//! Gradients against the float64 twin.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::overlap::worse;
use super::random::Kind;
pub use super::rasterise::twin;
use super::rasterise::{camera, stack, straight_on};
use crate::gaussians::Gaussians;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::random::Random;
use crate::reference::{self, Params};
use crate::render::{Backward, Image, Settings, TrainingRenderer};
use crate::scene::camera::Camera;
use crate::train::TrainingModel;
use crate::train::adam::{Moments, record_gradients};
use glam::DVec3;

/// A picture and its gradients.
pub struct Drawn {
    /// The picture.
    pub image: Image,
    /// Gradients of sum(weights . (red, green, blue, alpha)) by the stored parameters.
    pub gradients: Params,
    /// Rows skipped because of a gradient that is not finite.
    pub skipped: u32,
    /// Sums for density control.
    pub growth: Vec<[f32; 2]>,
}

/// Weights of a picture's values, uniform in [-1, 1).
pub fn weights(camera: &Camera, seed: u64) -> Vec<[f32; 4]> {
    let mut r = Random(seed);
    (0..camera.width * camera.height).map(|_| [0; 4].map(|_| r.within(-1.0, 1.0) as f32)).collect()
}

/// First moments of all parameters, in which [`record_gradients`] leaves the gradients.
pub(super) fn first_moments(device: &Device, moments: &Moments, degree: usize) -> Result<Params> {
    let read = |moments: &Buffer<[f32; 2]>| -> Result<Vec<f64>> {
        Ok(moments.read(device)?.iter().map(|m| f64::from(m[0])).collect())
    };
    Ok(Params::of_attributes(moments.each_ref().try_map(read)?, degree + 1))
}

/// Renders a model and computes the gradients of the picture.
pub fn there_and_back(
    device: &Device,
    model: &Gaussians,
    camera: &Camera,
    settings: Settings,
    weights: &[[f32; 4]],
) -> Result<Drawn> {
    there_and_back_as(device, model, camera, settings, weights, Backward::default())
}

/// The same by a backward pass of another kind.
pub fn there_and_back_as(
    device: &Device,
    model: &Gaussians,
    camera: &Camera,
    settings: Settings,
    weights: &[[f32; 4]],
    backward: Backward<'_>,
) -> Result<Drawn> {
    let training = TrainingModel::new(device, model)?;
    let size = [camera.width, camera.height];
    let mut renderer = TrainingRenderer::new(device, settings, model.len(), size, 1 << 12)?;
    let image = renderer.render(&training.model, camera)?; // also makes room for the pairs
    let by_image = device.upload("image gradient", weights)?;
    let mut recording = Recording::new();
    renderer.record(&mut recording, &training.model, camera);
    let backward = Backward { growth: Some(&training.growth), ..backward };
    renderer.record_backward(&mut recording, &training.model, camera, &by_image, backward);
    record_gradients(&mut recording, &renderer, &training.model, &training.moments);
    device.run(recording)?;
    let skipped = renderer.backward_counts()?.skipped_rows;
    let gradients = first_moments(device, &training.moments, model.degree())?;
    Ok(Drawn { image, gradients, skipped, growth: training.growth.read(device)? })
}

/// The twin's gradients for the same picture.
pub fn expected(model: &Gaussians, camera: &Camera, settings: Settings, weights: &[[f32; 4]]) -> Params {
    let by_image: Vec<[f64; 3]> = weights.iter().map(|w| [w[0], w[1], w[2]].map(f64::from)).collect();
    let by_alpha: Vec<f64> = weights.iter().map(|w| f64::from(w[3])).collect();
    reference::gradients(&Params::from(model), camera, &twin(settings), &by_image, Some(&by_alpha)).params
}

/// Norm of the difference over the twin's norm, or over `least` if that is larger: the worst of all attributes.
pub fn relative(got: &mut Params, expected: &mut Params, least: f64) -> f64 {
    let pairs = got.groups_mut().into_iter().zip(expected.groups_mut());
    pairs.fold(0.0, |most, ((_, g), (_, e))| {
        let off: f64 = g.iter().zip(e.iter()).map(|(g, e)| (g - e).powi(2)).sum();
        let size: f64 = e.iter().map(|e| e * e).sum();
        worse(most, off.sqrt() / size.sqrt().max(least).max(f64::MIN_POSITIVE))
    })
}

/// A millionth of the largest gradient that the weights can cause: the scale for gradients that vanish, such as that of
/// a ball's rotation.
pub fn least(weights: &[[f32; 4]]) -> f64 {
    1e-6 * weights.as_flattened().iter().map(|w| f64::from(w.abs())).sum::<f64>()
}

/// Largest relative error of gradients. Float32 alone causes 4e-6; a contribution on the wrong side of 1/255 causes
/// 1e-4; a wrong clamp 6e-4 and more.
pub(super) const ALLOWED: f64 = 3e-4;

fn compare(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings) -> Result<Vec<Measure>> {
    let weights = weights(camera, 71);
    let mut drawn = there_and_back(device, model, camera, settings, &weights)?;
    let least = least(&weights);
    let seen = relative(&mut drawn.gradients, &mut expected(model, camera, settings, &weights), least);
    Ok(vec![("relative", seen, Rounding(ALLOWED)), ("rows skipped", f64::from(drawn.skipped), Exact(0.0))])
}

/// Compares the gradients of a random model.
pub(super) fn random(device: &Device, kind: &Kind, settings: Settings) -> Result<Vec<Measure>> {
    compare(device, &kind.model(), &camera(64, 48), settings)
}

/// `count` layers of random colours before one small tile.
fn layers(count: usize, depth: f32, logit: f32) -> Gaussians {
    let mut r = Random(26);
    let mut model = stack(count, depth, logit);
    model.sh[0].iter_mut().for_each(|v| *v = r.within(-1.5, 1.5) as f32);
    model
}

/// Compares the gradients of 10,000 layers of equal depth, blended in the model's order; the transmittance stop ends
/// the pixels.
pub(super) fn coincident(device: &Device) -> Result<Vec<Measure>> {
    compare(device, &layers(10_000, 0.0, -3.0), &straight_on(), Settings::default())
}

/// 10,000 layers without a stop: transmittance leaves float32's range on the way. The colour behind a layer is the
/// pixel minus the colour before it: its rounding, 1e-7 of the pixel, remains long after the colour itself has
/// vanished.
pub(super) fn chain(device: &Device) -> Result<Vec<Measure>> {
    compare(device, &layers(10_000, 1e-5, -3.9), &straight_on(), Settings { stop: 0.0, ..Settings::default() })
}

/// One pixel behind layers of one colour and opacity, before black: dL/dalpha is a difference of nearly equal values,
/// and its error is that of two sums with one rounding per layer drawn. Measures the worst layer's error in units of
/// (8 + the root of the number of layers drawn) roundings of the colour: 0.65, even if exponentials are off by two
/// roundings.
pub(super) fn alike(device: &Device) -> Result<Vec<Measure>> {
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.5, 1, 1);
    let weights = [[1.0, 1.0, 1.0, 0.0]];
    let mut most = 0.0;
    for (logit, count) in [(-5.4, 10_000), (-5.0, 100), (-5.0, 10_000), (-4.0, 1000), (-3.0, 100), (-1.0, 100)] {
        let mut model = stack(count, 0.0, logit);
        model.sh[0].fill(1.3);
        let got = there_and_back(device, &model, &camera, Settings::default(), &weights)?.gradients;
        let right = expected(&model, &camera, Settings::default(), &weights);
        let drawn = right.opacity_logits.iter().filter(|g| **g != 0.0).count() as f64;
        let opacity = 1.0 / (1.0 + (-f64::from(logit)).exp());
        // Contribution of a layer: 3 (0.5 + C0 1.3).
        let allowed = (8.0 + drawn.sqrt()) * 2_f64.powi(-24) * 2.6 * opacity * (1.0 - opacity);
        let pairs = got.opacity_logits.iter().zip(&right.opacity_logits);
        most = pairs.fold(most, |m, (g, e)| worse(m, (g - e).abs() / allowed));
    }
    Ok(vec![("over a walk of roundings", most, Rounding(2.0))])
}
