//! Depth as a loss: its gradients against float64, and what a run with it records and gives.

use super::runs::{bits, capture, options, train};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish, relative, repeats};
use glam::DVec3;
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::kernels::constants::gradient_row::{ROW, ROW_COLOUR};
use qirf_vk::reference::{self, Params, depth_loss as twin};
use qirf_vk::render::{Backward, Style, TrainingRenderer};
use qirf_vk::scene::camera::Camera;
use qirf_vk::scene::{DepthMap, Photo};
use qirf_vk::train::depth_loss::{DepthLoss, EVERY};
use qirf_vk::train::{Options, Trainer, TrainingModel};

const BACKGROUND: [f32; 3] = [0.3, 0.6, 0.1];
/// Of SH of degree 0.
const C0: f64 = 0.28209479177387814;

/// The gradients of `weight` times the loss's sum over the pixels of a part of `camera`'s picture, by the parameters of a model.
fn expected(
    params: &Params,
    (camera, part): (&Camera, &Camera),
    settings: &reference::Settings,
    (map, size): (&[f32], [u32; 2]),
    weight: f64,
) -> Params {
    let axis = camera.rotation.row(2);
    let depth = |mean: &[f64; 3]| axis.dot(DVec3::from(*mean)) + camera.translation.z;
    let colour = |mean| [depth(mean), 0.0, 0.0].map(|c| (c - 0.5) / C0);
    let depths = Params { sh: vec![params.means.iter().flat_map(colour).collect()], ..params.clone() };
    let picture = reference::render(&depths, camera, settings).composite;
    let pixels = camera.pixels() as usize;
    let (mut by_image, mut by_alpha, within) = (vec![[0.0; 3]; pixels], vec![0.0; pixels], part.whole());
    for n in 0..part.pixels() as u32 {
        let at = [n % part.width, n / part.width];
        let k = ((at[1] + within.corner[1]) * camera.width + at[0] + within.corner[0]) as usize;
        let measured = twin::measured(map, size, (at, within.corner, within.size));
        let (_, [red, alpha]) =
            twin::pixel([picture.image[k][0], picture.alpha[k]], f64::from(BACKGROUND[0]), measured);
        (by_image[k], by_alpha[k]) = ([weight * red, 0.0, 0.0], weight * alpha);
    }
    let mut out = reference::gradients(&depths, camera, settings, &by_image, Some(&by_alpha)).params;
    for (mean, by_colour) in out.means.iter_mut().zip(out.sh[0].chunks(3)) {
        // By the depth: SH of degree 0 is the depth over C0.
        *mean = (DVec3::from(*mean) + axis * by_colour[0] / C0).to_array();
    }
    Params { sh: params.zeros_like().sh, ..out }
}

/// The rows' gradients by everything but colours, as parameters.
fn of_rows(rows: &[f32], like: &Params) -> Params {
    let mut out = like.zeros_like();
    for (i, row) in rows.chunks(ROW as usize).take(like.means.len()).enumerate() {
        let value = |at: usize| f64::from(row[at]);
        out.means[i] = [0, 1, 2].map(value);
        out.log_scales[i] = [3, 4, 5].map(value);
        out.rotations[i] = [6, 7, 8, 9].map(value);
        out.opacity_logits[i] = value(10);
    }
    out
}

/// Pictures whole and in parts, a map of another size, holes in it, and both filters: gradients are added to those of the photo's
/// picture, whose colours stay.
#[test]
fn depth_loss_adds_the_gradients_of_its_twin() {
    let device = device();
    let whole = small_camera(45, 37);
    for (part, antialias) in [(whole.clone(), true), (whole.part([16, 16], [29, 21]), false)] {
        kernel_and_twin(&device, (&whole, &part), Style { antialias, ..Style::default() });
    }
    finish(&device);
}

