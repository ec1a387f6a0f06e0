//! Results do not depend on the order of commands that no barrier orders; with a missing barrier they would.

mod barriers;

use super::train::runs::{bits, capture, options, train};
use crate::support::synthetic::{scatter, scattered};
use crate::support::{finish, opened};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::{Device, DeviceClass, Error, Forget, Order, TuningChoice};
use qirf_vk::qirf::assemble::{Assembly, Options as Batches};
use qirf_vk::qirf::participation::device::Problem;
use qirf_vk::qirf::rrdm::Density;
use qirf_vk::render::{Renderer, Style};
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Exposures, Options, Trainer};

/// Iterations before the prune, the last of which average responses; density steps after 10 and 20.
const BEFORE: u32 = 30;
const AFTER: u32 = 34;

/// Training with all its kernels: anti-aliasing, exposures, averaged responses.
fn all_effects() -> Options {
    let schedule = Schedule {
        iterations: 40,
        densify_from: 0.1,
        densify_until: 0.6,
        densify_every: 10,
        opacity_reset_every: 15,
        ..options().schedule
    };
    let style = Style { antialias: true, depth_order: true, ..Style::default() };
    let (settings, exposure) = (style.over([0.1, 0.2, 0.3]), Some(Exposures::Learnt(Vec::new())));
    Options { schedule, settings, exposure, degree: 1, averaged: 22..BEFORE, pairs: 1 << 13, ..options() }
}

fn new_trainer(device: &Device, photos: usize) -> Trainer {
    let c = capture();
    Trainer::new(device, &c.start, c.train[..photos].to_vec(), c.extent, all_effects()).unwrap()
}

/// The bits of a state.
fn words(s: &Snapshot) -> Vec<u32> {
    let moments = Vec::from(s.moments.each_ref().into_array()).into_iter().flatten();
    let others = [&s.growth, &s.responses.0, &s.exposures.0, &s.exposures.1].into_iter().flatten();
    let floats = moments.chain(others).map(|v| v.to_bits());
    bits(&s.model).into_iter().chain(floats).chain(s.responses.1.iter().copied()).collect()
}

/// The results, as words, of the pass over the views and of overlaps and participation for blocks of any size.
fn respond_and_assemble(device: &Device, trainer: &mut Trainer) -> Vec<u32> {
    let responses = trainer.responses(qirf_vk::response::Wanted::BOTH).unwrap();
    let scores: &[f32] = bytemuck::cast_slice(&responses.scores);
    let mut words: Vec<u32> = responses.channels.as_flattened().iter().chain(scores).map(|v| v.to_bits()).collect();
    let n = trainer.len() as u32;
    let members: Vec<u32> = (0..n).rev().collect();
    let starts: Vec<u32> = [0, 1, 1, 9, 22, 64].into_iter().filter(|s| *s < n).chain([n]).collect();
    let options = Batches { density: Some(Density::default()), batch_bytes: 4 * 2000, ..Batches::default() };
    let assembly = Assembly::new(device, trainer.model(), &members, &starts, &responses.channels, options).unwrap();
    assembly
        .for_each::<Error>(|batch| {
            for (_, block) in batch.iter() {
                words.extend(block.overlap.iter().chain(block.factor).map(|v| v.to_bits()));
            }
            Ok(())
        })
        .unwrap();
    assembly
        .solve_each::<Error>(Problem::default(), |_, solved| {
            words.extend(solved.q.iter().map(|v| v.to_bits()));
            Ok(())
        })
        .unwrap();
    words
}

