//! `cost`: a picture's time against its pixels and against its pairs, each with the other held fixed; both should be
//! linear.

use super::bounds::{self, Bound};
use super::{device, group, row, scenes, time_of_picture};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::render::{Renderer, STAGES, Settings};
use std::time::Instant;

const GAUSSIANS: usize = 20_000;
/// Heights of pictures whose Gaussians are so small that dilation determines their size: the same number of pairs in
/// all.
const HEIGHTS: [u32; 5] = [180, 360, 720, 1080, 1440];
const SMALL: f64 = 0.02;
/// Sizes of Gaussians in a picture of one size: 16 times the pairs from the first to the last.
const SIZES: [f64; 6] = [0.02, 2.0, 4.0, 6.0, 8.0, 10.0];
const HEIGHT: u32 = 360;
/// An opacity of 2 %, so that no pixel finishes before its list ends, however many Gaussians cover it.
const FAINT: f32 = -3.9;

/// 20 k Gaussians: first at five sizes of picture, then at one size with increasingly large Gaussians.
pub fn cost(criterion: &mut Criterion) {
    let mut group = group(criterion, "cost");
    let heights = HEIGHTS.map(|height| ("pixels", height, SMALL));
    let sizes = SIZES.map(|size| ("pairs", HEIGHT, size));
    for (axis, height, size) in heights.into_iter().chain(sizes) {
        let camera = scenes::camera(height * 16 / 9, height, 0.0);
        let mut model = scenes::crowd(GAUSSIANS, 0, size, 2);
        model.opacity_logits.fill(FAINT);
        let resident = Resident::upload(device(), &model).unwrap();
        let mut renderer = Renderer::new(device(), Settings::default(), GAUSSIANS, camera.width, height).unwrap();
        let (_, _, pairs) = renderer.render_timed(&resident, &camera).unwrap();
        let pixels = u64::from(camera.width * height);
        println!("cost/{axis}: {pixels} pixels, {pairs} pairs");
        let (elements, id) = match axis {
            "pixels" => (pixels, format!("{} x {height}", camera.width)),
            _ => (u64::from(pairs), format!("size {size}")),
        };
        let picture = bounds::picture(&model, &camera, pairs, renderer.tile());
        let bound: Bound = STAGES.iter().map(|stage| picture.stage(stage)).sum();
        bound.note("cost", &[axis, &id], &picture.numbers());
        group.throughput(Throughput::Elements(elements));
        row(&mut group, BenchmarkId::new(axis, id), || {
            let start = Instant::now();
            time_of_picture(&renderer.draw(&resident, &camera).unwrap(), start)
        });
    }
    group.finish();
}
