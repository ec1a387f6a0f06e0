//! Adam on the device against the float64 twin, and rows whose gradient is not finite.

use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::{Buffer, Device, Recording};
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Backward, BackwardCounts, Settings, TrainingRenderer};
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::TrainingModel;
use qirf_vk::train::adam::{self, Moments};
use qirf_vk::train::rates::Step;
use qirf_vk::train::schedule::Schedule;

/// A model trained with a fixed gradient of the picture.
pub(crate) struct Bench {
    device: Device,
    pub(crate) renderer: TrainingRenderer,
    pub(crate) training: TrainingModel,
    camera: Camera,
    by_image: Buffer<[f32; 4]>,
}

impl Bench {
    pub(crate) fn new(device: &Device, model: &Gaussians, camera: &Camera, by_image: &[[f32; 4]]) -> Self {
        let size = [camera.width, camera.height];
        let renderer = TrainingRenderer::new(device, Settings::default(), model.len(), size, 1 << 14).unwrap();
        Self {
            device: device.clone(),
            renderer,
            training: TrainingModel::new(device, model).unwrap(),
            camera: camera.clone(),
            by_image: device.upload("image gradient", by_image).unwrap(),
        }
    }

    pub(crate) fn there_and_back(&self, growth: Option<&Buffer<[f32; 2]>>) -> Recording {
        let mut recording = Recording::new();
        self.renderer.record(&mut recording, &self.training.model, &self.camera);
        let backward = Backward { growth, ..Backward::default() };
        self.renderer.record_backward(&mut recording, &self.training.model, &self.camera, &self.by_image, backward);
        recording
    }

    pub(crate) fn take(&self, step: Step) {
        let mut recording = self.there_and_back(Some(&self.training.growth));
        adam::record(&mut recording, &self.renderer, &self.training, step);
        self.device.run(recording).unwrap();
    }

    /// Gradients by the current parameters.
    pub(crate) fn gradients(&self) -> Params {
        let apart = adam::zeros(&self.device, &self.training.model).unwrap();
        let mut recording = self.there_and_back(None);
        adam::record_gradients(&mut recording, &self.renderer, &self.training.model, &apart);
        self.device.run(recording).unwrap();
        let mut out = Params::from(&self.training.model.download(&self.device).unwrap());
        for ((_, into), moments) in out.groups_mut().into_iter().zip(moments(&apart, &self.device, 3)) {
            into.iter_mut().zip(moments).for_each(|(g, m)| *g = f64::from(m[0]));
        }
        out
    }

    fn params(&self) -> Params {
        Params::from(&self.training.model.download(&self.device).unwrap())
    }
}

/// Moments of all attributes, in the order of [`Params::groups_mut`].
fn moments(moments: &Moments, device: &Device, degree: usize) -> Vec<Vec<[f32; 2]>> {
    moments.each_ref().up_to(degree).map(|b| b.read(device).unwrap()).collect()
}

/// The twin's parameters and moments.
struct Twin {
    params: Params,
    first: Params,
    second: Params,
}

impl Twin {
    fn new(model: &Gaussians) -> Self {
        let params = Params::from(model);
        Self { first: params.zeros_like(), second: params.zeros_like(), params }
    }

    /// One step; a Gaussian with any non-finite gradient stays unchanged. Returns the number of such Gaussians.
    fn step(&mut self, gradients: &mut Params, step: Step) -> usize {
        let n = self.params.len();
        let rates = step.rates.into_array();
        let gradients = gradients.groups_mut();
        let bad = |i: usize| {
            gradients.iter().any(|(_, g)| {
                let width = g.len() / n;
                g[i * width..][..width].iter().any(|g| g.is_nan() || g.abs() > reference::adam::GREATEST_GRADIENT)
            })
        };
        let bad: Vec<bool> = (0..n).map(bad).collect();
        let (mut values, mut first, mut second) =
            (self.params.groups_mut(), self.first.groups_mut(), self.second.groups_mut());
        for a in 0..values.len() {
            let width = gradients[a].1.len() / n;
            for i in (0..n).filter(|i| !bad[*i]) {
                let row = i * width..(i + 1) * width;
                let (m, v) = (&mut first[a].1[row.clone()], &mut second[a].1[row.clone()]);
                let values = &mut values[a].1[row.clone()];
                let how = (step.number, f64::from(rates[a]), step.decays);
                assert!(reference::adam::adam(values, &gradients[a].1[row], [m, v], how));
            }
        }
        bad.iter().filter(|b| **b).count()
    }
}

