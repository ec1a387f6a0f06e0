//! The backward pass on the device, against golden gradients and the float64 twin's.

use super::bin::crowd_of_all_sizes;
use crate::support::golden::Case;
use crate::support::gradient_bounds::{gradient_bounds, within};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish, opened, relative};
use glam::{DVec2, DVec3};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::Device;
use qirf_vk::kernels::constants::blending::TRANSMITTANCE_STOP;
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Backward, Settings, Style};
use qirf_vk::scene::camera::Camera;
use qirf_vk::selftest::backward::{Drawn, expected, there_and_back_as, twin, weights};
use qirf_vk::selftest::project::ahead;

/// Gradients of sum(weights . (red, green, blue, alpha)) by the stored parameters, computed on the device.
fn gradients(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings, weights: &[[f32; 4]]) -> Params {
    drawn(device, model, camera, settings, weights, Backward::default()).gradients
}

fn drawn(
    device: &Device,
    model: &Gaussians,
    camera: &Camera,
    settings: Settings,
    weights: &[[f32; 4]],
    backward: Backward<'_>,
) -> Drawn {
    let drawn = there_and_back_as(device, model, camera, settings, weights, backward).unwrap();
    assert_eq!(drawn.skipped, 0);
    drawn
}

fn compare(name: &str, got: &mut Params, expected: &mut Params, allowed: f64) {
    let mut line = format!("{name}:");
    let mut worst = 0_f64;
    for ((group, g), (_, e)) in got.groups_mut().into_iter().zip(expected.groups_mut()) {
        let error = relative(g, e);
        line += &format!(" {group} {error:.1e}");
        worst = worst.max(error);
    }
    println!("{line}");
    assert!(worst < allowed, "{line}");
}

/// Bands one after the other from the oracle's n x (L + 1)^2 x 3.
fn bands(all: &[f64], degree: usize) -> Vec<Vec<f64>> {
    let row = (degree + 1) * (degree + 1) * 3;
    (0..=degree)
        .map(|l| all.chunks_exact(row).flat_map(|r| r[l * l * 3..(l + 1) * (l + 1) * 3].to_vec()).collect())
        .collect()
}

fn params(means: &[f64], log_scales: &[f64], rotations: &[f64], logits: &[f64], sh: Vec<Vec<f64>>) -> Params {
    let rows3 = |v: &[f64]| v.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    Params {
        means: rows3(means),
        log_scales: rows3(log_scales),
        rotations: rotations.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect(),
        opacity_logits: logits.to_vec(),
        sh,
    }
}

#[test]
fn golden_gradients() {
    let device = device();
    for case in Case::all() {
        let settings = case.device_settings();
        let exact = Params::from(&case.model);
        let (mut sum, mut bounds) = (exact.zeros_like(), exact.zeros_like());
        for (v, camera) in case.views.iter().enumerate() {
            let weights: Vec<[f32; 4]> = case
                .expected_view("loss_weights", v)
                .chunks_exact(3)
                .map(|w| [w[0] as f32, w[1] as f32, w[2] as f32, 0.0])
                .collect();
            sum.add(&gradients(&device, &case.model, camera, settings, &weights));
            let weights: Vec<_> = weights.iter().map(|w| w.map(f64::from)).collect();
            bounds.add(&gradient_bounds(&exact, camera, &case.settings, &weights));
        }
        let get = |key: &str| case.expected(key);
        let expected = params(
            &get("grad_xyz"),
            &get("grad_scale"),
            &get("grad_rotation"),
            &get("grad_opacity"),
            bands(&get("grad_sh"), case.model.degree()),
        );
        within(&case.name, &sum, &expected, &bounds, 0.5);
    }
    finish(&device);
}

/// Fails if a gradient differs from the twin's by more than its own bound. Returns the twin's.
fn each_within(
    name: &str,
    got: &Params,
    model: &Gaussians,
    camera: &Camera,
    settings: Settings,
    weights: &[[f32; 4]],
) -> Params {
    let expected = expected(model, camera, settings, weights);
    let weights: Vec<[f64; 4]> = weights.iter().map(|w| w.map(f64::from)).collect();
    let bounds = gradient_bounds(&Params::from(model), camera, &twin(settings), &weights);
    within(name, got, &expected, &bounds, 0.5);
    expected
}

#[test]
fn project_backward_and_rasterise_backward_give_the_twins_gradients() {
    let device = device();
    let camera = small_camera(45, 37);
    for seed in [2, 3, 4] {
        for antialias in [false, true] {
            let model = narrowed(&random_scene(&camera, seed));
            let weights = weights(&camera, seed);
            let settings = Style { antialias, ..Style::default() }.over([0.3, 0.6, 0.1]);
            let got = gradients(&device, &model, &camera, settings, &weights);
            let name = format!("seed {seed}, antialias {antialias}");
            each_within(&name, &got, &model, &camera, settings, &weights);
        }
    }
    finish(&device);
}

