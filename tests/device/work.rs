//! Counted work of an iteration of training: the same on every machine, so that a change of it is a change of the code.

use crate::support::synthetic::scattered;
use glam::DVec3;
use qirf_vk::gpu::{Device, DeviceClass, DeviceOptions, Hazards, TuningChoice, Work};
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer};
use std::ops::ControlFlow;

/// An iteration's work as last measured.
struct Expected {
    tuning: DeviceClass,
    gaussians: usize,
    degree: usize,
    dispatches: usize,
    barriers: usize,
    /// In 10^6 bytes.
    read: f64,
    written: f64,
}

/// SH of degree 2 at 1 M Gaussians: llvmpipe binds at most 128 MiB at a time. What a kernel may read counts: rows of gradients, 72 bytes a
/// Gaussian, which are read with a depth loss alone.
const EXPECTED: [Expected; 4] = [
    expected(DeviceClass::Cpu, 10_000, 3, [32, 33], [42.4, 33.3]),
    expected(DeviceClass::Gpu, 10_000, 3, [27, 28], [29.9, 22.5]),
    expected(DeviceClass::Cpu, 1_000_000, 2, [32, 33], [1870.0, 1272.6]),
    expected(DeviceClass::Gpu, 1_000_000, 2, [31, 32], [1715.1, 1206.2]),
];

const fn expected(
    tuning: DeviceClass,
    gaussians: usize,
    degree: usize,
    [dispatches, barriers]: [usize; 2],
    [read, written]: [f64; 2],
) -> Expected {
    Expected { tuning, gaussians, degree, dispatches, barriers, read, written }
}

fn trainer(device: &Device, gaussians: usize, degree: usize, side: u32) -> Trainer {
    let model = scattered(gaussians, degree, -4.0);
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, side, side);
    let photo = Photo::opaque(camera, vec![99; (side * side * 4) as usize]);
    let never = u32::MAX;
    let schedule =
        Schedule { densify_every: never, opacity_reset_every: never, half_until: 0.0, ..Schedule::default() };
    let pairs = 4 * gaussians as u32;
    Trainer::new(device, &model, vec![photo], 1.0, Options { schedule, degree, pairs, ..Options::default() }).unwrap()
}

fn opened(class: DeviceClass) -> Device {
    let tuning = Some(TuningChoice::class(class));
    Device::open(&DeviceOptions { tuning, ..DeviceOptions::from_env().unwrap() }).unwrap()
}

#[test]
fn an_iteration_does_the_work_that_is_known() {
    println!(
        "| tuning | Gaussians | SH | dispatches | transfers | barriers | MB read | MB written | Adam, bytes a Gaussian |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|---:|---:|");
    let mut wrong = Vec::new();
    for expected in &EXPECTED {
        let (n, side) = (expected.gaussians, if expected.gaussians > 100_000 { 1024 } else { 256 });
        let device = opened(expected.tuning);
        let mut trainer = trainer(&device, n, expected.degree, side);
        let recording = trainer.recording().unwrap();
        let mut hazards = Hazards::default();
        recording.work(&mut hazards);
        // The second of two iterations: the first leaves hazards pending.
        let work: Work = recording.work(&mut hazards);
        let adam = recording.work_of("train/adam");
        let (read, written) = (work.read as f64 / 1e6, work.written as f64 / 1e6);
        println!(
            "| {} | {n} | {} | {} | {} | {} | {read:.1} | {written:.1} | {:.0} |",
            expected.tuning,
            expected.degree,
            work.dispatches,
            work.transfers,
            work.barriers,
            (adam.read + adam.written) as f64 / n as f64,
        );
        // Measured with subgroups of 8: at other widths, sorts have more or fewer counters and levels of their sums.
        let (levels, share) = if device.info().subgroup_size == 8 { (0, 0.03) } else { (2, 0.2) };
        let near = |got: f64, right: f64| (got - right).abs() <= share * right;
        if work.dispatches.abs_diff(expected.dispatches) > levels
            || work.barriers.abs_diff(expected.barriers) > levels
            || !near(read, expected.read)
            || !near(written, expected.written)
        {
            wrong.push((expected.tuning, n, work));
        }
    }
    assert!(wrong.is_empty(), "measured otherwise before: {wrong:#?}");
}

/// The host submits 16 iterations before it checks guards, pairs and the loss, which arrive with the last of them: the
/// device never idles for a question.
#[test]
fn the_host_asks_nothing_between_iterations() {
    let device = opened(DeviceClass::Cpu);
    let mut trainer = trainer(&device, 1000, 1, 32);
    trainer.advance(16).unwrap();
    let before = device.traffic();
    trainer.advance(32).unwrap();
    let after = device.traffic();
    let (submissions, round_trips) = (after.submissions - before.submissions, after.round_trips - before.round_trips);
    println!("16 iterations: {submissions} submissions, {round_trips} of them waited for at once");
    assert_eq!((trainer.iteration(), submissions, round_trips), (32, 16, 0));
}

/// The work for which `tools/host-cost` counts the host's instructions; `QIRF_ITERATIONS` sets the number of
/// iterations.
#[test]
#[ignore = "tools/host-cost runs it under callgrind"]
fn iterations_to_count() {
    let until: u32 = std::env::var("QIRF_ITERATIONS").unwrap().parse().unwrap();
    let device = opened(DeviceClass::Gpu);
    let mut trainer = trainer(&device, 1000, 3, 64);
    trainer.run_until(until, |_, _| ControlFlow::Continue(())).unwrap();
}
