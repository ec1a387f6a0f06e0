//! Gradients by learnt masks: formulas against difference quotients, and against each other.

use crate::support::Random;
use crate::support::synthetic::{random_scene, small_camera};
use glam::DVec3;
use qirf_vk::reference::rasterise_backward::ImageGradient;
use qirf_vk::reference::{Params, Settings, gradients, learnt_mask, render};
use qirf_vk::scene::camera::Camera;

const SIZE: [u32; 2] = [45, 37];

/// A gradient of the picture, and the loss with that gradient.
fn weights() -> (Vec<[f64; 3]>, Vec<f64>) {
    let mut r = Random(8);
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let colours = (0..pixels).map(|_| [0; 3].map(|_| r.within(-1.0, 1.0))).collect();
    (colours, (0..pixels).map(|_| r.within(-1.0, 1.0)).collect())
}

fn loss(params: &Params, camera: &Camera, settings: &Settings) -> f64 {
    let (by_colour, by_alpha) = weights();
    let out = render(params, camera, settings).composite;
    let colours = out.image.iter().zip(by_colour).map(|(c, w)| DVec3::from(*c).dot(DVec3::from(w)));
    colours.chain(out.alpha.iter().zip(by_alpha).map(|(a, w)| a * w)).sum()
}

fn smooth() -> Settings {
    Settings { smooth_cutoff: true, background: [0.3, 0.1, 0.7], ..Settings::default() }
}

/// The slope by a mask that multiplies scales and opacity equals the difference quotient of the loss.
#[test]
fn masks_of_scales_and_opacity() {
    let camera = small_camera(SIZE[0], SIZE[1]);
    let params = random_scene(&camera, 1);
    let (by_colour, by_alpha) = weights();
    let gradients = gradients(&params, &camera, &smooth(), &by_colour, Some(&by_alpha));
    let h = 1e-5;
    for i in 0..params.len() {
        // Clamped opacities have no slope; their difference quotient reaches the clamp's edge.
        if params.opacity_logits[i] > 4.0 {
            continue;
        }
        let masked = |mask: f64| {
            let mut p = params.clone();
            let opacity = mask / (1.0 + (-p.opacity_logits[i]).exp());
            p.opacity_logits[i] = (opacity / (1.0 - opacity)).ln();
            p.log_scales[i].iter_mut().for_each(|s| *s += mask.ln());
            loss(&p, &camera, &smooth())
        };
        let quotient = (masked(1.0 + h) - masked(1.0 - h)) / (2.0 * h);
        // d(M s)/dM = s and d(M o)/dM = o.
        let by_scales: f64 = gradients.params.log_scales[i].iter().sum();
        let slope = by_scales + gradients.params.opacity_logits[i] * (1.0 + params.opacity_logits[i].exp());
        assert!((slope - quotient).abs() < 1e-6 * (1.0 + quotient.abs()), "{i}: {slope}, quotient {quotient}");
    }
}

/// The slope by a mask that multiplies alpha: for a shown Gaussian, the slope by the logarithm of its opacity; for a
/// masked one, the difference quotient of the loss where it begins to be shown.
#[test]
fn masks_of_alpha() {
    let (camera, settings) = (small_camera(SIZE[0], SIZE[1]), smooth());
    let params = random_scene(&camera, 1);
    let (by_colour, by_alpha) = weights();
    let gradient = ImageGradient { colour: &by_colour, alpha: Some(&by_alpha) };
    let shown: Vec<bool> = (0..params.len()).map(|i| i % 3 > 0).collect();
    let slopes = learnt_mask::gradients(&render(&params, &camera, &settings), &shown, &camera, &settings, gradient);

    // Shown with a negligible opacity.
    let opacity = |i: usize, factor: f64| factor / (1.0 + (-params.opacity_logits[i]).exp());
    let with = |i: usize, factor: f64| {
        let mut p = params.clone();
        for k in (0..p.len()).filter(|k| !shown[*k] || *k == i) {
            let opacity = opacity(k, if k == i { factor } else { 1e-12 });
            p.opacity_logits[k] = (opacity / (1.0 - opacity)).ln();
        }
        p
    };
    let mut checked = [0; 2];
    for i in (0..params.len()).filter(|i| params.opacity_logits[*i] < 4.0) {
        let p = with(i, if shown[i] { 1.0 } else { 1e-6 });
        let slope = if shown[i] {
            let g = gradients(&p, &camera, &settings, &by_colour, Some(&by_alpha));
            g.params.opacity_logits[i] * (1.0 + p.opacity_logits[i].exp())
        } else {
            (loss(&p, &camera, &settings) - loss(&with(i, 1e-12), &camera, &settings)) / 1e-6
        };
        assert!((slopes[i] - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{i}: {} {slope}", slopes[i]);
        checked[usize::from(shown[i])] += 1;
    }
    assert!(checked[0] > 4 && checked[1] > 10, "{checked:?}");
}

/// Random masks are 1 as often as their probability says, whatever the rest of the key is.
#[test]
fn random_masks_follow_their_chance() {
    for (score, chance) in [(9.0, 0.999_88), (1.0, 0.731), (-2.0, 0.1192), (-20.0, 0.0)] {
        let shown = (0..40_000)
            .filter(|i| learnt_mask::shows(score, Some(learnt_mask::logistic([3, i / 200, i % 200]))))
            .count();
        let deviation = (40_000.0 * chance * (1.0 - chance) + 1.0_f64).sqrt();
        assert!((shown as f64 - 40_000.0 * chance).abs() < 5.0 * deviation, "{score}: {shown}");
    }
    assert!(learnt_mask::shows(-4.595, None) && !learnt_mask::shows(-4.5952, None));
}
