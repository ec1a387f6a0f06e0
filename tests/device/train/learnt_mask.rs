//! Learnt masks on the device: pictures without the masked Gaussians, slopes and steps against the float64 twin, and
//! whole runs.

use super::adam::weights;
use super::runs::{capture, options, resumed, same_however, train, trainer};
use crate::device::rasterise::render;
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{device, finish, repeats};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::{Buffer, Device, Recording};
use qirf_vk::kernels::constants::gradient_row::{ROW, ROW_GOOD, ROW_LOG_SCALE, ROW_LOGIT};
use qirf_vk::lab::methods::learnt_mask::{LearntMask, LearntMasks, MaskMethod};
use qirf_vk::reference::rasterise_backward::ImageGradient;
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Backward, Settings, TrainingRenderer};
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::method::{Iteration, Method};
use qirf_vk::train::rates::Rates;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Array, Options, Trainer, TrainingModel};
use std::sync::Arc;

const SIZE: [u32; 2] = [45, 37];
const METHODS: [MaskMethod; 2] = [MaskMethod::Compact3dgs, MaskMethod::MaskGaussian];

/// A model with masks, and a fixed gradient of its picture.
struct Bench {
    device: Device,
    renderer: TrainingRenderer,
    training: TrainingModel,
    camera: Camera,
    by_image: Buffer<[f32; 4]>,
    masks: LearntMask,
}

impl Bench {
    fn new(
        device: &Device,
        settings: Settings,
        model: &Gaussians,
        (scores, method): (&[f32], MaskMethod),
        by_image: &[[f32; 4]],
    ) -> Self {
        let camera = small_camera(SIZE[0], SIZE[1]);
        let mut training = TrainingModel::new(device, model).unwrap();
        let masks = LearntMasks { weight: 30.0, rate: 0.1, ..LearntMasks::of(method, 1, 1000) };
        let [of_scores, of_moments] = *LearntMask::arrays(method);
        training.arrays = vec![
            Array::with(device, of_scores, scores).unwrap(),
            Array::with(device, of_moments, &vec![0.0; 2 * scores.len()]).unwrap(),
        ];
        Self {
            renderer: TrainingRenderer::new(device, settings, model.len(), SIZE, 1 << 14).unwrap(),
            training,
            camera,
            by_image: device.upload("image gradient", by_image).unwrap(),
            masks: LearntMask::new(device, masks).unwrap(),
            device: device.clone(),
        }
    }

    fn now(&self) -> Iteration<'_> {
        let Self { renderer, training: model, camera, by_image: image_gradient, .. } = self;
        Iteration { renderer, camera, model, key: [5, 77], image_gradient, colours: false, rates: Rates::default() }
    }

    fn scores(&self) -> Vec<f32> {
        self.training.arrays[0].values.read(&self.device).unwrap()
    }

    fn moments(&self) -> Vec<[f32; 2]> {
        self.training.arrays[1].values.cast::<[f32; 2]>().read(&self.device).unwrap()
    }

    /// Records the picture and its backward pass with the slopes by masks.
    fn there_and_back(&self) {
        let (mut recording, model) = (Recording::new(), &self.training.model);
        self.renderer.record_lists(&mut recording, model, &self.camera);
        self.masks.hide(&mut recording, &self.now());
        self.renderer.record_blending(&mut recording, &self.camera);
        self.renderer.record_backward(&mut recording, model, &self.camera, &self.by_image, Backward::default());
        LearntMask::gradients(&mut recording, &self.now());
        self.device.run(recording).unwrap();
    }

    fn picture(&self) -> Vec<[f32; 4]> {
        self.renderer.image().read_first(&self.device, (SIZE[0] * SIZE[1]) as usize).unwrap()
    }

    fn rows(&self) -> Vec<f32> {
        self.renderer.gradient_rows().values.read(&self.device).unwrap()
    }

    /// Slopes by masks, the slots' sums added up.
    fn slopes(&self) -> Vec<f64> {
        let slots = self.renderer.slots(&self.camera);
        let sums = slots.sums.blue.read(&self.device).unwrap();
        let (first, counts) =
            (slots.first_slots.read(&self.device).unwrap(), slots.tile_counts.read(&self.device).unwrap());
        let of = |i: usize| sums[first[i] as usize..][..counts[i] as usize].iter().map(|s| f64::from(*s)).sum();
        (0..self.training.model.len).map(|i| if counts[i] > 0 { of(i) } else { 0.0 }).collect()
    }
}

