//! Whole runs on a small synthetic scene: the same bytes whatever the buffers' sizes, and a model of good quality.

use crate::support::{device, finish, opened, repeats};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::pipeline::evaluate::Evaluator;
use qirf_vk::render::Settings;
use qirf_vk::scene::{LoadOptions, OpenOptions, Photo, PhotoFile, Scene};
use qirf_vk::synth::{self, SynthOptions};
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::device_photos::DevicePhotos;
use qirf_vk::train::initialise::{Seed, from_points, random};
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Error, Options, Progress, Trainer};
use std::ops::ControlFlow;
use std::sync::OnceLock;

pub(crate) struct Capture {
    pub(crate) train: Vec<Photo>,
    test: Vec<Photo>,
    pub(crate) start: Gaussians,
    pub(crate) extent: f64,
}

/// Eight photos of 64 x 48, seven of them for training, made once.
pub(crate) fn capture() -> &'static Capture {
    static MADE: OnceLock<Capture> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let options = SynthOptions { views: 8, width: 64, height: 48, points: 200, ..SynthOptions::default() };
        synth::write(folder.path(), &options, &|_| ()).unwrap();
        let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| ()).unwrap();
        let split = scene.split(8);
        let photo = |&i: &usize| photos[i].clone();
        let seeds: Vec<Seed> = scene.points.iter().map(Seed::from).collect();
        assert!(seeds.len() > 50, "{} points", seeds.len());
        Capture {
            train: split.train.iter().map(photo).collect(),
            test: split.test.iter().map(photo).collect(),
            start: from_points(&seeds),
            extent: scene.extent(&split.train),
        }
    })
}

const ITERATIONS: u32 = 110;

pub(crate) fn options() -> Options {
    let schedule = Schedule {
        iterations: ITERATIONS,
        densify_from: 0.1,
        densify_until: 0.7, // density steps after 20, 40 and 60
        densify_every: 20,
        opacity_reset_every: 50,
        degree_every: 0.3,
        ..Schedule::default()
    };
    Options { schedule, seed: 5, degree: 2, most: 500, pairs: 1 << 16, ..Options::default() }
}

/// A run on the capture.
pub(crate) fn trainer(device: &Device, options: Options) -> Trainer {
    let c = capture();
    Trainer::new(device, &c.start, c.train.clone(), c.extent, options).unwrap()
}

/// A run resumed from the file of a checkpoint.
pub(crate) fn resumed(device: &Device, snapshot: &Snapshot, options: Options) -> Trainer {
    let (c, folder) = (capture(), tempfile::tempdir().unwrap());
    let file = folder.path().join("checkpoint.safetensors");
    snapshot.write(&file).unwrap();
    let read = Snapshot::read(&file).unwrap();
    assert!(read.arrays == snapshot.arrays && read.state == snapshot.state);
    Trainer::resume(device, &read, c.train.clone(), c.extent, options).unwrap()
}

/// Asserts that a run ends as the `whole` one did, with little room for pairs, and resumed after each of these stops. `start`
/// begins it with room for a number of pairs.
pub(crate) fn same_however(
    whole: &Trainer,
    stops: &[u32],
    start: impl Fn(u32) -> Trainer,
    resume: impl Fn(&Snapshot) -> Trainer,
) {
    let end = |mut trainer: Trainer| {
        train(&mut trainer, whole.iteration());
        (bits(&trainer.download().unwrap()), trainer.cut())
    };
    let right = (bits(&whole.download().unwrap()), whole.cut());
    let mut few = start(64);
    train(&mut few, stops[0]);
    let mut resumed = resume(&few.snapshot().unwrap());
    assert!(end(few) == right, "few pairs");
    for at in &stops[1..] {
        train(&mut resumed, *at);
        resumed = resume(&resumed.snapshot().unwrap());
    }
    assert!(end(resumed) == right, "resumed after {stops:?}");
}

/// Where the memory has no room for a picture's pairs, the state is that before it, and can be kept.
#[test]
fn pairs_beyond_the_memory_leave_a_sound_state() {
    let (c, free) = (capture(), device());
    let few = || Options { pairs: 64, ..options() };
    let wide = |photo: &Photo| Photo::opaque(photo.camera.resized(320, 240), vec![90; 4 * 320 * 240]);
    let photos: Vec<Photo> = c.train.iter().map(wide).collect();
    let mut large = c.start.clone();
    for scale in large.log_scales.iter_mut().flatten() {
        *scale += 2.5;
    }
    let start = |device: &Device| Trainer::new(device, &large, photos.clone(), c.extent, few()).unwrap();
    let mut whole = start(&free);
    train(&mut whole, 3);
    // Something else takes the memory once the photos are there.
    let limited = opened(|options| options.memory_limit = Some(64 << 20));
    let mut ended = start(&limited);
    let left = (64 << 20) - limited.memory_used().0 as usize;
    let other = limited.buffer::<u32>("other", (left - (256 << 10)) / 4).unwrap();
    let failed = ended.run_until(3, |_, _| ControlFlow::Continue(()));
    assert!(matches!(&failed, Err(Error::Device(error)) if error.is_resources()), "{failed:?} {left} {}", ended.len());
    assert!(ended.is_whole());
    drop(other);
    let kept = ended.snapshot().unwrap();
    let mut resumed = Trainer::resume(&free, &kept, photos.clone(), c.extent, few()).unwrap();
    train(&mut resumed, 3);
    assert!(bits(&resumed.download().unwrap()) == bits(&whole.download().unwrap()));
    drop(ended);
    finish(&limited);
    finish(&free);
}