/// Step number `number`; the decays are the reference's raised to the power `forgetting`.
fn step(number: u32, forgetting: f64) -> Step {
    let schedule = Schedule { iterations: 40, position_rate: 5e-3, forgetting, ..Schedule::default() };
    Step { decays: schedule.decays(), ..Step::new(number, schedule.rates(number, 1.7)) }
}

pub(crate) fn weights(count: usize, seed: u64) -> Vec<[f32; 4]> {
    let mut r = Random(seed);
    (0..count).map(|_| [0; 4].map(|_| r.within(-1.0, 1.0) as f32)).collect()
}

/// The device's gradients with Adam in float64: after ten steps each parameter agrees with the twin's, up to roundings
/// of the parameter itself (2^-24 of it each step) and of the steps (1.3e-5 of each: 1 - 0.999 in float32).
#[test]
fn adam_of_every_attribute() {
    [1.0, 5.0].into_iter().for_each(ten_steps);
}

fn ten_steps(forgetting: f64) {
    let device = device();
    let camera = small_camera(45, 37);
    let model = narrowed(&random_scene(&camera, 3));
    let bench = Bench::new(&device, &model, &camera, &weights(45 * 37, 8));
    let mut twin = Twin::new(&model);
    let mut travel = [0_f64; 8];
    for step in (1..=10).map(|number| step(number, forgetting)) {
        let mut gradients = bench.gradients();
        assert_eq!(twin.step(&mut gradients, step), 0);
        bench.take(step);
        travel.iter_mut().zip(step.rates.into_array()).for_each(|(t, r)| *t += f64::from(r));
    }
    let (mut got, mut moved) = (bench.params(), 0);
    let mut start = Params::from(&model);
    for (a, ((name, got), (_, right))) in got.groups_mut().into_iter().zip(twin.params.groups_mut()).enumerate() {
        let mut worst = 0_f64;
        for ((g, r), s) in got.iter().zip(right.iter()).zip(start.groups_mut()[a].1.iter()) {
            let allowed = 1e-4 * travel[a] + 10.0 * r.abs() * 2_f64.powi(-24);
            worst = worst.max((g - r).abs() / allowed);
            moved += usize::from((r - s).abs() > 0.1 * travel[a]);
        }
        println!("{name}: {worst:.2} of what is allowed");
        assert!(worst < 1.0, "{name}: {worst}");
    }
    assert!(moved > 500, "only {moved} elements moved");
    // First moments to 1e-6 of the attribute's norm, second to 1e-4 (square roots halve it).
    let got = moments(&bench.training.moments, &device, 3);
    for (which, allowed) in [(0, 2e-6), (1, 1e-4)] {
        let of = if which == 0 { &mut twin.first } else { &mut twin.second };
        for ((name, right), got) in of.groups_mut().into_iter().zip(&got) {
            let off: f64 = got.iter().zip(right.iter()).map(|(g, r)| (f64::from(g[which]) - r).powi(2)).sum();
            let size: f64 = right.iter().map(|r| r * r).sum();
            assert!((off / size).sqrt() < allowed, "{name}'s moment {which}: {:.1e}", (off / size).sqrt());
        }
    }
    // Storing gradients also counts as an iteration: 20 in all.
    assert_eq!(bench.renderer.backward_counts().unwrap(), BackwardCounts { skipped_rows: 0, passes: 20 });
    finish(&device);
}

/// Three Gaussians in tiles of their own; the gradient of a pixel of the first is not finite, or 1e30.
#[test]
fn a_gradient_that_is_not_finite_stays_where_it_is() {
    gradients_not_finite(&device());
}

