//! Growth by relocation: slopes and noise against the twin, and whole runs.

use super::adam::{Bench, weights};
use super::runs::{capture, options, resumed, same_however, train, trainer};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{device, finish, repeats};
use glam::DVec3;
use qirf_vk::gpu::Recording;
use qirf_vk::kernels::constants::gradient_row::{ROW, ROW_LOG_SCALE, ROW_LOGIT};
use qirf_vk::lab::methods::mcmc::Mcmc;
use qirf_vk::reference;
use qirf_vk::train::Options;
use qirf_vk::train::growth::Growth;
use qirf_vk::train::schedule::Schedule;
use std::sync::Arc;

const SETTINGS: Mcmc = Mcmc { until: 0.8, dead: 0.005, noise: 3.0, opacity: 40.0, scale: 70.0 };

/// Rows gain the slopes, and means move, as in the twin: to 1e-5 of the size of each, for every shape.
#[test]
fn slopes_and_noise_as_the_twin_has_them() {
    let device = device();
    let camera = small_camera(45, 37);
    let mut model = narrowed(&random_scene(&camera, 1));
    let n = model.len();
    // From dead to opaque, so that every part of the logistic function occurs; needles and discs; and hard cases.
    for i in 0..n {
        model.opacity_logits[i] = -9.0 + 14.0 * i as f32 / n as f32;
        model.log_scales[i][i % 3] -= 6.0;
    }
    let hard = 4;
    model.opacity_logits[0] = f32::NAN;
    model.log_scales[1] = [200.0, 0.0, 0.0];
    model.rotations[2] = [0.0; 4];
    model.log_scales[3] = [-100.0; 3];
    let bench = Bench::new(&device, &model, &camera, &weights(45 * 37, 8));
    let rows = |bench: &Bench| bench.renderer.gradient_rows().values.read(&device).unwrap();
    device.run(bench.there_and_back(None)).unwrap();
    let before = rows(&bench);
    let mut recording = Recording::new();
    SETTINGS.regularise(&mut recording, &bench.renderer, &bench.training);
    SETTINGS.noise(&mut recording, &bench.renderer, &bench.training, 0.25, [5, 77]);
    device.run(recording).unwrap();
    let (after, moved) = (rows(&bench), bench.training.model.download(&device).unwrap());
    assert_eq!(moved.means[..hard], model.means[..hard], "what cannot be shaken stays");

    let wide = |v: [f32; 3]| v.map(f64::from);
    let (weight, mut worst, mut far) = (n as f64, [0.0_f64; 3], 0);
    for i in hard..n {
        let (logit, scales) = (f64::from(model.opacity_logits[i]), wide(model.log_scales[i]));
        let (logit_slope, scale_slopes) =
            reference::mcmc::regularise(logit, scales, SETTINGS.opacity / weight, SETTINGS.scale / (3.0 * weight));
        let check = |at: u32, slope: f64| {
            let at = i * ROW as usize + at as usize;
            let room = 1e-5 * slope.abs() + 2e-7 * f64::from(before[at].abs());
            (f64::from(after[at]) - f64::from(before[at]) - slope).abs() / room
        };
        worst[0] = worst[0].max(check(ROW_LOGIT, logit_slope));
        (0..3).for_each(|c| worst[1] = worst[1].max(check(ROW_LOG_SCALE + c, scale_slopes[c as usize])));
        let step = reference::mcmc::noise(logit, scales, model.rotations[i].map(f64::from), 0.75, [5, 77, i as u32]);
        let (from, to) = (DVec3::from(wide(model.means[i])), DVec3::from(wide(moved.means[i])));
        // Roundings of the mean, of the opacity (100 times as large in the exponent), and of needles' short axes.
        let largest = scales.iter().fold(f64::MIN, |m, s| m.max(*s)).exp();
        let room = 2e-7 * from.length() + 5e-5 * step.length() + 5e-6 * largest * largest;
        worst[2] = worst[2].max((to - from - step).length() / room);
        far += usize::from(step.length() > 1e-3 * largest);
    }
    println!("of what is allowed: logits {:.3}, scales {:.3}, means {:.3}", worst[0], worst[1], worst[2]);
    assert!(worst.iter().all(|w| *w <= 1.0), "{worst:?}");
    assert!(far > n / 10 && far < n * 9 / 10, "{far} of {n} moved");
    finish(&device);
}

/// A run reaches the planned number and keeps it; interrupted, or short of room for pairs, it ends with the same bytes.
#[test]
fn relocating_runs_end_with_the_same_bytes() {
    let (device, again) = (device(), repeats());
    let planned = capture().start.len() * 3 / 2;
    let growth = Some(Growth { gaussians: Some(planned), ..Growth::default() });
    let schedule = Schedule { iterations: 120, growth, ..options().schedule };
    let with = |options: Options| Options { schedule: schedule.clone(), method: Some(Arc::new(SETTINGS)), ..options };
    let mut whole = trainer(&device, with(options()));
    let kernels = whole.recording().unwrap().kernels();
    assert_eq!(kernels.iter().filter(|k| **k == "lab/mcmc").count(), 2);
    train(&mut whole, 120);
    assert_eq!(whole.len(), planned);
    let start = |pairs| trainer(&again, with(Options { pairs, ..options() }));
    same_however(&whole, &[47], start, |at| resumed(&again, at, with(options())));
    finish(&device);
}