fn kernel_and_twin(device: &Device, (whole, camera): (&Camera, &Camera), style: Style) {
    let model = narrowed(&random_scene(whole, 4));
    let params = Params::from(&model);
    let (size, pixels, mut random) = ([23, 40], camera.pixels() as usize, Random(8));
    let depth = |random: &mut Random| if random.unit() < 0.2 { 0.0 } else { random.within(1.0, 4.0) as f32 };
    let map: Vec<f32> = (0..size[0] * size[1]).map(|_| depth(&mut random)).collect();
    let unit = 1.25;
    let photo = Photo::opaque(camera.clone(), vec![0; 4 * pixels]);
    let measured = DepthMap { width: size[0], height: size[1], depths: map.clone().into(), unit };
    let photos = [photo.clone(), Photo { depth: Some(measured), ..photo }];
    let loss = DepthLoss::new(device, &photos).unwrap().expect("a map");
    assert!(DepthLoss::new(device, &photos[..1]).unwrap().is_none());

    let training = TrainingModel::new(device, &model).unwrap();
    let settings = style.over(BACKGROUND);
    let size_of = [camera.width, camera.height];
    let renderer = TrainingRenderer::new(device, settings, model.len(), size_of, 1 << 14).unwrap();
    let weights: Vec<[f32; 4]> = (0..pixels).map(|_| [0; 4].map(|_| random.within(-1.0, 1.0) as f32)).collect();
    let by_photo = device.upload("image gradient", &weights).unwrap();
    let by_depth = device.upload("another gradient", &weights).unwrap();
    let rows = |with: Option<usize>| {
        let mut recording = Recording::new();
        renderer.reset_backward_counts(&mut recording);
        renderer.record(&mut recording, &training.model, camera);
        renderer.record_backward(&mut recording, &training.model, camera, &by_photo, Backward::default());
        if let Some(photo) = with {
            loss.record(&mut recording, &renderer, (&training.model, camera), (photo, 60.0), &by_depth);
        }
        device.run(recording).unwrap();
        assert_eq!(renderer.backward_counts().unwrap().passes, 1, "depths are no pass of their own");
        renderer.gradient_rows().values.read(device).unwrap()
    };
    let (without, with) = (rows(None), rows(Some(1)));
    assert!(without == rows(Some(0)), "a photo without a map");
    let colours = |rows: &[f32]| -> Vec<u32> {
        rows.chunks(ROW as usize).flat_map(|row| &row[ROW_COLOUR as usize..]).map(|v| v.to_bits()).collect()
    };
    assert!(colours(&without) == colours(&with));

    let scaled: Vec<f32> = map.iter().map(|d| d * unit as f32).collect();
    let twin_settings = reference::Settings {
        background: BACKGROUND.map(f64::from),
        antialias: style.antialias,
        dilation: f64::from(settings.dilation),
        direction_gradient: false,
        sh_degree: 0,
        ..reference::Settings::default()
    };
    let mut right = expected(&params, (whole, camera), &twin_settings, (&scaled, size), 60.0 / pixels as f64);
    let mut got = of_rows(&with, &params);
    let before = of_rows(&without, &params);
    for ((_, got), (_, before)) in got.groups_mut().into_iter().zip(before.clone().groups_mut()) {
        got.iter_mut().zip(before.iter()).for_each(|(g, b)| *g -= b);
    }
    for ((group, got), (_, right)) in got.groups_mut().into_iter().zip(right.groups_mut()).take(4) {
        let error = relative(got, right);
        println!("{group}: {error:.1e}");
        assert!(error < 2e-5, "{group}: {error:.1e}");
    }
}

/// Photos of the capture at a depth of 3 each.
fn measured(photos: &[Photo]) -> Vec<Photo> {
    let map = DepthMap { width: 8, height: 6, depths: vec![3.0; 48].into(), unit: 1.0 };
    photos.iter().map(|photo| Photo { depth: Some(map.clone()), ..photo.clone() }).collect()
}

#[test]
fn runs_with_depths_repeat_to_the_bit_and_without_maps_cost_nothing() {
    let (device, again) = (device(), repeats());
    let c = capture();
    let start = |device: &Device, photos: Vec<Photo>, depth_loss: bool| {
        let options = Options { depth_loss, ..options() };
        Trainer::new(device, &c.start, photos, c.extent, options).unwrap()
    };
    let model = |device: &Device, photos: Vec<Photo>, depth_loss: bool| {
        let mut trainer = start(device, photos, depth_loss);
        train(&mut trainer, 40);
        bits(&trainer.download().unwrap())
    };
    let (plain, with) = (model(&device, c.train.clone(), false), model(&device, measured(&c.train), true));
    assert!(plain == model(&again, c.train.clone(), true) && plain == model(&again, measured(&c.train), false));
    assert!(with == model(&again, measured(&c.train), true) && with != plain);
    let mut half = start(&again, measured(&c.train), true);
    train(&mut half, 22);
    let options = Options { depth_loss: true, ..options() };
    let snapshot = half.snapshot().unwrap();
    let mut rest = Trainer::resume(&again, &snapshot, measured(&c.train), c.extent, options).unwrap();
    train(&mut rest, 40);
    assert!(bits(&rest.download().unwrap()) == with, "resumed");
    let kernels = |photos: Vec<Photo>, iteration: u32| -> usize {
        let mut trainer = start(&again, photos, true);
        train(&mut trainer, iteration - 1);
        trainer.recording().unwrap().kernels().iter().filter(|k| k.contains("depth_loss")).count()
    };
    assert_eq!([EVERY - 1, EVERY, EVERY + 1].map(|i| kernels(measured(&c.train), i)), [0, 2, 0]);
    assert_eq!(kernels(c.train.clone(), EVERY), 0);
    finish(&device);
}
