//! Poses: the kernel against its twin, cameras that were turned on purpose, and checkpoints.

use crate::device::train::runs::train;
use crate::support::runs::config;
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish};
use glam::DVec3;
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::job::Silent;
use qirf_vk::pipeline::prepare;
use qirf_vk::reference::{self, poses as twin};
use qirf_vk::render::{Backward, Settings, TrainingRenderer};
use qirf_vk::scene::camera::Camera;
use qirf_vk::scene::{Photo, PhotoMemory};
use qirf_vk::synth::{SynthOptions, write};
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::initialise::{Seed, from_points};
use qirf_vk::train::poses::{Poses, STORED};
use qirf_vk::train::{Options, Trainer, TrainingModel};
use std::path::Path;

/// The gradient by the camera's motion against float64.
#[test]
fn the_kernel_is_its_twin() {
    let device = &device();
    let camera = small_camera(40, 30);
    let model = narrowed(&random_scene(&camera, 4));
    let params = reference::Params::from(&model);
    let mut random = Random(8);
    let weights: Vec<[f32; 4]> = (0..40 * 30)
        .map(|_| [(); 4].map(|()| random.within(-1.0, 1.0) as f32))
        .map(|[r, g, b, _]| [r, g, b, 0.0])
        .collect();
    let by_image: Vec<[f64; 3]> = weights.iter().map(|w| [w[0], w[1], w[2]].map(f64::from)).collect();
    let by = reference::gradients(&params, &camera, &reference::Settings::default(), &by_image, None).params;
    let right = twin::gradient(&params, &by, camera.centre(), 3);

    let photo = || Photo::opaque(camera.clone(), vec![0; 4 * 40 * 30]);
    let poses = Poses::new(device, &[photo(), photo()]).unwrap();
    let training = TrainingModel::new(device, &model).unwrap();
    let renderer = TrainingRenderer::new(device, Settings::default(), model.len(), [40, 30], 1 << 14).unwrap();
    let gradient = device.upload("image gradient", &weights).unwrap();
    let mut recording = Recording::new();
    renderer.record(&mut recording, &training.model, &camera);
    renderer.record_backward(&mut recording, &training.model, &camera, &gradient, Backward::default());
    for _ in 0..2 {
        poses.record(&mut recording, &renderer, &training, (1, &camera));
    }
    device.run(recording).unwrap();
    let stored = poses.stored(device).unwrap();
    assert_eq!(stored.len(), 2 * STORED);
    let (first, second) = stored.split_at(STORED);
    assert!(first[..24].iter().all(|v| *v == 0.0), "the other photo");
    let scale = right.iter().fold(0.0_f64, |most, g| most.max(g.abs()));
    for (got, right) in second[18..24].iter().zip(right) {
        assert!((f64::from(*got) - 2.0 * right).abs() < 2e-4 * scale, "{got} {right} of {scale}");
    }
    finish(device);
}

/// A capture whose training cameras are turned by these numbers of pixels.
fn trainer(
    device: &Device,
    scene: &Path,
    pixels: f64,
    snapshot: Option<&Snapshot>,
) -> (Trainer, Vec<Camera>, Vec<DVec3>) {
    let config = config(scene, 280);
    let mut prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
    let mut random = Random(3);
    let right: Vec<Camera> = prepared.train.iter().map(|photo| photo.camera.clone()).collect();
    let turns: Vec<DVec3> =
        right.iter().map(|c| DVec3::from([(); 3].map(|()| random.within(-pixels, pixels))) / c.focal.x).collect();
    let shared = turns.iter().sum::<DVec3>() / turns.len() as f64;
    for (photo, turn) in prepared.train.iter_mut().zip(turns) {
        photo.camera = photo.camera.moved(turn - shared, DVec3::ZERO);
    }
    let options = Options {
        schedule: config.schedule.clone(),
        degree: 1,
        most: 3000,
        poses: true,
        pairs: 1 << 14,
        ..Options::default()
    };
    let seeds: Vec<Seed> = prepared.scene.points.iter().map(Seed::from).collect();
    let made = match snapshot {
        Some(snapshot) => Trainer::resume(device, snapshot, prepared.train, prepared.extent, options),
        None => Trainer::new(device, &from_points(&seeds), prepared.train, prepared.extent, options),
    };
    (made.unwrap(), right, seeds.iter().map(|seed| seed.position).collect())
}

/// Root mean square of the ways, in pixels, by which these cameras see the scene's points beside their right places.
fn apart(photos: &[Photo], right: &[Camera], points: &[DVec3]) -> f64 {
    let place = |camera: &Camera, point: DVec3| {
        let seen = camera.rotation * point + camera.translation;
        (seen.z > 0.0).then(|| seen.truncate() / seen.z * camera.focal + camera.principal)
    };
    let ways: Vec<f64> = photos
        .iter()
        .zip(right)
        .flat_map(|(photo, right)| points.iter().map(move |point| (place(&photo.camera, *point), place(right, *point))))
        .filter_map(|(a, b)| Some(a?.distance_squared(b?)))
        .collect();
    (ways.iter().sum::<f64>() / ways.len() as f64).sqrt()
}

/// Cameras that were turned by about a pixel find back, while the model is trained; resumed from a file in the middle
/// of a round, a run goes on with the same bytes.
#[test]
fn turned_cameras_find_back_and_are_kept_in_checkpoints() {
    let device = device();
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 16, width: 64, height: 48, points: 600, ..SynthOptions::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    let (mut whole, right, points) = trainer(&device, folder.path(), 1.5, None);
    let before = apart(whole.photos(), &right, &points);
    train(&mut whole, 205);
    let file = folder.path().join("checkpoint");
    whole.snapshot().unwrap().write(&file).unwrap();
    // Rounds of 14 photos end, and move cameras, after 210, 224 and 238.
    train(&mut whole, 240);
    let later = whole.snapshot().unwrap();
    train(&mut whole, 280);
    let after = apart(whole.photos(), &right, &points);
    assert!(after < 0.5 * before, "{before} pixels before, {after} after");
    let moved = whole.moved_cameras().unwrap();
    assert!(moved.len() == right.len() && moved.iter().all(|pixels| (0.1..5.0).contains(pixels)), "{moved:?}");

    let (mut resumed, ..) = trainer(&device, folder.path(), 1.5, Some(&Snapshot::read(&file).unwrap()));
    train(&mut resumed, 240);
    let again = resumed.snapshot().unwrap();
    assert!(later.model == again.model && later.poses == again.poses && later.poses.len() == STORED * right.len());
    finish(&device);
}
