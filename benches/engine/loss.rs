//! `loss`: L1 + SSIM and its gradient by picture size; its cost is linear in pixels.

use super::bounds::Picture;
use super::{device, group, row, timed};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::response::Target;
use qirf_vk::scene::AlphaRole;
use qirf_vk::train::loss::{Loss, Weights};

/// Pictures of noise against photos of noise.
pub fn loss(criterion: &mut Criterion) {
    let device = device();
    let mut group = group(criterion, "loss");
    for [width, height] in [[144, 256], [288, 512], [576, 1024]] {
        let pixels = width as usize * height as usize;
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 8;
        let image: Vec<[f32; 4]> =
            (0..pixels).map(|i| [0, 1, 2, 3].map(|c| noise(4 * i + c) as f32 / 16_777_216.0)).collect();
        let photo: Vec<u32> = (0..pixels).map(|i| noise(i + 77) | 0xff00_0000).collect();
        let (image, photo) = (device.upload("image", &image).unwrap(), device.upload("photo", &photo).unwrap());
        let loss = Loss::new(device, width, height).unwrap();
        let (size, alpha_role) = ([width, height], AlphaRole::Opaque);
        let target = Target { photo: &photo, size, alpha_role, background: [0.0; 3] };
        group.throughput(Throughput::Elements(pixels as u64));
        let id = format!("{width}x{height}");
        let picture = Picture { size: [width, height], ..Picture::default() };
        picture.stage("loss").note("loss", &[&id], &[("pixels", pixels as f64)]);
        let run = || timed("loss", |r| loss.record(r, &image, target, Weights::default()));
        row(&mut group, BenchmarkId::from_parameter(id), run);
    }
    group.finish();
}
