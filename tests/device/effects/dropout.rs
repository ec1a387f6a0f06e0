//! Dropout: the kernel leaves out whom its twin does, and runs with it repeat to the bit.

use crate::device::rasterise::render;
use crate::device::train::runs::{bits, options, train, trainer};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{device, finish, repeats};
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::kernels::constants::gradient_row::{ROW, ROW_LOGIT};
use qirf_vk::reference::dropout as twin;
use qirf_vk::render::{Backward, Settings, TrainingRenderer};
use qirf_vk::train::{Options, TrainingModel, dropout};

const KEY: [u32; 2] = [5, 77];

/// The picture has the light of one by the Gaussians left alone, with their raised opacities; the others have no gradient.
#[test]
fn left_out_as_the_twin_has_it() {
    let (camera, share, device) = (small_camera(45, 37), 0.3_f32, device());
    let mut model = narrowed(&random_scene(&camera, 1));
    // At most 0.65: raised, they are below 1.
    model.opacity_logits.iter_mut().for_each(|logit| *logit = logit.min(0.6));
    let training = TrainingModel::new(&device, &model).unwrap();
    let renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), [45, 37], 1 << 14).unwrap();
    let gradient = device.upload("image gradient", &vec![[1.0, -0.5, 0.7, 0.0]; 45 * 37]).unwrap();
    let mut recording = Recording::new();
    renderer.record_lists(&mut recording, &training.model, &camera);
    dropout::record(&mut recording, &renderer, (&training.model, &camera), KEY, share);
    renderer.record_blending(&mut recording, &camera);
    let backward = Backward { growth: Some(&training.growth), ..Backward::default() };
    renderer.record_backward(&mut recording, &training.model, &camera, &gradient, backward);
    device.run(recording).unwrap();
    let picture = renderer.image().read_first(&device, 45 * 37).unwrap();
    let rows = renderer.gradient_rows().values.read(&device).unwrap();

    let out: Vec<bool> = (0..model.len()).map(|i| twin::leaves_out(KEY, i as u32, f64::from(share))).collect();
    let moved = |i: usize| rows[i * ROW as usize..][..=ROW_LOGIT as usize].iter().any(|g| *g != 0.0);
    assert!((0..model.len()).all(|i| !out[i] || !moved(i)));
    assert!((0..model.len()).filter(|i| moved(*i)).count() > 5 && out.iter().filter(|o| **o).count() > 5);
    // Views that showed it: what is left out was not seen.
    let seen: Vec<bool> = training.growth.read(&device).unwrap().iter().map(|[_, views]| *views > 0.0).collect();
    assert!((0..model.len()).all(|i| !(out[i] && seen[i]) && (seen[i] || !moved(i))));

    let kept: Vec<usize> = (0..model.len()).filter(|i| !out[*i]).collect();
    let mut alone = model.select(&kept);
    for logit in &mut alone.opacity_logits {
        let raised = 1.0 / (1.0 + (-*logit).exp()) / (1.0 - share);
        *logit = (raised / (1.0 - raised)).ln();
    }
    let right = render(&device, &alone, &camera, Settings::default()).pixels;
    let off: f32 = picture.iter().zip(&right).map(|(a, b)| (a[0] - b[0]).abs() + (a[1] - b[1]).abs()).sum();
    let light: f32 = right.iter().map(|p| p[0] + p[1]).sum();
    assert!(off < 0.02 * light, "{off} of {light}");
    finish(&device);
}

#[test]
fn runs_with_dropout_repeat_to_the_bit_and_differ_from_those_without() {
    let (device, again) = (device(), repeats());
    let model = |device: &Device, dropout: bool| {
        let mut trainer = trainer(device, Options { dropout, ..options() });
        train(&mut trainer, 40);
        bits(&trainer.download().unwrap())
    };
    let with = model(&device, true);
    assert!(with == model(&again, true) && with != model(&again, false));
    assert!(dropout::share(0, 100, 10) == 0.0 && (dropout::share(50, 100, 10) - 0.1).abs() < 1e-7);
    assert_eq!(dropout::share(900, 100, 10), dropout::share(100, 100, 10));
    // Seventeen and a half times as often as there are photos, and far more often.
    assert!((dropout::share(7000, 7000, 20) - 0.394).abs() < 1e-3 && dropout::share(7000, 7000, 3) == 0.4);
    finish(&device);
}