/// Training with density control, a prune, some more training, a picture.
fn whole(device: &Device) -> Vec<u32> {
    let mut trainer = new_trainer(device, capture().train.len());
    train(&mut trainer, BEFORE);
    assert!(trainer.averages().unwrap().is_some());
    let mut all = words(&trainer.snapshot().unwrap());
    all.extend(respond_and_assemble(device, &mut trainer));
    let keep: Vec<bool> = (0..trainer.len()).map(|i| i % 3 > 0).collect();
    trainer.keep(&keep, None).unwrap();
    train(&mut trainer, AFTER);
    all.extend(words(&trainer.snapshot().unwrap()));
    let camera = &capture().train[0].camera;
    let settings = all_effects().settings;
    let mut renderer = Renderer::new(device, settings, trainer.len(), camera.width, camera.height).unwrap();
    let image = renderer.render(trainer.model(), camera).unwrap();
    all.extend(image.pixels.as_flattened().iter().map(|v| v.to_bits()));
    all
}

fn the_same_bytes(class: DeviceClass) {
    let tuning = Some(TuningChoice::class(class));
    let open = |order| {
        let tuning = tuning.clone();
        opened(|options| (options.tuning, options.harness.order) = (tuning, order))
    };
    let plain = open(None);
    let right = whole(&plain);
    finish(&plain);
    let device = open(Some(Order::Backwards));
    for order in [Order::Backwards, Order::Shuffled(1)] {
        let derived = device.reorder(order, Forget::Nothing);
        assert!(right == whole(&device), "{class} in the order {order:?}, after {} barriers", derived.len());
    }
    finish(&device);
}

/// More Gaussians and tiles than a device in disorder has workgroups in a row, so that it starts surplus ones in every
/// kernel of training and of responses, as any device does beyond 65,535.
fn long_dispatches(device: &Device) -> Vec<u32> {
    // One less than a multiple of 64, so that the first surplus workgroup begins right behind the arrays' ends, in the
    // red zones.
    const GAUSSIANS: usize = 71 * 64 - 1;
    let opacity_logits = (0..GAUSSIANS).map(|i| scatter(i, 3)).collect();
    let model = Gaussians { opacity_logits, ..scattered(GAUSSIANS, 1, -3.5) };
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, 177, 163);
    let pixels = (0..177 * 163 * 4).map(|k| (k * 7) as u8).collect::<Vec<u8>>();
    let schedule = Schedule { half_until: 0.0, ..Schedule::default() };
    let options = Options { schedule, degree: 1, pairs: 1 << 17, ..Options::default() };
    let mut trainer = Trainer::new(device, &model, vec![Photo::opaque(camera, pixels)], 1.0, options).unwrap();
    train(&mut trainer, 2);
    let mut all = words(&trainer.snapshot().unwrap());
    let responses = trainer.responses(qirf_vk::response::Wanted::BOTH).unwrap();
    let scores: &[f32] = bytemuck::cast_slice(&responses.scores);
    all.extend(responses.channels.as_flattened().iter().chain(scores).map(|v| v.to_bits()));
    all
}

/// Surplus workgroups find nothing to do. Each tile is walked once, whatever the distance between rows, even one beyond their
/// number.
#[test]
fn surplus_workgroups_and_distances_between_rows_change_nothing() {
    for class in [DeviceClass::Cpu, DeviceClass::Gpu] {
        let stride = |rows: u32| -> TuningChoice { format!("{class},row_stride={rows}").parse().unwrap() };
        let (own, disorder) = (TuningChoice::class(class), Some(Order::Recorded));
        let devices = [(own.clone(), None), (own, disorder), (stride(5), None), (stride(1000), None)];
        let [plain, others @ ..] = devices.map(|(tuning, order)| {
            let device = opened(|options| (options.tuning, options.harness.order) = (Some(tuning), order));
            let all = long_dispatches(&device);
            finish(&device);
            all
        });
        let changed = others.map(|other| other != plain);
        assert_eq!(changed, [false; 3], "as tuned for {class}, in disorder and with rows 5 and 1000 apart");
    }
}

#[test]
fn every_order_gives_the_same_bytes() {
    the_same_bytes(DeviceClass::Cpu);
}

#[test]
fn every_order_gives_the_same_bytes_as_tuned_for_gpus() {
    the_same_bytes(DeviceClass::Gpu);
}
