//! Benchmarks by stage: `cargo bench --bench engine [-- GROUP]`. docs/performance.md explains the groups.
//!
//! Times of stages are the device's own timestamps; on a device without any, only whole submissions are timed, by the
//! host's clock. `QIRF_BENCH_QUICK=1` takes as few samples as criterion allows. Facts about each benchmark, and its
//! minimum work, go into files beside criterion's.
#![allow(missing_docs)] // criterion's macros

mod bounds;
mod cost;
mod culling;
mod effects;
mod facts;
mod flowers;
mod frame;
mod iteration;
mod loss;
mod overlap;
mod peak;
mod primitives;
mod rates;
mod scenes;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, BenchmarkId, Criterion, SamplingMode, criterion_group, criterion_main};
use qirf_vk::gpu::{Device, DeviceOptions, Recording, Timings};
use qirf_vk::render::STAGES;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// The measured device, opened once, without validation.
fn device() -> &'static Device {
    static DEVICE: OnceLock<Device> = OnceLock::new();
    DEVICE.get_or_init(|| {
        let device =
            Device::open(&DeviceOptions::from_env().expect("options of the environment")).expect("a Vulkan device");
        let info = device.info();
        println!("device {} ({}), {}, subgroups of {}", info.name, info.kind, info.driver, info.subgroup_size);
        facts::note_device(info, quick());
        device
    })
}

/// True if the device times scopes itself.
fn has_timestamps() -> bool {
    device().info().timestamp_period > 0.0
}

/// Measures a row of a group. The first run, which may compile, does not count.
fn row(group: &mut BenchmarkGroup<'_, WallTime>, id: BenchmarkId, run: impl Fn() -> Duration) {
    run();
    group.bench_function(id, |b| b.iter_custom(|iterations| (0..iterations).map(|_| run()).sum()));
}

/// The time of the commands that `record` records under this name.
fn timed(scope: &'static str, record: impl FnOnce(&mut Recording)) -> Duration {
    let mut recording = Recording::new();
    recording.scope(scope, record);
    let start = Instant::now();
    time_of(&device().run(recording).unwrap(), scope, start)
}

/// The time of a picture's stages, or the time since `start` if there is none.
fn time_of_picture(timings: &Timings, start: Instant) -> Duration {
    let seconds = || STAGES.iter().map(|stage| timings.seconds(stage)).sum();
    if has_timestamps() { Duration::from_secs_f64(seconds()) } else { start.elapsed() }
}

/// Device time of a scope, or the time since `start` if there is none.
fn time_of(timings: &Timings, scope: &str, start: Instant) -> Duration {
    if has_timestamps() { Duration::from_secs_f64(timings.seconds(scope)) } else { start.elapsed() }
}

fn quick() -> bool {
    std::env::var("QIRF_BENCH_QUICK").is_ok_and(|v| !v.is_empty() && v != "0")
}

/// A group whose samples are of equal length. Warming up also compiles: drivers may do so at the first dispatch only.
fn group<'a>(criterion: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group.sampling_mode(SamplingMode::Flat);
    if quick() {
        group.sample_size(10).warm_up_time(Duration::from_millis(50)).measurement_time(Duration::from_millis(200));
    } else {
        group.sample_size(20).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
    }
    group
}

/// Name of the row for a whole picture or iteration.
const WHOLE: &str = "whole, by the host's clock";

/// Names such as 10 k and 100 k for groups and tables.
fn thousands(n: usize) -> String {
    format!("{}k", n / 1000)
}

criterion_group!(
    benches,
    rates::rates,
    primitives::sort,
    primitives::scan,
    frame::frame,
    cost::cost,
    effects::effects,
    culling::culling,
    loss::loss,
    iteration::iteration,
    overlap::overlap,
    overlap::participation,
    overlap::responses
);
criterion_main!(benches);