fn model() -> Gaussians {
    narrowed(&random_scene(&small_camera(SIZE[0], SIZE[1]), 1))
}

/// Scores for which a threshold masks every third.
fn thirds(n: usize) -> Vec<f32> {
    (0..n).map(|i| if i % 3 > 0 { 1.0 } else { -9.0 }).collect()
}

fn shown(scores: &[f32]) -> Vec<bool> {
    scores.iter().map(|s| reference::learnt_mask::shows(f64::from(*s), None)).collect()
}

/// The picture has the bits of a model's without the masked Gaussians, and these have no gradients.
#[test]
fn the_masked_are_not_drawn() {
    let (model, device) = (model(), device());
    let scores = thirds(model.len());
    let settings = Settings { background: [0.3, 0.1, 0.7], ..Settings::default() };
    let bench = Bench::new(&device, settings, &model, (&scores, MaskMethod::Compact3dgs), &weights(45 * 37, 8));
    bench.there_and_back();
    let shown = shown(&scores);
    let kept: Vec<usize> = (0..model.len()).filter(|i| shown[*i]).collect();
    let whole = render(&device, &model, &bench.camera, settings).pixels;
    let picture = render(&device, &model.select(&kept), &bench.camera, settings).pixels;
    assert!(bench.picture() == picture && whole != picture);
    assert_eq!(bench.masks.shown.read(&device).unwrap(), [kept.len() as u32]);
    let rows = bench.rows();
    let moved = |i: usize| rows[i * ROW as usize..][..=ROW_LOGIT as usize].iter().any(|g| *g != 0.0);
    assert!((0..model.len()).all(|i| shown[i] || !moved(i)) && kept.iter().filter(|i| moved(**i)).count() > 10);
    finish(&device);
}

/// Slopes by masks are the differences of the loss with and without each Gaussian, whether it is masked or not.
#[test]
fn slopes_as_the_twin_has_them() {
    let (model, device) = (model(), device());
    let by_image = weights(45 * 37, 8);
    let colour: Vec<[f64; 3]> = by_image.iter().map(|g| [g[0], g[1], g[2]].map(f64::from)).collect();
    let alpha: Vec<f64> = by_image.iter().map(|g| f64::from(g[3])).collect();
    let background = [0.3_f32, 0.1, 0.7];
    let every = |one: f32| vec![one; model.len()];
    for (name, scores) in [("a third", thirds(model.len())), ("none", every(1.0)), ("all", every(-9.0))] {
        let settings = Settings { background, stop: 0.0, ..Settings::default() };
        let bench = Bench::new(&device, settings, &model, (&scores, MaskMethod::Compact3dgs), &by_image);
        bench.there_and_back();
        let twin = reference::Settings {
            background: background.map(f64::from),
            transmittance_stop: 0.0,
            ..reference::Settings::default()
        };
        let rendered = reference::render(&Params::from(&model), &bench.camera, &twin);
        let gradient = ImageGradient { colour: &colour, alpha: Some(&alpha) };
        let right = reference::learnt_mask::gradients(&rendered, &shown(&scores), &bench.camera, &twin, gradient);
        let largest = right.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
        let got = bench.slopes();
        let worst = got.iter().zip(&right).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / largest;
        println!("{name} masked: largest slope {largest:.3}, largest error {worst:.1e} of it");
        assert!(largest > 1.0 && worst < 1e-5, "{name}: {worst}");
        // For Gaussians that are shown, the opacity's slope is the same wherever no alpha is clamped.
        let rows = bench.rows();
        for i in (0..model.len()).filter(|i| scores[*i] > 0.0 && model.opacity_logits[*i] < 4.0) {
            let by_opacity = f64::from(rows[i * ROW as usize + ROW_LOGIT as usize])
                * (1.0 + f64::from(model.opacity_logits[i]).exp());
            assert!((by_opacity - got[i]).abs() < 1e-4 * largest, "{name}: {i}");
        }
    }
    finish(&device);
}

