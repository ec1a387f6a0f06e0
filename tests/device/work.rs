//! Counted work of an iteration of training: the same on every machine, so that a change of it is a change of the code.

use crate::support::synthetic::scattered;
use glam::DVec3;
use qirf_vk::gpu::{Device, DeviceClass, DeviceOptions, Hazards, TuningChoice, Work};
use qirf_vk::render::{Renderer, Settings};
use qirf_vk::response::Wanted;
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;
use qirf_vk::train::growth::Growth;
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
    let never = u32::MAX;
    let schedule =
        Schedule { densify_every: never, opacity_reset_every: never, half_until: 0.0, ..Schedule::default() };
    let pairs = 4 * gaussians as u32;
    trainer_of(device, gaussians, [side, 1], Options { schedule, degree, pairs, ..Options::default() })
}

/// A trainer on so many equal photos of `side` x `side`.
fn trainer_of(device: &Device, gaussians: usize, [side, photos]: [u32; 2], options: Options) -> Trainer {
    let model = scattered(gaussians, options.degree, -4.0);
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, side, side);
    let photo = Photo::opaque(camera, vec![99; (side * side * 4) as usize]);
    Trainer::new(device, &model, vec![photo; photos as usize], 1.0, options).unwrap()
}

/// Submissions of some work, and how many of them were waited for at once.
fn asked<T>(device: &Device, work: impl FnOnce() -> T) -> [u64; 2] {
    let before = device.traffic();
    work();
    let after = device.traffic();
    [after.submissions - before.submissions, after.round_trips - before.round_trips]
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
    assert_eq!(asked(&device, || trainer.advance(32).unwrap()), [16, 0]);
    assert_eq!(trainer.iteration(), 32);
}

/// A density step of a plan is two submissions: one tells the host which Gaussians go and grow, and the other, which it
/// waits for at once, does the rest. The renderer's buffers are freed and made, which asks nothing of the device. Nor does
/// the host wait for an opacity reset.
#[test]
fn a_density_step_is_two_submissions() {
    let device = opened(DeviceClass::Cpu);
    let growth = Some(Growth { gaussians: Some(2000), ..Growth::default() });
    // Density steps after 20, 40 and 60; opacities are reset after 50.
    let schedule =
        Schedule { iterations: 400, densify_from: 0.0, opacity_reset_every: 50, growth, ..Schedule::default() };
    let options = Options { schedule, degree: 0, pairs: 1 << 16, ..Options::default() };
    let mut trainer = trainer_of(&device, 1000, [32, 1], options);
    let mut until = |last: u32| {
        let asked = asked(&device, || trainer.run_until(last, |_, _| ControlFlow::Continue(())).unwrap());
        (asked, trainer.len())
    };
    let (_, before) = until(40);
    let (asked, after) = until(60);
    assert!(before > 1000 && after > before, "the arrays have room since they grew: {before}, {after}");
    assert_eq!(asked, [20 + 1 + 2, 1], "20 iterations, a reset and a step");
}

/// Each view of a pass is one submission, which also brings its number of pairs; a picture takes one more, to be read.
#[test]
fn a_view_is_one_submission() {
    let device = opened(DeviceClass::Cpu);
    let passes = [1, 3].map(|photos| {
        let mut trainer = trainer_of(&device, 100, [32, photos], Options { degree: 0, ..Options::default() });
        asked(&device, || trainer.responses(Wanted::BOTH).unwrap())[0]
    });
    assert_eq!(passes[1] - passes[0], 2);
    let trainer = trainer_of(&device, 100, [32, 1], Options { degree: 0, ..Options::default() });
    let mut renderer = Renderer::new(&device, Settings::default(), 100, 32, 32).unwrap();
    let camera = &trainer.photos()[0].camera;
    assert_eq!(asked(&device, || renderer.render(trainer.model(), camera).unwrap())[0], 2);
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
