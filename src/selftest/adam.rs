//! Adam under ordinary and impossible gradients.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::backward::weights;
use super::overlap::worse;
use super::random::Kind;
use super::rasterise::{MILD, camera};
use crate::gaussians::Gaussians;
use crate::gpu::{Device, Recording, Result};
use crate::reference::{self, Params};
use crate::render::{Backward, Settings, TrainingRenderer};
use crate::train::TrainingModel;
use crate::train::adam;
use crate::train::rates::{Rates, Step};

const RATES: Rates = Rates {
    means: 1e-3,
    log_scales: 5e-3,
    rotations: 1e-3,
    opacity_logits: 0.025,
    sh: [2.5e-3, 1.25e-4, 1.25e-4, 1.25e-4],
};
const STEPS: u32 = 5;

fn model() -> Gaussians {
    Kind { count: 100, seed: 31, ..MILD }.model()
}

/// A model after some steps under a constant gradient of its picture, and the guards' counts.
struct Stepped {
    params: Params,
    skipped: u32,
    /// The device's own gradients before each step, if requested.
    gradients: Vec<Params>,
}

fn steps(device: &Device, by_image: &[[f32; 4]], with_gradients: bool) -> Result<Stepped> {
    let (model, camera) = (model(), camera(48, 48));
    let training = TrainingModel::new(device, &model)?;
    let mut renderer = TrainingRenderer::new(device, Settings::default(), model.len(), [48, 48], 1 << 13)?;
    renderer.render(&training.model, &camera)?;
    let apart = adam::zeros(device, &training.model)?;
    let by_image = device.upload("image gradient", by_image)?;
    let mut skipped = 0;
    let mut gradients = Vec::new();
    for k in 1..=STEPS {
        let mut recording = Recording::new();
        renderer.reset_backward_counts(&mut recording);
        renderer.record(&mut recording, &training.model, &camera);
        renderer.record_backward(&mut recording, &training.model, &camera, &by_image, Backward::default());
        if with_gradients {
            adam::record_gradients(&mut recording, &renderer, &training.model, &apart);
        }
        adam::record(&mut recording, &renderer, &training, Step::new(k, RATES));
        device.run(recording)?;
        skipped += renderer.backward_counts()?.skipped_rows;
        if with_gradients {
            gradients.push(super::backward::first_moments(device, &apart, model.degree())?);
        }
    }
    Ok(Stepped { params: Params::from(&training.model.download(device)?), skipped, gradients })
}

/// Compares every parameter after five steps with Adam in float64 on the device's gradients, in units of the allowed
/// error: a ten-thousandth of the distance that the rates allow (1 - 0.999 in float32 causes 1.3e-5 of a step), plus
/// one rounding of the parameter per step.
pub(super) fn ordinary(device: &Device) -> Result<Vec<Measure>> {
    let mut done = steps(device, &weights(&camera(48, 48), 73), true)?;
    let mut twin = Params::from(&model());
    let (mut first, mut second) = (twin.zeros_like(), twin.zeros_like());
    let rates = RATES.into_array();
    for (k, gradients) in (1..).zip(&mut done.gradients) {
        let groups = twin.groups_mut().into_iter().zip(gradients.groups_mut());
        let moments = first.groups_mut().into_iter().zip(second.groups_mut());
        for (((values, gradients), (m, v)), rate) in groups.zip(moments).zip(rates) {
            reference::adam::adam(
                values.1,
                gradients.1,
                [m.1, v.1],
                (k, f64::from(rate), [reference::adam::BETA1, reference::adam::BETA2]),
            );
        }
    }
    let mut most = 0.0;
    for (((_, got), (_, right)), rate) in done.params.groups_mut().into_iter().zip(twin.groups_mut()).zip(rates) {
        for (g, r) in got.iter().zip(right.iter()) {
            let allowed = f64::from(STEPS) * (1e-4 * f64::from(rate) + r.abs() * 2_f64.powi(-24));
            most = worse(most, (g - r).abs() / allowed);
        }
    }
    Ok(vec![("error over its tolerance", most, Rounding(1.0)), ("rows skipped", f64::from(done.skipped), Exact(0.0))])
}

/// Largest change of any parameter, over its attribute's rate and the steps; infinite if one is NaN.
fn furthest(params: &mut Params) -> f64 {
    let mut start = Params::from(&model());
    let rates = RATES.into_array();
    let mut most = 0.0;
    for (((_, got), (_, start)), rate) in params.groups_mut().into_iter().zip(start.groups_mut()).zip(rates) {
        for (g, s) in got.iter().zip(start.iter()) {
            most = worse(most, (g - s).abs() / f64::from(rate) / f64::from(STEPS));
        }
    }
    most
}

/// Gradients of the picture that are zero, that are so small that their square is zero, that are so large that their
/// square is infinite, and that are NaN in one pixel.
pub(super) fn extremes(device: &Device) -> Result<Vec<Measure>> {
    let size = 48 * 48;
    let mut zero = steps(device, &vec![[0.0; 4]; size], false)?;
    let mut tiny = steps(device, &vec![[1e-38; 4]; size], false)?;
    let mut huge = steps(device, &vec![[1e38; 4]; size], false)?;
    let mut spoilt = vec![[0.5; 4]; size];
    spoilt[size / 2 + 24] = [f32::NAN; 4];
    let mut one = steps(device, &spoilt, false)?;
    // The number of rows under that pixel: they stay unchanged, and are counted in each step.
    let mut start = Params::from(&model());
    let moved = |params: &mut Params, start: &mut Params| -> usize {
        let (got, was) = (params.clone(), start.clone());
        (0..got.means.len()).filter(|i| got.means[*i] != was.means[*i]).count()
    };
    let seen_and_sound = moved(&mut steps(device, &vec![[0.5; 4]; size], false)?.params, &mut start);
    let stayed = seen_and_sound - moved(&mut one.params, &mut start).min(seen_and_sound);
    Ok(vec![
        ("0: moved", furthest(&mut zero.params), Exact(0.0)),
        ("0: rows skipped", f64::from(zero.skipped), Exact(0.0)),
        // Such gradients are negligible beside Adam's epsilon of 1e-15.
        ("1e-38: moved", furthest(&mut tiny.params), Exact(1e-6)),
        ("1e-38: rows skipped", f64::from(tiny.skipped), Exact(0.0)),
        ("1e38: moved", furthest(&mut huge.params), Exact(0.0)),
        ("1e38: skips not counted", f64::from(huge.skipped).min(1.0) - 1.0, Exact(0.0)),
        // A step of Adam is at most 0.1 / sqrt(0.001) of its rate.
        ("NaN: furthest, in rates", furthest(&mut one.params), Exact(3.2)),
        ("NaN: skips not counted", (f64::from(one.skipped) / f64::from(STEPS) - stayed as f64).abs(), Exact(0.0)),
        ("NaN: rows that stayed, of the seen", stayed as f64 / seen_and_sound.max(1) as f64, Exact(0.5)),
    ])
}
