//! The estimate of a run's device memory, against the memory that the run takes.

use crate::support::synthetic::scattered;
use crate::support::{device, finish, new_device};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::Device;
use qirf_vk::lab::methods::learnt_mask::{LearntMask, LearntMasks, MaskMethod};
use qirf_vk::render::{Purpose, Renderer, Style, TrainingRenderer, Uses};
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::device_photos::DevicePhotos;
use qirf_vk::train::method::Method;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer, TrainerNeeds, TrainingModel};
use std::ops::ControlFlow;
use std::sync::Arc;

fn model(n: usize, degree: usize) -> Gaussians {
    scattered(n, degree, -3.0)
}

fn view(width: u32, height: u32) -> Photo {
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, width, height);
    Photo::opaque(camera, vec![99; (width * height * 4) as usize])
}

/// Byte counts are exact: of the model, which is reckoned, and of a renderer, whose buffers are counted without being made.
#[test]
fn bytes_are_known_before_they_are_taken() {
    let device = device();
    let taken = |make: &dyn Fn() -> Box<dyn std::any::Any>| {
        let before = device.memory_used().0;
        let _made = make();
        device.memory_used().0 - before
    };
    for n in [0, 1, 777, 20_000] {
        for degree in [0, 1, 3] {
            let (d, m) = (&device, model(n, degree));
            assert_eq!(taken(&|| Box::new(Resident::upload(d, &m).unwrap())), Resident::bytes(n, degree));
            assert_eq!(taken(&|| Box::new(TrainingModel::new(d, &m).unwrap())), TrainingModel::bytes(n, 0, degree));
        }
        for (size, pairs, depth_order) in [([1, 1], 1, true), ([33, 20], 5000, false), ([100, 257], 1 << 18, true)] {
            let style = Style { depth_order, ..Style::default() };
            let uses = Uses { purpose: Purpose::Training, responses: false, style };
            let settings = style.over([0.0; 3]);
            let made = taken(&|| Box::new(TrainingRenderer::new(&device, settings, n, size, pairs).unwrap()));
            assert_eq!(made, Renderer::bytes(&device, n, size, pairs, uses), "{n} at {size:?}, {pairs} pairs");
        }
    }
    let views = [view(8, 4), view(16, 16)];
    let sizes = views.each_ref().map(|v| v.pixels.len() as u64);
    let right = DevicePhotos::bytes(&sizes, device.memory_limit());
    assert_eq!(taken(&|| Box::new(DevicePhotos::new(&device, &views).unwrap())), right);
    assert_eq!(right, 8 * 4 * 4 + 16 * 16 * 4);
    assert_eq!(DevicePhotos::bytes(&sizes, 4), 4 * 16 * 16 * 4, "one at a time, and three under way");
    finish(&device);
}

/// Peak memory of a run, as a share of its estimate.
fn share(device: &Device, n: usize, degree: usize, grows: bool, masks: Option<MaskMethod>) -> f64 {
    let size @ [w, h] = [200, 150];
    let views: Vec<Photo> = (0..4).map(|_| view(w, h)).collect();
    let photos = views.iter().map(|v| v.pixels.len() as u64).collect();
    let pairs = 16 * n as u32;
    let iterations = if grows { 60 } else { 20 };
    let schedule = Schedule {
        iterations,
        densify_from: 0.1,
        densify_until: if grows { 0.8 } else { 0.0 },
        densify_every: 10,
        densify_gradient: 0.0,
        degree_every: 0.1,
        half_until: 0.3,
        ..Schedule::default()
    };
    let method = masks.map(|method| -> Arc<dyn Method> {
        Arc::new(LearntMask::new(device, LearntMasks::of(method, n / 2, iterations)).unwrap())
    });
    let options = Options { schedule, degree, most: n, method: method.clone(), pairs, ..Options::default() };
    let first = if grows { n / 4 } else { n };
    let mut trainer = Trainer::new(device, &model(first, 0), views, 1.0, options).unwrap();
    for until in [2, iterations] {
        trainer.run_until(until, |_, _| ControlFlow::Continue(())).unwrap();
        trainer.snapshot().unwrap();
    }
    assert_eq!(trainer.model().degree, degree);
    let demand = TrainerNeeds {
        gaussians: n,
        pairs,
        size,
        photos,
        depths: 0,
        degree,
        method,
        halves: true,
        grows,
        ..TrainerNeeds::default()
    };
    let (peak, expected) = (device.memory_used().1, Trainer::bytes(device, &demand));
    println!("{first} -> {} of {n}, degree {degree}: peak {peak}, expected {expected}", trainer.len());
    finish(device);
    peak as f64 / expected as f64
}

/// Moments of the last SH band are the largest, unless there are few bands or many pixels.
#[test]
fn the_largest_buffer_is_known() {
    let device = device();
    let largest = |degree: usize, pairs: u32, side: u32| {
        let needs = TrainerNeeds { gaussians: 1000, degree, pairs, size: [side; 2], ..TrainerNeeds::default() };
        let largest = Trainer::largest_buffer(&device, &needs);
        (largest.name, largest.bytes)
    };
    assert_eq!(largest(3, 5000, 8), ("sh3.moments".to_owned(), 168_000));
    assert_eq!(largest(2, 5000, 8), ("sh2.moments".to_owned(), 120_000));
    assert_eq!(largest(0, 4000, 8), ("gradient rows".to_owned(), 72_000));
    assert_eq!(largest(0, 5000, 8), ("position sums".to_owned(), 80_000));
    let pictures = largest(3, 5000, 200).1;
    assert!([36, 48].contains(&(pictures / 40_000)), "{pictures}");
}

/// Runs with a checkpoint take what was expected, to one percent, and never more.
#[test]
fn runs_take_what_was_expected() {
    let masks = Some(MaskMethod::MaskGaussian);
    for (n, degree, grows, masks) in
        [(500, 0, false, None), (2000, 3, false, None), (4000, 1, true, None), (4000, 0, false, masks)]
    {
        let share = share(&new_device(), n, degree, grows, masks);
        assert!((0.99..=1.0).contains(&share), "{n} Gaussians of degree {degree}: {share}");
    }
}
