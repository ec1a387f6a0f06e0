//! Exposure: the kernel against its twin, its cost when it is off, and runs with it.

use crate::device::train::runs::train;
use crate::support::runs::config;
use crate::support::{device, finish};
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::job::{RunConfig, Silent};
use qirf_vk::pipeline::prepare;
use qirf_vk::reference::exposure as twin;
use qirf_vk::scene::{AlphaRole, PhotoMemory};
use qirf_vk::synth::{self, SynthOptions, write};
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::exposure::{Exposure, PULL, Rendered, SIZE, Step};
use qirf_vk::train::initialise::{Seed, from_points};
use qirf_vk::train::mask::Mask;
use qirf_vk::train::{Exposures, Options, Trainer};
use std::path::Path;
use tempfile::TempDir;

fn value(n: usize, seed: usize) -> f64 {
    ((n * 2654435761 + seed * 40503) % 1009) as f64 / 1009.0
}

/// Exposed picture, gradient by the picture and the step of the affine map, against float64.
#[test]
fn the_kernel_is_its_twin() {
    kernel_and_twin(&device());
}

pub fn kernel_and_twin(device: &Device) {
    for (pixels, photos, photo) in [(1, 1, 0), (777, 3, 1), (40_000, 2, 1)] {
        let picture: Vec<[f32; 4]> = (0..pixels).map(|p| [0, 1, 2, 3].map(|c| value(4 * p + c, 1) as f32)).collect();
        let slope: Vec<[f32; 4]> =
            (0..pixels).map(|p| [0, 1, 2, 3].map(|c| (value(4 * p + c, 2) - 0.45) as f32 / pixels as f32)).collect();
        let affine: Vec<f32> =
            (0..photos * SIZE).map(|k| (twin::IDENTITY[k % SIZE] + 0.3 * (value(k, 3) - 0.5)) as f32).collect();
        let gains: Vec<[f32; 3]> =
            (0..photos).map(|k| [0, 1, 2].map(|c| 0.8 + 0.4 * value(3 * k + c, 5) as f32)).collect();
        let exposure = Exposure::with(device, &gains, &affine, &vec![0.0; 2 * affine.len()], pixels).unwrap();
        let (image, gradient) = (device.upload("image", &picture).unwrap(), device.upload("slope", &slope).unwrap());
        let pairs = device.upload("pairs", &[0, 5]).unwrap();
        let step = |limit| Some(Step { pairs: &pairs, limit, number: 1, rate: 0.01 });
        let mut recording = Recording::new();
        let rendered = Rendered { photo, image: &image, pixels: pixels as u32 };
        exposure.apply(&mut recording, rendered);
        exposure.backward(&mut recording, rendered, &gradient, step(5));
        assert_eq!(recording.kernels(), ["train/exposure"; 3]);
        device.run(recording).unwrap();

        let rgb = |v: &[[f32; 4]]| v.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect::<Vec<_>>();
        let own: [f64; SIZE] = std::array::from_fn(|k| f64::from(affine[photo * SIZE + k]));
        let right = twin::apply(&own, &rgb(&picture));
        let (by_colour, by_affine) = twin::backward(&own, &rgb(&picture), &rgb(&slope));
        let exposed = exposure.image.read(device).unwrap();
        let through = gradient.read(device).unwrap();
        for p in 0..pixels {
            assert_eq!((exposed[p][3], through[p][3]), (picture[p][3], slope[p][3]), "alpha's own");
            for c in 0..3 {
                assert!((f64::from(exposed[p][c]) - right[p][c]).abs() < 1e-5, "{p} {c}");
                assert!((f64::from(through[p][c]) - by_colour[p][c]).abs() < 1e-5 / pixels as f64, "{p} {c}");
            }
        }
        let moments = exposure.moments.read(device).unwrap();
        let after = exposure.affine.read(device).unwrap();
        let scale = by_affine.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        for k in 0..photos * SIZE {
            let mine = k / SIZE == photo;
            let slope = if mine { by_affine[k % SIZE] } else { 0.0 };
            assert!((10.0 * f64::from(moments[k][0]) - slope).abs() < 1e-5 * scale, "{k}: {} {slope}", moments[k][0]);
            // The first step of Adam is the rate times minus the gradient's sign; the pull is towards the photo's own
            // gains.
            let moved = f64::from(after[k]) - f64::from(affine[k]);
            let gain = if (k % SIZE).is_multiple_of(5) { gains[k / SIZE][k % SIZE / 5] } else { 0.0 };
            let pulled = f64::from(PULL) * f64::from(affine[k] - gain);
            let right = if mine { -0.01 * (slope.signum() + pulled) } else { 0.0 };
            assert!((moved - right).abs() < 1e-5, "{k}: {moved} {slope}");
        }
        // An iteration whose pairs did not fit changes nothing, and neither does a NaN gradient.
        for (limit, slope) in [(4, 1.0), (5, f32::NAN)] {
            let slope = device.upload("slope", &vec![[slope; 4]; pixels]).unwrap();
            let mut recording = Recording::new();
            exposure.backward(&mut recording, rendered, &slope, step(limit));
            device.run(recording).unwrap();
            assert!(exposure.affine.read(device).unwrap() == after);
            assert!(exposure.moments.read(device).unwrap() == moments);
        }
    }
    finish(device);
}

/// Nine photos, two of them held out.
fn capture(effect: synth::Effect) -> TempDir {
    let (folder, effects) = (tempfile::tempdir().unwrap(), vec![effect]);
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 270, effects, ..Default::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    folder
}

