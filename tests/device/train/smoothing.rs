//! 3D smoothing: the kernel against float64, and whole runs that keep its bound and their bytes.

use super::runs::{capture, options, resumed, same_however, train};
use crate::support::{device, finish, repeats};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::random::uniform;
use qirf_vk::reference::smoothing::least_scale;
use qirf_vk::render::{Settings, Style};
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::smoothing::Smoothing;
use qirf_vk::train::{Options, Trainer};

/// The smallest ratio of a Gaussian's least scale to its bound, and the number of Gaussians with a bound.
fn thinnest(model: &Gaussians, cameras: &[Camera], near: f32) -> (f64, usize) {
    let of = |(mean, scales): (&[f32; 3], &[f32; 3])| {
        let least = least_scale(DVec3::from(mean.map(f64::from)), cameras, f64::from(near))?;
        Some(scales.iter().fold(f64::INFINITY, |m, s| m.min(f64::from(*s))).exp() / least)
    };
    let ratios: Vec<f64> = model.means.iter().zip(&model.log_scales).filter_map(of).collect();
    (ratios.iter().copied().fold(f64::INFINITY, f64::min), ratios.len())
}

#[test]
fn scales_end_at_what_the_finest_photo_tells() {
    least_scales(&device());
}

pub fn least_scales(device: &Device) {
    let settings = Settings::default();
    // Near and far, large and small; one photo of another size and focal length.
    let views: Vec<Photo> = [(-4.0, 200, 0.8), (-9.0, 200, 0.8), (-2.5, 64, 1.4)]
        .iter()
        .map(|&(z, width, fov)| {
            let camera = Camera::look_at(DVec3::new(0.1, 0.2, z), DVec3::ZERO, DVec3::NEG_Y, fov, width, width);
            Photo::opaque(camera, vec![0; (width * width * 4) as usize])
        })
        .collect();
    let n = 5000;
    let draw = |i: usize, c: u64| (uniform(&[11, i as u64, c]) * 2.0 - 1.0) as f32;
    let mut model = Gaussians::zeroed(n, 0);
    for i in 0..n {
        model.means[i] = [6.0 * draw(i, 0), 6.0 * draw(i, 1), 12.0 * draw(i, 2)];
        model.log_scales[i] = [3, 4, 5].map(|c| 6.0 * draw(i, c) - 4.0);
    }
    let strange = [[f32::NAN, 0.0, 0.0], [f32::INFINITY; 3], [0.0, 0.0, -4.0]];
    model.means[..3].copy_from_slice(&strange);
    model.log_scales[3] = [f32::NAN, -20.0, 1.0];

    // The kernel uses the count on the device: rows behind it do not change.
    let counted = n - 100;
    let resident = Resident::upload(device, &model).unwrap();
    let mut recording = Recording::new();
    recording.update(&resident.count.value, &[counted as u32]);
    Smoothing::new(device, &views, &settings).unwrap().record(&mut recording, &resident, &resident.count);
    device.run(recording).unwrap();
    let after = resident.download(device).unwrap();

    let cameras: Vec<Camera> = views.iter().map(|v| v.camera.clone()).collect();
    let (mut raised, mut unseen, mut worst) = (0, 0, 0.0_f64);
    assert_eq!(after.log_scales[counted..], model.log_scales[counted..]);
    for i in 0..counted {
        let least = least_scale(DVec3::from(model.means[i].map(f64::from)), &cameras, f64::from(settings.near));
        for c in 0..3 {
            let (before, now) = (model.log_scales[i][c], after.log_scales[i][c]);
            match least {
                Some(least) if f64::from(before) < least.ln() => {
                    raised += 1;
                    worst = worst.max((f64::from(now) - least.ln()).abs());
                }
                Some(_) => assert_eq!(before.to_bits(), now.to_bits(), "{i}"),
                None => unseen += usize::from(before.to_bits() == now.to_bits()),
            }
        }
    }
    println!("{raised} raised, {unseen} of unseen ones left, worst {worst:e}");
    assert!(raised > 1000 && unseen > 1000);
    // A Gaussian at a photo's border may count as seen in float32 and not in float64, or vice versa.
    assert!(worst < 1e-5, "{worst}");
    assert_eq!(after.means[2], strange[2]);
    finish(device);
}

#[test]
fn runs_end_within_the_bound_and_resume_to_the_same_bytes() {
    let device = device();
    let antialiased = || {
        let style = Style { antialias: true, ..Style::default() };
        Options { settings: style.over([0.0; 3]), ..options() }
    };
    let last = options().schedule.iterations;
    let c = capture();
    let mut start = c.start.clone();
    start.log_scales.iter_mut().flatten().for_each(|s| *s -= 4.0); // thinner than any photo resolves
    let trainer =
        |device: &Device, options: Options| Trainer::new(device, &start, c.train.clone(), c.extent, options).unwrap();
    let run = |options: Options, until: u32| {
        let mut trainer = trainer(&device, options);
        train(&mut trainer, until);
        trainer
    };
    let whole = run(antialiased(), last);
    let cameras: Vec<Camera> = c.train.iter().map(|v| v.camera.clone()).collect();
    let near = Settings::default().near;
    let least = |trainer: &Trainer| thinnest(&trainer.download().unwrap(), &cameras, near);
    let (on, off) = (least(&whole), least(&run(options(), 40)));
    println!("least scale over its bound: {on:?} with smoothing, {off:?} without");
    assert!(on.0 > 1.0 - 1e-4 && on.1 > 50, "{on:?}");
    assert!(off.0 < 0.9, "the scene has Gaussians that need smoothing: {off:?}");

    // With a small initial capacity iterations are repeated. The run is also interrupted where no smoothing is due.
    let again = repeats();
    let begin = |pairs| trainer(&again, Options { pairs, ..antialiased() });
    same_however(&whole, &[41], begin, |at| resumed(&again, at, antialiased()));
    finish(&device);
}