pub fn gradients_not_finite(device: &Device) {
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, 96, 64);
    let depth = 4.0;
    let pixels: [[f64; 2]; 3] = [[8.0, 8.0], [56.0, 40.0], [88.0, 56.0]];
    let mut model = narrowed(&random_scene(&camera, 6));
    model.means.truncate(3);
    for (mean, pixel) in model.means.iter_mut().zip(pixels) {
        let at = |k: usize| (pixel[k] - camera.principal[k]) / camera.focal[k] * depth;
        let world = camera.rotation.transpose() * (DVec3::new(at(0), at(1), depth) - camera.translation);
        *mean = world.as_vec3().to_array();
    }
    model.log_scales = vec![[-2.8, -3.0, -3.2]; 3];
    model.rotations.truncate(3);
    model.opacity_logits = vec![0.3; 3];
    for l in 0..4 {
        model.sh[l].truncate(3 * Gaussians::band_width(l));
    }
    model.sh[0].fill(0.5);

    let run = |spoilt: f32| {
        let mut by_image = weights(96 * 64, 3);
        by_image[8 * 96 + 8] = [spoilt; 4];
        let bench = Bench::new(device, &model, &camera, &by_image);
        for step in 1..=3 {
            bench.take(self::step(step, 1.0));
        }
        (
            bench.params(),
            moments(&bench.training.moments, device, 3),
            bench.training.growth.read(device).unwrap(),
            bench.renderer.backward_counts().unwrap(),
        )
    };
    let (mut right, right_moments, right_growth, guards) = run(0.5);
    assert_eq!(guards, BackwardCounts { skipped_rows: 0, passes: 3 });
    assert!(right_growth.iter().all(|g| g[1] == 3.0 && g[0] > 0.0), "{right_growth:?}");
    for spoilt in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30] {
        let (mut got, got_moments, growth, guards) = run(spoilt);
        assert_eq!(guards, BackwardCounts { skipped_rows: 3, passes: 3 }, "{spoilt}: one row in each of three steps");
        assert_eq!(growth[0], [0.0; 2], "{spoilt}");
        assert_eq!(growth[1..], right_growth[1..], "{spoilt}");
        let mut start = Params::from(&model);
        for (a, ((name, got), (_, right))) in got.groups_mut().into_iter().zip(right.groups_mut()).enumerate() {
            let width = got.len() / 3;
            assert_eq!(got[..width], start.groups_mut()[a].1[..width], "{spoilt}: {name} of the spoilt row");
            assert_eq!(got[width..], right[width..], "{spoilt}: {name} of its neighbours");
            assert_ne!(got[width..], start.groups_mut()[a].1[width..], "{spoilt}: {name} of its neighbours");
            assert!(got_moments[a][..width].iter().all(|m| *m == [0.0; 2]), "{spoilt}: {name}'s moments");
            assert_eq!(got_moments[a][width..], right_moments[a][width..], "{spoilt}: {name}'s moments");
        }
    }
    finish(device);
}

type Spoil = fn(&mut Gaussians);

/// Parameters that are not finite (a damaged model, until the next density step removes them) affect no other Gaussian.
#[test]
fn parameters_that_are_not_finite_harm_no_other() {
    parameters_not_finite(&device());
}

pub fn parameters_not_finite(device: &Device) {
    let camera = small_camera(45, 37);
    let sound = narrowed(&random_scene(&camera, 3));
    let spoil: [(&str, Spoil); 8] = [
        ("mean NaN", |m| m.means[4][1] = f32::NAN),
        ("mean infinite", |m| m.means[4][2] = f32::INFINITY),
        ("scale NaN", |m| m.log_scales[4][0] = f32::NAN),
        ("scale infinite", |m| m.log_scales[4][0] = f32::INFINITY),
        ("rotation NaN", |m| m.rotations[4][3] = f32::NAN),
        ("rotation zero", |m| m.rotations[4] = [0.0; 4]),
        ("logit NaN", |m| m.opacity_logits[4] = f32::NAN),
        ("SH NaN", |m| m.sh[0][13] = f32::NAN),
    ];
    for (name, spoil) in spoil {
        let mut model = sound.clone();
        spoil(&mut model);
        let bench = Bench::new(device, &model, &camera, &weights(45 * 37, 8));
        for step in 1..=3 {
            bench.take(self::step(step, 1.0));
        }
        let mut got = bench.params();
        for (group, values) in got.groups_mut() {
            let width = values.len() / 24;
            for (i, row) in values.chunks_exact(width).enumerate().filter(|(i, _)| *i != 4) {
                assert!(row.iter().all(|v| v.is_finite()), "{name}: {group} of Gaussian {i}");
            }
        }
    }
    finish(device);
}