/// A step moves scores and moments like the twin's: with both methods, for faint and opaque Gaussians, and for scores
/// at both ends.
#[test]
fn steps_as_the_twin_has_them() {
    let (mut model, device) = (model(), device());
    let n = model.len();
    model.opacity_logits[3] = 100.0;
    for method in METHODS {
        let mut scores: Vec<f32> = (0..n).map(|i| -6.0 + 12.0 * i as f32 / n as f32).collect();
        let ends = [100.0, -100.0, 1e30, -1e30, f32::INFINITY, f32::NEG_INFINITY];
        scores[n - ends.len()..].copy_from_slice(&ends);
        let bench = Bench::new(&device, Settings::default(), &model, (&scores, method), &weights(45 * 37, 8));
        bench.there_and_back();
        let mut recording = Recording::new();
        bench.masks.step(&mut recording, &bench.now());
        bench.device.run(recording).unwrap();
        let random = |i: usize| method.samples().then(|| reference::learnt_mask::logistic([5, 77, i as u32]));
        let shown = (0..n).filter(|i| reference::learnt_mask::shows(f64::from(scores[*i]), random(*i))).count();
        assert_eq!(bench.masks.shown.read(&bench.device).unwrap(), [shown as u32]);
        let (rows, slopes) = (bench.rows(), bench.slopes());
        let (after, moments, settings) = (bench.scores(), bench.moments(), bench.masks.settings);
        let mut moved = 0;
        for i in 0..n {
            let at = |k: u32| f64::from(rows[i * ROW as usize + k as usize]);
            let by_scales: f64 = (0..3).map(|c| at(ROW_LOG_SCALE + c)).sum();
            let whole = by_scales + at(ROW_LOGIT) * (1.0 + f64::from(model.opacity_logits[i].min(80.0)).exp());
            let slope = if method.samples() { slopes[i] } else { whole };
            let score = f64::from(scores[i]);
            let means = [shown as f64 / n as f64, n as f64];
            let gradient = reference::learnt_mask::by_score(slope, score, random(i), settings.weight, means);
            let (mut value, mut m, mut v) = ([score], [0.0], [0.0]);
            let how = (77, settings.step_rate(), [reference::adam::BETA1, reference::adam::BETA2]);
            reference::adam::adam(&mut value, &[gradient], [&mut m, &mut v], how);
            let near = |a: f32, b: f64, room: f64| f64::from(a) == b || (f64::from(a) - b).abs() <= room;
            let room = 2e-5 * gradient.abs() + 1e-7;
            assert!(near(moments[i][0], m[0], room), "{method:?} {i}: {:?} {m:?} {v:?}", moments[i]);
            // The step's size does not depend on the gradient's; its sign is certain unless that is nearly 0.
            if gradient == 0.0 || gradient.abs() > 1e-4 {
                assert!(near(after[i], value[0], 1e-4), "{method:?} {i}: {} {value:?}", after[i]);
            }
            moved += usize::from(after[i] != scores[i]);
        }
        assert!(moved > n / 2 && after[n - 4..] == scores[n - 4..], "{method:?}: {moved} moved");
    }
    finish(&device);
}