/// Subgroups that jointly add up a Gaussian's slots, and invocations that jointly store their rows, against invocations
/// that work alone: sums of positive and negative numbers in another order differ by rounding.
#[test]
fn slots_added_up_together_or_alone() {
    let model = crowd_of_all_sizes();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, 333, 210);
    let weights = weights(&camera, 11);
    let backward = Backward { absolute: true, ..Backward::default() };
    let [alone, all, many] = [0, 1, 32].map(|many| {
        let tuning = Some(format!("gpu,bin_many={many}").parse().unwrap());
        let device = opened(|options| options.tuning = tuning);
        let got = drawn(&device, &model, &camera, Settings::default(), &weights, backward);
        finish(&device);
        got
    });
    for (name, Drawn { mut gradients, growth, .. }) in [("all", all), ("from 32 on", many)] {
        compare(name, &mut gradients, &mut alone.gradients.clone(), 3e-6);
        assert!(growth.len() == model.len() && growth.iter().filter(|g| g[1] > 0.0).count() > 200);
        for (i, (got, expected)) in growth.iter().zip(&alone.growth).enumerate() {
            // Absolute values have one sign: a thousand additions are within a thousand roundings.
            assert!(
                got[1] == expected[1] && (got[0] - expected[0]).abs() <= 1e-4 * expected[0],
                "{name}, {i}: {got:?}, {expected:?}"
            );
        }
    }
}

/// Every size of picture, also in the backward pass: one pixel, a sliver, and more tiles than a dispatch has groups in
/// one dimension.
#[test]
fn the_twins_gradients_at_any_size() {
    let device = device();
    for (width, height) in [(1, 1), (17, 3), (4096, 16), (1_048_592, 1)] {
        let camera = small_camera(width, height);
        let model = narrowed(&random_scene(&camera, 6));
        let weights = weights(&camera, 7);
        let (name, settings) = (format!("{width}x{height}"), Settings::default());
        let got = gradients(&device, &model, &camera, settings, &weights);
        let expected = each_within(&name, &got, &model, &camera, settings, &weights);
        assert!(expected.means.as_flattened().iter().any(|g| *g != 0.0), "{name}: something is drawn");
    }
    finish(&device);
}

/// Layers on one pixel, equal or of different colours: the largest error of dL/dalpha, in roundings (2^-24) of the
/// brightest layer's contribution, and the number of layers that the pixel blended.
fn layers(device: &Device, count: usize, logit: f32, alike: bool, stop: f32) -> (f64, usize) {
    let (focal, principal) = (DVec2::splat(8.0), DVec2::splat(0.5));
    let camera = Camera { focal, principal, width: 1, height: 1, ..ahead() };
    let mut r = Random(1);
    let sh = vec![(0..3 * count).map(|_| if alike { 1.3 } else { r.within(-1.5, 1.5) as f32 }).collect()];
    let model = Gaussians { sh, ..Gaussians::balls(vec![[0.0, 0.0, 2.0]; count], -1.0, logit, 0) };
    let settings = Settings { stop, ..Settings::default() };
    let got = gradients(device, &model, &camera, settings, &[[1.0, 1.0, 1.0, 0.0]]);
    let expected = expected(&model, &camera, settings, &[[1.0, 1.0, 1.0, 0.0]]);
    let twin = reference::render(&Params::from(&model), &camera, &twin(settings));
    let worth = twin.projected.iter().flatten().fold(0.0, |m: f64, p| m.max(p.colour.element_sum()));
    let opacity = 1.0 / (1.0 + (-f64::from(logit)).exp());
    let slope = opacity * (1.0 - opacity); // derivative of alpha by the logit
    let pairs = got.opacity_logits.iter().zip(&expected.opacity_logits);
    let off = pairs.fold(0.0, |m: f64, (g, e)| m.max((g - e).abs() / slope));
    let drawn = twin.composite.contribution.iter().filter(|c| **c > 0.0).count();
    assert!(got.opacity_logits.iter().all(|g| g.is_finite()));
    (off / worth * 2_f64.powi(24), drawn)
}

/// dL/dalpha is T (colour - colour behind): for equal layers it is the light that the last one transmits, a difference
/// of nearly equal numbers. The colour behind is the pixel minus the layers before, both sums with one rounding per
/// layer: the error is absolute, and grows as a random walk of roundings of the brightest layer, not with the gradient.
#[test]
fn stacks_of_layers_alike() {
    let device = device();
    for logit in [-5.4, -5.0, -4.0, -3.0, -1.0, 1.0] {
        for count in [10, 100, 1000, 10_000] {
            for (alike, stop) in [(true, TRANSMITTANCE_STOP), (false, TRANSMITTANCE_STOP), (true, 0.0)] {
                if stop > 0.0 && logit > -4.5 && count > 1000 {
                    continue; // a pixel stops within the first thousand
                }
                let (error, drawn) = layers(&device, count, logit, alike, stop);
                let allowed = 8.0 + (drawn as f64).sqrt();
                println!(
                    "logit {logit}, {count} layers, alike {alike}, stop {stop:e}: {drawn} drawn, {error:.1} roundings of {allowed:.0}"
                );
                // If the next T were T (1 - alpha), whose rounding is the same in equal layers: 62 roundings where 45
                // are allowed (logit -5).
                assert!(error < allowed, "logit {logit}, {count} layers, alike {alike}, stop {stop}: {error:.1}");
            }
        }
    }
    // As many layers as the densest tile of the forward tests.
    let (error, drawn) = layers(&device, 100_000, -5.5, false, 0.0);
    println!("{drawn} drawn, {error:.1} roundings");
    assert!(drawn == 100_000 && error < 8.0 + 100_000_f64.sqrt());
    finish(&device);
}