fn trainer(device: &Device, scene: &Path, exposure: bool, masked: bool) -> Trainer {
    let config = config(scene, 60);
    let mut prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
    let alpha_role = if masked { AlphaRole::Mask } else { AlphaRole::Opaque };
    prepared.train.iter_mut().for_each(|photo| photo.alpha_role = alpha_role);
    let seeds: Vec<Seed> = prepared.scene.points.iter().map(Seed::from).collect();
    let options = options(&config, exposure);
    Trainer::new(device, &from_points(&seeds), prepared.train, prepared.extent, options).unwrap()
}

fn options(config: &RunConfig, exposure: bool) -> Options {
    let exposure = exposure.then(|| Exposures::Learnt(Vec::new()));
    let schedule = config.schedule.clone();
    Options { schedule, degree: 1, most: 3000, exposure, pairs: 1 << 14, ..Options::default() }
}

/// Disabled exposures and masks have no kernel and no buffer.
#[test]
fn off_is_free() {
    let device = device();
    let folder = capture(synth::Effect::Masks);
    let mut taken = Vec::new();
    for (exposure, masked) in [(false, false), (true, false), (false, true)] {
        let before = device.memory_used().0;
        let mut trainer = trainer(&device, folder.path(), exposure, masked);
        taken.push(device.memory_used().0 - before);
        let kernels = trainer.recording().unwrap().kernels();
        assert_eq!(kernels.contains(&"train/exposure"), exposure, "{kernels:?}");
        assert_eq!(kernels.contains(&"train/mask"), masked, "{kernels:?}");
        train(&mut trainer, 3);
        let scopes: Vec<_> = trainer.timings().iter().map(|(name, ..)| name).collect();
        assert_eq!((scopes.contains(&"exposure"), scopes.contains(&"masks")), (exposure, masked), "{scopes:?}");
    }
    let (photos, pixels) = (7, 48 * 36);
    assert_eq!(taken[1] - taken[0], device.bytes_of(|counts| Exposure::new(counts, &[], photos, pixels)));
    assert_eq!(taken[2] - taken[0], device.bytes_of(|counts| Mask::new(counts, pixels, [0.0; 3])));
    finish(&device);
}

/// A run with exposures that is resumed from a file ends with the same bytes.
#[test]
fn exposures_are_kept_in_checkpoints() {
    let device = device();
    let folder = capture(synth::Effect::Exposure);
    let mut whole = trainer(&device, folder.path(), true, false);
    train(&mut whole, 42); // six rounds of the seven photos
    let mut broken = trainer(&device, folder.path(), true, false);
    train(&mut broken, 23);
    let file = folder.path().join("checkpoint");
    broken.snapshot().unwrap().write(&file).unwrap();
    let config = config(folder.path(), 60);
    let prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
    let snapshot = Snapshot::read(&file).unwrap();
    assert_eq!(snapshot.exposures.0.len(), 7 * SIZE);
    let mut resumed =
        Trainer::resume(&device, &snapshot, prepared.train, prepared.extent, options(&config, true)).unwrap();
    train(&mut resumed, 42);
    let [a, b] = [&whole, &resumed].map(|t| t.snapshot().unwrap());
    assert!(a.model == b.model && a.exposures == b.exposures);
    assert!(a.exposures.0.iter().zip(twin::IDENTITY.iter().cycle()).any(|(a, b)| (f64::from(*a) - b).abs() > 0.02));
    // Maps that begin as the identity do not drift together: the model keeps the mean photo's colours.
    for (k, identity) in twin::IDENTITY.iter().enumerate() {
        let mean = a.exposures.0.iter().skip(k).step_by(SIZE).map(|value| f64::from(*value)).sum::<f64>() / 7.0;
        assert!((mean - identity).abs() < 1e-5, "{k}: {mean}");
    }
    finish(&device);
}

/// Known exposures do not change, bit for bit, and the loss sees the model through them: resumed with the maps that a
/// run has learnt, the first picture is as near to its photo as that run's.
#[test]
fn known_exposures_stay() {
    let device = device();
    let folder = capture(synth::Effect::Exposure);
    let mut learning = trainer(&device, folder.path(), true, false);
    train(&mut learning, 40);
    let learnt = learning.snapshot().unwrap();
    let config = config(folder.path(), 60);
    let loss = |exposure: Option<Exposures>, exposures: (Vec<f32>, Vec<f32>)| {
        let prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
        let options = Options { exposure, ..options(&config, false) };
        let state = Snapshot { exposures, ..learnt.clone() };
        let mut trainer = Trainer::resume(&device, &state, prepared.train, prepared.extent, options).unwrap();
        let loss = trainer.advance(41).unwrap().loss;
        train(&mut trainer, 50);
        (loss, trainer.snapshot().unwrap())
    };
    let maps = learnt.exposures.0.clone();
    let (with_known, after) = loss(Some(Exposures::Known(maps.clone())), Default::default());
    assert!(after.exposures.0 == maps && after.model.means != learnt.model.means);
    let (going_on, changed) = loss(Some(Exposures::Learnt(Vec::new())), learnt.exposures.clone());
    assert_eq!(with_known, going_on, "the same maps in the first iteration");
    assert!(changed.exposures.0 != maps);
    let (without, _) = loss(None, Default::default());
    assert!(with_known < without, "{with_known} {without}");
    finish(&device);
}
