//! `cost`: a picture's time against its pixels and against its pairs; both should grow in a straight line.

use super::{device, group, scenes};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::render::{Renderer, STAGES, Settings};
use std::time::{Duration, Instant};

const GAUSSIANS: usize = 50_000;

/// 50 k Gaussians: first at four sizes of picture, then at one size with larger and larger Gaussians.
pub fn cost(criterion: &mut Criterion) {
    let mut group = group(criterion, "cost");
    let heights = [180, 360, 540, 720].map(|height| ("pixels", height, 1.0));
    let sizes = [0.5, 1.0, 2.0, 4.0].map(|size| ("pairs", 360, size));
    for (axis, height, size) in heights.into_iter().chain(sizes) {
        let camera = scenes::camera(height * 16 / 9, height);
        let model = scenes::crowd(GAUSSIANS, 0, size, 2);
        let resident = Resident::upload(device(), &model).unwrap();
        let mut renderer = Renderer::new(device(), Settings::default(), GAUSSIANS, camera.width, height).unwrap();
        let (_, _, pairs) = renderer.render_timed(&resident, &camera).unwrap();
        let pixels = u64::from(camera.width * height);
        println!("cost/{axis}: {pixels} pixels, {pairs} pairs");
        let (elements, id) = match axis {
            "pixels" => (pixels, format!("{} x {height}", camera.width)),
            _ => (u64::from(pairs), format!("size {size}")),
        };
        group.throughput(Throughput::Elements(elements));
        group.bench_function(BenchmarkId::new(axis, id), |b| {
            b.iter_custom(|iterations| {
                let start = Instant::now();
                let draw = |_| renderer.draw(&resident, &camera).unwrap();
                let timings: Vec<_> = (0..iterations).map(draw).collect();
                let device_time = timings.iter().flat_map(|t| STAGES.iter().map(|s| t.seconds(s))).sum();
                if super::has_timestamps() { Duration::from_secs_f64(device_time) } else { start.elapsed() }
            });
        });
    }
    group.finish();
}