/// A Gaussian whose gradients are not finite keeps its score; a NaN score masks, and affects no other Gaussian.
#[test]
fn what_is_not_finite_stays_where_it_is() {
    let (model, device) = (model(), device());
    for (method, spoilt) in METHODS.into_iter().flat_map(|m| [f32::NAN, f32::INFINITY, 1e30].map(|s| (m, s))) {
        let run = |spoilt: f32| {
            let mut by_image = weights(45 * 37, 8);
            by_image[5 * 45 + 5] = [spoilt; 4];
            let mut scores = vec![5.0; model.len()];
            scores[7] = f32::NAN;
            let bench = Bench::new(&device, Settings::default(), &model, (&scores, method), &by_image);
            bench.there_and_back();
            let mut recording = Recording::new();
            bench.masks.step(&mut recording, &bench.now());
            bench.device.run(recording).unwrap();
            let good: Vec<bool> = bench.rows().chunks_exact(ROW as usize).map(|r| r[ROW_GOOD as usize] > 0.0).collect();
            (good, bench.scores(), bench.moments())
        };
        let ((_, right, _), (good, got, moments)) = (run(0.5), run(spoilt));
        let bad = (0..model.len()).filter(|i| !good[*i]).count();
        assert!(bad > 0 && bad < model.len() / 2, "{bad}");
        for i in (0..model.len()).filter(|i| *i != 7) {
            if good[i] && method == MaskMethod::Compact3dgs {
                assert_eq!(got[i], right[i], "{method:?} {spoilt}: {i}");
            }
            assert!(got[i].is_finite() && moments[i].iter().all(|m| m.is_finite()), "{method:?} {spoilt}: {i}");
            assert!(good[i] || (got[i], moments[i]) == (5.0, [0.0; 2]), "{method:?} {spoilt}: {i}");
        }
        assert!(got[7].is_nan());
    }
    finish(&device);
}

fn masked(device: &Device, method: MaskMethod, survivors: usize, iterations: u32) -> Arc<dyn Method> {
    // A weight so large that most are masked within a hundred iterations.
    let settings = LearntMasks { weight: 0.15, rate: 0.3, ..LearntMasks::of(method, survivors, iterations) };
    Arc::new(LearntMask::new(device, settings).unwrap())
}

/// Runs with masks end with exactly the survivors, and with the same bytes: with little room for pairs, or interrupted
/// before or after the cut. Without masks none of their kernels runs.
#[test]
fn masked_runs_end_with_the_same_bytes() {
    let (device, again, c) = (device(), repeats(), capture());
    let survivors = c.start.len() / 3;
    for (method, second) in METHODS.into_iter().zip([&device, &again]) {
        let with = |device: &Device, options: Options| {
            let method = masked(device, method, survivors, 110);
            Options { method: Some(method), ..options }
        };
        let mut whole = trainer(&device, with(&device, options()));
        let kernels = |t: &mut Trainer| {
            let all = t.recording().unwrap().kernels();
            all.iter().filter(|k| k.starts_with("lab/learnt_mask")).count()
        };
        assert_eq!(kernels(&mut whole), if method.samples() { 3 } else { 2 });
        train(&mut whole, 110);
        let cut = whole.cut().unwrap();
        println!("{method:?}: {} at first, {cut:?}", c.start.len());
        assert_eq!((whole.len(), cut.after, cut.iteration, kernels(&mut whole)), (survivors, survivors, 83, 0));
        assert!(cut.before < c.start.len() || cut.shown < cut.before, "{cut:?}");
        let start = |pairs| trainer(second, with(second, Options { pairs, ..options() }));
        same_however(&whole, &[47, 83], start, |at| {
            assert_eq!(at.arrays.is_empty(), at.iteration >= 83);
            resumed(second, at, with(second, options()))
        });
    }
    let mut plain = trainer(&device, options());
    assert!(plain.recording().unwrap().kernels().iter().all(|k| !k.starts_with("lab/learnt_mask")));
    finish(&device);
}

/// A model without Gaussians, and one with fewer than the survivors.
#[test]
fn nothing_to_mask() {
    let (device, c) = (device(), capture());
    for (start, method) in
        [0, 5].into_iter().flat_map(|n| METHODS.map(|m| (c.start.select(&(0..n).collect::<Vec<_>>()), m)))
    {
        let never = c.start.len() as u32;
        let schedule = Schedule { iterations: 40, densify_every: never, prune_opacity: 0.0, ..options().schedule };
        let options = Options { schedule, method: Some(masked(&device, method, 50, 40)), ..options() };
        let mut trainer = Trainer::new(&device, &start, c.train.clone(), c.extent, options).unwrap();
        train(&mut trainer, 40);
        assert_eq!((trainer.len(), trainer.cut().unwrap().after), (start.len(), start.len()));
    }
    finish(&device);
}
