//! Photos at half their size: the device against its twin, and the camera that sees them.

use super::runs::{capture, options, same_however, train};
use crate::support::{device, finish, repeats};
use glam::{DVec2, DVec3};
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::random::uniform;
use qirf_vk::reference;
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::halve::{self, Halve};
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer};

fn halved(device: &Device, photo: &[u32], size: [u32; 2]) -> Vec<u32> {
    let half = Halve::new(device, size).unwrap();
    let photo = device.upload("photo", photo).unwrap();
    let mut recording = Recording::new();
    half.record(&mut recording, &photo, size);
    device.run(recording).unwrap();
    half.photo.read(device).unwrap()
}

#[test]
fn the_device_halves_as_its_twin_does() {
    let device = device();
    for size @ [width, height] in [[2, 2], [64, 48], [65, 3], [301, 200]] {
        let byte = |i: u32, c: u64| (uniform(&[7, u64::from(i), c]) * 256.0) as u32;
        let word = |i: u32, alpha: u32| byte(i, 0) | byte(i, 1) << 8 | byte(i, 2) << 16 | alpha << 24;
        // Opaque, of any alpha, and mostly transparent.
        let alphas: [&dyn Fn(u32) -> u32; 3] = [&|_| 255, &|i| byte(i, 3), &|i| if i % 9 == 0 { 200 } else { 0 }];
        for alpha in alphas {
            let photo: Vec<u32> = (0..width * height).map(|i| word(i, alpha(i))).collect();
            assert_eq!(halved(&device, &photo, size), reference::halve::halve(&photo, size), "{width} x {height}");
        }
    }
    finish(&device);
}

/// A point seen at a pixel's corner is seen at half that position in the half picture, for odd and even sizes.
#[test]
fn the_camera_sees_what_the_photo_shows() {
    let camera = Camera::look_at(DVec3::new(0.3, 0.2, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, 201, 151);
    let half = halve::camera(&camera).unwrap();
    assert_eq!((half.width, half.height), (100, 75));
    let seen = |c: &Camera| {
        let p = c.rotation * DVec3::new(0.7, -0.4, 0.9) + c.translation;
        c.focal * DVec2::new(p.x, p.y) / p.z + c.principal
    };
    assert!((seen(&camera) / 2.0).distance(seen(&half)) < 1e-12);
    let small = Camera::look_at(DVec3::NEG_Z, DVec3::ZERO, DVec3::NEG_Y, 0.8, 300, 127);
    assert!(halve::camera(&small).is_none(), "small pictures stay as they are");
}

/// A run that is interrupted in its halved part, or repeats iterations for lack of room, ends with the same bytes; its
/// second part halves nothing.
#[test]
fn halved_runs_end_with_the_same_bytes() {
    let (device, again) = (device(), repeats());
    let c = capture();
    // Each photo's pixels three times as wide and high: 192 x 144, of which one view is too small.
    let wide = |v: &Photo| {
        let (w, photo) = (v.camera.width as usize, v.pixels.read().unwrap());
        let row = |y: usize| (0..3 * w).flat_map(move |x| (0..4).map(move |b| (y / 3, x / 3, b)));
        let rows = (0..3 * v.camera.height as usize).flat_map(row);
        let pixels: Vec<u8> = rows.map(|(y, x, b)| photo[4 * (y * w + x) + b]).collect();
        Photo::opaque(v.camera.resized(3 * v.camera.width, 3 * v.camera.height), pixels)
    };
    let mut views: Vec<Photo> = c.train.iter().map(wide).collect();
    views[2] = c.train[2].clone();
    let halved = || {
        let schedule = Schedule { iterations: 50, half_until: 0.5, ..options().schedule };
        Options { schedule, ..options() }
    };
    let trainer =
        |device: &Device, options: Options| Trainer::new(device, &c.start, views.clone(), c.extent, options).unwrap();
    let mut whole = trainer(&device, halved());
    let halves = |trainer: &mut Trainer| trainer.recording().unwrap().kernels().contains(&"train/halve");
    // The view that is too small may be the first.
    assert!(
        halves(&mut whole) || {
            train(&mut whole, 1);
            halves(&mut whole)
        }
    );
    train(&mut whole, 25);
    assert!(!halves(&mut whole));
    train(&mut whole, 50);
    let resume = |at: &Snapshot| Trainer::resume(&again, at, views.clone(), c.extent, halved()).unwrap();
    same_however(&whole, &[11], |pairs| trainer(&again, Options { pairs, ..halved() }), resume);
    let plain = Options { schedule: Schedule { half_until: 0.0, ..halved().schedule }, ..halved() };
    assert!(!halves(&mut trainer(&device, plain)), "off is free");
    finish(&device);
}
