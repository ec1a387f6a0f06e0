//! `iteration`: one step of training, 10 k Gaussians at 144 x 256, and the share of each stage.

use super::bounds::{self, Bound};
use super::{WHOLE, device, group, has_timestamps, scenes, thousands};
use criterion::{BenchmarkId, Criterion};
use qirf_vk::render::{Renderer, Settings};
use qirf_vk::scene::{Photo, camera::Camera};
use qirf_vk::train::{Options, STAGES, Trainer, schedule::Schedule};
use qirf_vk::{gaussians::Gaussians, gaussians::resident::Resident};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

const GAUSSIANS: usize = 10_000;
const SIZE: [u32; 2] = [144, 256];

/// All effects off, SH of this degree from the first iteration, statistics gathered.
pub fn options(degree: usize) -> Options {
    Options { schedule: Schedule::still(), degree, most: GAUSSIANS, pairs: 1 << 20, ..Options::default() }
}

/// A model with SH of this degree and a camera, with the photo that it learns there.
pub fn scene(degree: usize) -> (Gaussians, Camera, Photo) {
    let camera = scenes::camera(SIZE[0], SIZE[1], 0.0);
    let target = Resident::upload(device(), &scenes::crowd(GAUSSIANS, degree, 1.0, 3)).unwrap();
    let mut renderer = Renderer::new(device(), Settings::default(), GAUSSIANS, SIZE[0], SIZE[1]).unwrap();
    let view = scenes::photo(&mut renderer, &target, &camera).unwrap();
    (scenes::crowd(GAUSSIANS, degree, 1.0, 4), camera, view)
}

/// Trains for `iterations` more iterations; returns the time by the host's clock.
pub fn train(trainer: &mut Trainer, iterations: u32) -> Duration {
    let until = trainer.iteration() + iterations;
    let start = Instant::now();
    trainer.run_until(until, |_, _| ControlFlow::Continue(())).unwrap();
    start.elapsed()
}

/// SH of degree 3.
pub fn iteration(criterion: &mut Criterion) {
    let (model, camera, view) = scene(3);
    let mut renderer = Renderer::new(device(), Settings::default(), GAUSSIANS, SIZE[0], SIZE[1]).unwrap();
    let resident = Resident::upload(device(), &model).unwrap();
    let (_, _, pairs) = renderer.render_timed(&resident, &camera).unwrap();
    let picture = bounds::picture(&model, &camera, pairs, renderer.tile());
    println!("iteration/{}: {pairs} pairs an image of {} x {}", thousands(GAUSSIANS), SIZE[0], SIZE[1]);
    let mut trainer = Trainer::new(device(), &model, vec![view], 1.0, options(3)).unwrap();
    let mut timed = |iterations: u32| {
        let before = trainer.timings().clone();
        let elapsed = train(&mut trainer, iterations);
        (before, trainer.timings().clone(), elapsed)
    };
    timed(16);

    let mut group = group(criterion, "iteration");
    for stage in STAGES.iter().filter(|_| has_timestamps()) {
        picture.stage(stage).note("iteration", &[stage, &thousands(GAUSSIANS)], &picture.numbers());
        group.bench_function(BenchmarkId::new(*stage, thousands(GAUSSIANS)), |b| {
            b.iter_custom(|iterations| {
                let (before, after, _) = timed(iterations as u32);
                Duration::from_secs_f64(after.seconds(stage) - before.seconds(stage))
            });
        });
    }
    let all: Bound = STAGES.iter().map(|stage| picture.stage(stage)).sum();
    all.note("iteration", &[WHOLE, &thousands(GAUSSIANS)], &picture.numbers());
    group.bench_function(BenchmarkId::new(WHOLE, thousands(GAUSSIANS)), |b| {
        b.iter_custom(|iterations| timed(iterations as u32).2);
    });
    group.finish();

    let (_, timings, _) = timed(16);
    let total: f64 = STAGES.iter().map(|s| timings.seconds(s)).sum();
    for stage in STAGES.iter().filter(|_| total > 0.0) {
        println!("iteration/{stage}: {:.1} % of device time", 100.0 * timings.seconds(stage) / total);
    }
}