/// Trains to `until`; every call must make progress, if only by growing a buffer.
pub(crate) fn train(trainer: &mut Trainer, until: u32) -> Vec<Progress> {
    let mut seen = Vec::new();
    let follow = |trainer: &Trainer, progress| {
        seen.push(progress);
        assert!(seen.len() < 500, "at {} after 500 stretches", trainer.iteration());
        ControlFlow::Continue(())
    };
    trainer.run_until(until, follow).unwrap();
    seen
}

fn run(device: &Device, options: Options) -> Gaussians {
    let mut trainer = trainer(device, options);
    train(&mut trainer, ITERATIONS);
    trainer.download().unwrap()
}

pub(crate) fn bits(model: &Gaussians) -> Vec<u32> {
    let main = [model.means.as_flattened(), model.log_scales.as_flattened(), model.rotations.as_flattened()];
    let all = main.into_iter().chain([&model.opacity_logits[..]]).chain(model.sh.iter().map(Vec::as_slice));
    all.flatten().map(|v| v.to_bits()).collect()
}

/// Mean PSNR over views.
fn psnr(device: &Device, trainer: &Trainer, views: &[Photo]) -> f64 {
    let mut evaluator = Evaluator::new(device, Settings::default(), trainer.len(), views.iter()).unwrap();
    let each = evaluator.psnr(trainer.model(), views.iter()).unwrap();
    each.iter().sum::<f64>() / views.len() as f64
}

#[test]
fn the_same_bytes_however_it_is_run() {
    let (device, again) = (device(), repeats());
    let whole = run(&device, options());
    assert!(whole.len() != capture().start.len(), "density control acted");
    assert!(whole.means.as_flattened().iter().all(|v| v.is_finite()));
    let right = bits(&whole);
    // Room for 64 pairs where thousands are needed.
    assert!(right == bits(&run(&device, Options { pairs: 64, ..options() })), "a tiny pair buffer");
    assert!(right == bits(&run(&again, Options { pairs: 1500, ..options() })), "a pair buffer that is soon too small");

    // Unplanned stops, and calls with nothing left to do, above all at density steps.
    let mut halting = trainer(&again, options());
    for until in [1, 7, 20, 20, 40, 41, 50, 50, 80, 30, 109, 110, 110] {
        train(&mut halting, until);
        let before = halting.iteration();
        assert_eq!(halting.advance(until).unwrap().iteration, before);
    }
    assert!(right == bits(&halting.download().unwrap()), "a run in pieces");

    let [own, another] = [options().seed, 6].map(|seed| {
        let mut begun = trainer(&again, Options { seed, ..options() });
        train(&mut begun, 8);
        bits(&begun.download().unwrap())
    });
    assert!(own != another, "another seed");
    finish(&device);
}

#[test]
fn training_learns() {
    const LONG: u32 = 280;
    let device = device();
    let c = capture();
    let schedule = Schedule { iterations: LONG, densify_until: 0.4, opacity_reset_every: 3000, ..options().schedule };
    let mut trainer = trainer(&device, Options { schedule, ..options() });
    let before = [psnr(&device, &trainer, &c.train), psnr(&device, &trainer, &c.test)];
    let (mut losses, mut degrees) = (Vec::new(), Vec::new());
    for iteration in 1..=LONG {
        let progress = train(&mut trainer, iteration).pop().unwrap();
        assert!(progress.loss.is_finite() && progress.loss > 0.0, "{progress:?}");
        assert_eq!((progress.iteration, progress.gaussians), (iteration, trainer.len()));
        losses.push(f64::from(progress.loss));
        degrees.push(trainer.model().degree);
    }
    // 0.3 of 280 iterations: degree 1 from the 84th, 2 from the 168th, and no higher than asked.
    assert_eq!([82, 83, 166, 167, 279].map(|i: usize| degrees[i]), [0, 1, 1, 2, 2]);
    let round = |losses: &[f64]| losses.iter().sum::<f64>() / 7.0; // each of the seven views once
    let (first, last) = (round(&losses[..7]), round(&losses[273..]));
    let after = [psnr(&device, &trainer, &c.train), psnr(&device, &trainer, &c.test)];
    let line = format!("loss {first:.4} -> {last:.4}, PSNR (train, test) {before:.2?} -> {after:.2?}");
    println!("{line}; {} -> {} Gaussians", c.start.len(), trainer.len());
    assert_eq!(trainer.skipped_rows(), 0);
    assert!(last < 0.7 * first, "{line}");
    assert!(after[0] > before[0] + 3.0 && after[1] > before[1] + 2.0, "{line}");
    finish(&device);
}

