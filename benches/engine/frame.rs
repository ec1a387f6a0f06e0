//! `frame`: time by stage of one picture of 1280 x 720, for 10 k, 100 k and 500 k Gaussians.

use super::bounds::{self, Bound};
use super::{WHOLE, device, group, has_timestamps, row, scenes, thousands};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::render::{Renderer, STAGES, Settings};
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [1280, 720];

/// SH of degree 3, the default settings.
pub fn frame(criterion: &mut Criterion) {
    let device = device();
    let [width, height] = SIZE;
    let camera = scenes::camera(width, height, 0.0);
    let mut group = group(criterion, "frame");
    for n in [10_000, 100_000, 500_000] {
        let model = scenes::crowd(n, 3, 1.0, 1);
        let resident = Resident::upload(device, &model).unwrap();
        let mut renderer = Renderer::new(device, Settings::default(), n, width, height).unwrap();
        let (_, _, pairs) = renderer.render_timed(&resident, &camera).unwrap();
        let tile = renderer.tile();
        println!("frame/{}: {pairs} pairs an image of {width} x {height}, tiles of {tile} x {tile}", thousands(n));
        let picture = bounds::picture(&model, &camera, pairs, tile);
        for stage in STAGES.iter().filter(|_| has_timestamps()) {
            // Elements that a stage processes: Gaussians until they are binned, then pairs.
            let elements = if *stage == STAGES[0] || *stage == STAGES[1] { n as u64 } else { u64::from(pairs) };
            group.throughput(Throughput::Elements(elements));
            picture.stage(stage).note("frame", &[stage, &thousands(n)], &picture.numbers());
            let seconds = || renderer.draw(&resident, &camera).unwrap().seconds(stage);
            row(&mut group, BenchmarkId::new(*stage, thousands(n)), || Duration::from_secs_f64(seconds()));
        }
        group.throughput(Throughput::Elements(u64::from(pairs)));
        let all: Bound = STAGES.iter().map(|stage| picture.stage(stage)).sum();
        all.note("frame", &[WHOLE, &thousands(n)], &picture.numbers());
        row(&mut group, BenchmarkId::new(WHOLE, thousands(n)), || {
            let start = Instant::now();
            renderer.draw(&resident, &camera).unwrap();
            start.elapsed()
        });
    }
    group.finish();
}
