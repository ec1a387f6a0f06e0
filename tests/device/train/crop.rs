//! Parts of photos: a part trains a model just as it does within the whole photo.

use super::runs::{bits, capture, options, train};
use crate::support::{device, finish};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::Device;
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::loss::Weights;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer};

const CORNER: [u32; 2] = [16, 16];
const SIZE: [u32; 2] = [40, 32];

/// The state after one iteration on one photo, without SSIM, whose windows reach beyond a part's edges.
fn once(device: &Device, model: &Gaussians, photo: Photo) -> Snapshot {
    let schedule = Schedule { densify_from: 0.0, ..options().schedule };
    let options = Options { weights: Weights { l1: 0.7, ssim: 0.0, l2: 0.3 }, schedule, ..options() };
    let mut trainer = Trainer::new(device, model, vec![photo], capture().extent, options).unwrap();
    train(&mut trainer, 1);
    trainer.snapshot().unwrap()
}

/// Rows whose splats lie within the part, with room to spare.
fn inside(model: &Gaussians, camera: &Camera) -> Vec<usize> {
    let within = |i: &usize| {
        let p = camera.rotation * DVec3::from(model.means[*i].map(f64::from)) + camera.translation;
        let largest = model.log_scales[*i].iter().copied().fold(f32::MIN, f32::max);
        let radius = 3.5 * (f64::from(largest).exp() / p.z * camera.focal.x + 0.6);
        let pixel = p.truncate() / p.z * camera.focal + camera.principal;
        p.z > 0.2
            && (0..2).all(|axis| {
                let (low, high) = (f64::from(CORNER[axis]), f64::from(CORNER[axis] + SIZE[axis]));
                pixel[axis] - radius > low && pixel[axis] + radius < high
            })
    };
    (0..model.len()).filter(within).collect()
}

/// Gradients (ten times the first moments) and density control's statistics equal those of the whole photo.
#[test]
fn a_part_keeps_the_photos_measure() {
    let device = device();
    let c = capture();
    let photo = c.train[1].clone();
    // About a pixel wide.
    let model = Gaussians { log_scales: vec![[-2.5; 3]; c.start.len()], ..c.start.clone() };
    let rows = inside(&model, &photo.camera);
    let whole = once(&device, &model, photo.clone());
    let part = once(&device, &model, photo.part(CORNER, SIZE).unwrap());
    let moved: Vec<usize> = rows.iter().copied().filter(|i| whole.growth[2 * i] > 0.0).collect();
    assert!(moved.len() > 15, "{} of {} rows", moved.len(), rows.len());
    let near = |a: f32, b: f32, scale: f32| (a - b).abs() <= 2e-5 * scale;
    let largest = |values: &[f32]| moved.iter().map(|i| values[6 * i].abs()).fold(0.0, f32::max);
    let scale = largest(&whole.moments.means);
    for &i in &moved {
        let [sum, views] = [0, 1].map(|k| (whole.growth[2 * i + k], part.growth[2 * i + k]));
        assert!(near(sum.0, sum.1, sum.0.max(1e-9)) && views.0 == views.1, "{i}: {sum:?} {views:?}");
        for k in [0, 2, 4] {
            let (a, b) = (whole.moments.means[6 * i + k], part.moments.means[6 * i + k]);
            assert!(near(a, b, scale), "{i}, {k}: {a} {b}");
        }
    }
    finish(&device);
}

/// A part that is the whole photo trains the same bits, and a repeated run on parts gives the same bits.
#[test]
fn runs_on_parts() {
    let device = device();
    let c = capture();
    let run = |photos: &dyn Fn(&Photo) -> Photo| {
        let photos = c.train.iter().map(photos).collect();
        let mut trainer = Trainer::new(&device, &c.start, photos, c.extent, options()).unwrap();
        train(&mut trainer, 60);
        bits(&trainer.download().unwrap())
    };
    let all = |p: &Photo| p.part([0, 0], [p.camera.width, p.camera.height]).unwrap();
    let whole = run(&Photo::clone);
    assert!(whole == run(&all));
    let some = |p: &Photo| p.part(CORNER, SIZE).unwrap();
    let parts = run(&some);
    assert!(parts == run(&some) && parts != whole);
    finish(&device);
}