/// Many views of few pixels: photos beyond a quarter of the memory allowed are sent one at a time, from the host's
/// memory or from a file; some of another size come between.
#[test]
fn streamed_photos_give_the_same_bytes() {
    let c = capture();
    let mut held: Vec<Photo> = c.train.iter().cycle().take(1400).cloned().collect();
    for view in held.iter_mut().step_by(3) {
        view.camera = view.camera.resized(40, 30);
        view.pixels = (0..40 * 30 * 4).map(|k| (k * 7) as u8).collect();
    }
    let folder = tempfile::tempdir().unwrap();
    let file = PhotoFile::new(folder.path()).unwrap();
    let mut start = 0;
    let mut filed = held.clone();
    for view in &mut filed {
        let pixels = file.put(start, &view.pixels.read().unwrap()).unwrap();
        start += pixels.len() as u64;
        view.pixels = pixels;
    }
    let mut results = Vec::new();
    for memory_limit in [None, Some(48 << 20)] {
        let device = opened(|options| options.memory_limit = memory_limit);
        for views in [&held, &filed] {
            let streamed = matches!(DevicePhotos::new(&device, views).unwrap(), DevicePhotos::Streamed(_));
            assert_eq!(streamed, memory_limit.is_some());
            let options = Options { pairs: 1 << 13, ..options() };
            let mut trainer = Trainer::new(&device, &c.start, views.clone(), c.extent, options).unwrap();
            train(&mut trainer, 30);
            results.push(bits(&trainer.download().unwrap()));
        }
        finish(&device);
    }
    assert!(results.iter().all(|r| *r == results[0]));
    let [a, b] = [&held, &filed].map(|views| random(views, 500, false, 1).unwrap());
    assert!(a == b, "random points");
}

/// Streamed photos travel in the submission of the iteration that needs them: nothing waits for them.
#[test]
fn streamed_photos_cost_no_submission_and_no_wait() {
    let device = opened(|options| options.memory_limit = Some(48 << 20));
    let c = capture();
    let views: Vec<Photo> = c.train.iter().cycle().take(1400).cloned().collect();
    assert!(matches!(DevicePhotos::new(&device, &views).unwrap(), DevicePhotos::Streamed(_)));
    let mut trainer = Trainer::new(&device, &c.start, views, c.extent, options()).unwrap();
    let before = device.traffic();
    assert_eq!(trainer.advance(16).unwrap().iteration, 16);
    let after = device.traffic();
    assert_eq!((after.submissions - before.submissions, after.round_trips - before.round_trips), (16, 0));
}

/// Reading ahead is a guess: with other views, repeats and reversals, the requested photo is still returned.
#[test]
fn reading_ahead_changes_nothing() {
    let device = opened(|options| options.memory_limit = Some(100_000));
    let views = &capture().train;
    let mut photos = DevicePhotos::new(&device, views).unwrap();
    assert!(matches!(photos, DevicePhotos::Streamed(_)));
    for (at, next) in [(0, 1), (1, 1), (1, 2), (3, 0), (0, 6), (6, 6), (2, 0)] {
        let mut recording = Recording::new();
        let room = photos.get(&mut recording, views, at, next).unwrap().clone();
        device.run(recording).unwrap();
        let words = room.read(&device).unwrap();
        assert!(bytemuck::cast_slice::<u32, u8>(&words) == &*views[at].pixels.read().unwrap(), "{at}");
    }
}

#[test]
fn without_photos_there_is_no_trainer() {
    let device = device();
    let c = capture();
    let made = Trainer::new(&device, &c.start, Vec::new(), c.extent, options());
    assert!(matches!(made, Err(Error::NoViews)));
    finish(&device);
}

/// A run ends even if there is nothing to train, from the start or because everything was pruned.
#[test]
fn an_empty_model_ends() {
    let device = device();
    let c = capture();
    let nothing = Gaussians { sh: vec![Vec::new()], ..Gaussians::default() };
    let mut trainer = Trainer::new(&device, &nothing, c.train.clone(), c.extent, options()).unwrap();
    train(&mut trainer, 60);
    assert!(trainer.is_empty() && trainer.download().unwrap().is_empty());
    finish(&device);
}

/// Photos of two sizes, one upright, share the buffers of the larger.
#[test]
fn photos_of_several_sizes() {
    let device = device();
    let c = capture();
    let mut views = c.train.clone();
    for view in views.iter_mut().step_by(2) {
        let (width, height) = (20, 33);
        view.camera = view.camera.resized(width, height);
        view.pixels = vec![128; (width * height * 4) as usize].into();
    }
    let run = |device: &Device, pairs: u32| {
        let mut trainer =
            Trainer::new(device, &c.start, views.clone(), c.extent, Options { pairs, ..options() }).unwrap();
        let progress = train(&mut trainer, 60).pop().unwrap();
        assert!(progress.loss.is_finite());
        bits(&trainer.download().unwrap())
    };
    assert!(run(&device, 1 << 16) == run(&repeats(), 64));
    finish(&device);
}
