//! Density control against its twin.

use crate::support::{Random, device, finish};
use glam::{DQuat, DVec3};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::{Buffer, Device, Recording};
use qirf_vk::reference::densify::{Kind, Thresholds};
use qirf_vk::reference::{self, Params};
use qirf_vk::train::TrainingModel;
use qirf_vk::train::density::{Step, compact, densify, reset_opacity, thin};
use qirf_vk::train::growth::Growth;
use qirf_vk::train::schedule::Schedule;

const EXTENT: f64 = 3.0;
pub(crate) const STEP: Step = Step { iteration: 600, seed: 7, extent: EXTENT, cameras: [0.0; 3], most: 1_000_000 };

/// Model and growth, SH degree 1: some Gaussians are faint, some large, some not finite; half of them grow.
pub(crate) fn scene(count: usize, seed: u64) -> (Gaussians, Vec<[f32; 2]>) {
    let mut r = Random(seed);
    let mut model = Gaussians { sh: vec![Vec::new(), Vec::new()], ..Gaussians::default() };
    let mut growth = Vec::new();
    for i in 0..count {
        model.means.push([0; 3].map(|_| r.within(-5.0, 5.0) as f32));
        let size = match i % 10 {
            0..3 => 0.02, // to be cloned
            9 => 0.8,     // beyond 0.1 of the reach, mostly
            _ => 0.1,
        };
        model.log_scales.push([0; 3].map(|_| (size * r.within(0.2, 1.0)).ln() as f32));
        model.rotations.push([0; 4].map(|_| r.within(-2.0, 2.0) as f32));
        model.opacity_logits.push(if i % 7 == 3 { -6.0 } else { r.within(-4.0, 4.0) as f32 });
        model.sh[0].extend([0; 3].map(|_| r.within(-1.0, 1.0) as f32));
        model.sh[1].extend([0; 9].map(|_| r.within(-1.0, 1.0) as f32));
        let views = (i % 4) as f32;
        growth.push([views * r.within(0.0, 4e-4) as f32, views]);
        match i % 31 {
            5 => model.means[i][1] = f32::NAN,
            6 => model.log_scales[i][2] = f32::INFINITY,
            7 => model.rotations[i][0] = f32::NAN,
            8 => model.opacity_logits[i] = f32::NAN,
            _ => {}
        }
    }
    (model, growth)
}

/// A model in training, with moments that are all different and not zero.
pub(crate) fn held(device: &Device, model: &Gaussians, growth: &[[f32; 2]]) -> TrainingModel {
    held_with_tail(device, model, growth, 0)
}

fn held_with_tail(device: &Device, model: &Gaussians, growth: &[[f32; 2]], tail: usize) -> TrainingModel {
    let training = TrainingModel::with_tail(device, model, tail).unwrap();
    for (a, buffer) in attributes(&training).into_iter().enumerate() {
        let values: Vec<[f32; 2]> = (0..buffer.len()).map(|k| [(a + 1) as f32, 1.0 + k as f32]).collect();
        buffer.write(device, &values).unwrap();
    }
    training.growth.write(device, growth).unwrap();
    training
}

fn attributes(training: &TrainingModel) -> Vec<&Buffer<[f32; 2]>> {
    training.moments.each_ref().up_to(1).collect()
}

/// Attributes row by row, as bits: NaN equals itself.
pub(crate) fn rows(model: &Gaussians, i: usize) -> Vec<u32> {
    let band = |l: usize, w: usize| model.sh[l][i * w..(i + 1) * w].to_vec();
    let all = [&model.means[i][..], &model.log_scales[i], &model.rotations[i], &[model.opacity_logits[i]]].concat();
    [all, band(0, 3), band(1, 9)].concat().into_iter().map(f32::to_bits).collect()
}

/// Source and kind of each row of the twin's new model.
fn decide(model: &Gaussians, growth: &[[f32; 2]], schedule: &Schedule, large_goes: bool) -> Vec<(usize, Kind)> {
    let thresholds = Thresholds {
        gradient: schedule.densify_gradient,
        clone_scale: schedule.clone_scale,
        opacity: schedule.prune_opacity,
        scale: large_goes.then_some(schedule.prune_scale),
        extent: EXTENT,
        cameras: DVec3::ZERO,
    };
    let growth: Vec<[f64; 2]> = growth.iter().map(|g| g.map(f64::from)).collect();
    reference::densify::densify(&Params::from(model), &growth, &thresholds)
}

#[test]
fn densify_decides_as_its_twin_and_gathers_rows() {
    decisions(&device());
}

pub fn decisions(device: &Device) {
    // Large Gaussians are pruned at iteration 600 of a run of 2,000, but not yet at iteration 600 of 30,000.
    for (iterations, large_goes) in [(30_000, false), (2000, true)] {
        for count in [1, 31, 700] {
            let schedule = Schedule { iterations, ..Schedule::default() };
            let (model, growth) = scene(count, 11);
            let mut held = held(device, &model, &growth);
            let after = densify(device, &mut held, &schedule, STEP).unwrap();
            let plan = decide(&model, &growth, &schedule, large_goes);
            assert_eq!(after, plan.len(), "{count} Gaussians, {iterations} iterations");
            let new = held.model.download(device).unwrap();
            assert_eq!((held.model.len, new.len()), (after, after));
            assert_eq!(held.growth.read(device).unwrap(), vec![[0.0; 2]; after]);
            let moments: Vec<Vec<[f32; 2]>> = attributes(&held).into_iter().map(|b| b.read(device).unwrap()).collect();
            let mut kinds = [0; 3];
            for (row, &(source, kind)) in plan.iter().enumerate() {
                kinds[kind as usize] += 1;
                let (got, parent) = (rows(&new, row), rows(&model, source));
                if kind == Kind::Half {
                    assert_eq!(got[6..], parent[6..], "row {row}: all but mean and scale are the parent's");
                    assert_ne!(got[..3], parent[..3], "row {row}: the mean is another");
                    for c in 0..3 {
                        let shrunk = f64::from(model.log_scales[source][c]) - 1.6_f64.ln();
                        assert!((f64::from(new.log_scales[row][c]) - shrunk).abs() < 1e-6, "row {row}");
                    }
                } else {
                    assert_eq!(got, parent, "row {row}, {kind:?}");
                }
                for (a, moments) in moments.iter().enumerate() {
                    let width = moments.len() / after;
                    for c in 0..width {
                        let kept = [(a + 1) as f32, 1.0 + (source * width + c) as f32];
                        let right = if kind == Kind::Kept { kept } else { [0.0; 2] };
                        assert_eq!(moments[row * width + c], right, "row {row}, attribute {a}");
                    }
                }
            }
            println!("{count} Gaussians: {} kept, {} cloned, {} halves", kinds[0], kinds[1], kinds[2]);
            assert!(count < 700 || kinds.iter().all(|k| *k > 20), "{kinds:?}");
        }
    }
    finish(device);
}

/// Halves are samples of their parent: along its axes, divided by its scales, they are standard normal.
#[test]
fn split_halves_are_samples_of_their_parent() {
    let device = device();
    let mut r = Random(3);
    let count = 3000;
    let model = Gaussians {
        means: (0..count).map(|_| [0; 3].map(|_| r.within(-1.0, 1.0) as f32)).collect(),
        log_scales: vec![[-0.5, -2.0, -3.5]; count],
        rotations: (0..count).map(|_| [0; 4].map(|_| r.within(-2.0, 2.0) as f32)).collect(),
        opacity_logits: vec![1.0; count],
        sh: vec![vec![0.0; 3 * count], vec![0.0; 9 * count]],
    };
    let growth = vec![[1.0, 1.0]; count];
    let run = |step: Step| {
        let mut held = held(&device, &model, &growth);
        assert_eq!(densify(&device, &mut held, &Schedule::default(), step).unwrap(), 2 * count);
        held.model.download(&device).unwrap()
    };
    let first = run(STEP);
    assert_eq!(first, run(STEP), "one seed, one result");
    assert_ne!(first.means, run(Step { seed: 8, ..STEP }).means, "another seed, another result");
    assert_ne!(first.means, run(Step { iteration: 700, ..STEP }).means, "another iteration, another result");

    // Vulkan allows sines and cosines an error of 2^-11; a radius is at most sqrt(-2 ln 2^-24) deviations.
    let params = Params::from(&model);
    let apart = |row: usize| {
        let offset = reference::densify::offset_of_half(&params, row / 2, row as u32, STEP.seed, STEP.iteration);
        let right = DVec3::from(params.means[row / 2]) + offset;
        (DVec3::from(first.means[row].map(f64::from)) - right).length() / params.log_scales[row / 2][0].exp()
    };
    let worst = (0..2 * count).map(apart).fold(0.0, f64::max);
    println!("worst error of a half's place, in largest deviations: {worst:.1e}");
    assert!(worst < 5.8 * 2_f64.powi(-11), "{worst}");

    let normal = |row: usize| {
        let parent = row / 2;
        let [w, x, y, z] = model.rotations[parent].map(f64::from);
        let offset = DVec3::from(first.means[row].map(f64::from)) - DVec3::from(model.means[parent].map(f64::from));
        let local = DQuat::from_xyzw(x, y, z, w).normalize().inverse() * offset;
        local / DVec3::from(model.log_scales[parent].map(f64::from)).exp()
    };
    let samples: Vec<DVec3> = (0..2 * count).map(normal).collect();
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<DVec3>() / n;
    let variance = samples.iter().map(|s| s * s).sum::<DVec3>() / n;
    let mixed = samples.iter().map(|s| s * DVec3::new(s.y, s.z, s.x)).sum::<DVec3>() / n;
    // The two halves of one parent are independent, too.
    let twins = samples.chunks_exact(2).map(|p| p[0] * p[1]).sum::<DVec3>() / (0.5 * n);
    println!("mean {mean}, variance {variance}, covariances {mixed}, between halves {twins}");
    // Five standard errors: 1 / sqrt(6000) is 0.013, the variance's sqrt(2) times that.
    assert!(mean.abs().max_element() < 0.065 && (variance - 1.0).abs().max_element() < 0.1);
    assert!(mixed.abs().max_element() < 0.065 && twins.abs().max_element() < 0.1);
    finish(&device);
}

/// If the limit lets only some Gaussians grow, these are the ones with the largest gradients.
#[test]
fn the_limit_is_kept() {
    let device = device();
    let schedule = Schedule::default();
    let model = Gaussians::balls(vec![[0.5; 3]; 200], -6.0, 0.0, 1);
    let growth: Vec<[f32; 2]> = (0..200_u32).map(|i| [2e-4 * (2.0 + (i * 77 % 200) as f32), 1.0]).collect();
    for most in [1, 200, 201, 250, 399, 400, 1000] {
        let mut held = held(&device, &model, &growth);
        let after = densify(&device, &mut held, &schedule, Step { most, ..STEP }).unwrap();
        assert!((200..=most.max(200)).contains(&after), "{after} of at most {most}");
        assert!(most < 400 || after == 400);
        assert!(most != 250 || after > 220, "{after}: room was left");
        // A clone's moments are zero; its parent is the row before it.
        let moments = held.moments.opacity_logits.read(&device).unwrap();
        let grew: Vec<usize> =
            (1..after).filter(|i| moments[*i] == [0.0; 2]).map(|i| moments[i - 1][1] as usize - 1).collect();
        assert_eq!(grew.len(), after - 200);
        let least = grew.iter().map(|i| growth[*i][0]).fold(f32::INFINITY, f32::min);
        let larger = growth.iter().filter(|g| g[0] >= least).count();
        assert_eq!(larger, grew.len(), "at most {most}: none with a larger gradient stayed behind");
    }
    finish(&device);
}

/// The search for a threshold ends, whatever the gradients are.
#[test]
fn the_limit_is_kept_by_any_gradients() {
    any_gradients(&device());
}

pub fn any_gradients(device: &Device) {
    let model = Gaussians::balls(vec![[0.5; 3]; 64], -6.0, 0.0, 1);
    for gradient in [0.0, -1.0, 2e-4] {
        for sum in [0.0, 1e-30, 1.0, 1e30, f32::INFINITY, f32::NAN] {
            if gradient < 0.0 && sum > 1.0 {
                continue; // from the second of hundreds of rounds on as with 0
            }
            let schedule = Schedule { densify_gradient: gradient, ..Schedule::default() };
            let mut held = held(device, &model, &vec![[sum, 2.0]; 64]);
            let after = densify(device, &mut held, &schedule, Step { most: 100, ..STEP }).unwrap();
            assert!((64..=100).contains(&after), "gradient {gradient}, sums {sum}: {after}");
        }
    }
    finish(device);
}

#[test]
fn all_may_go() {
    let device = device();
    let (mut model, growth) = scene(40, 5);
    model.opacity_logits.fill(-9.0);
    let mut held = held(&device, &model, &growth);
    assert_eq!(densify(&device, &mut held, &Schedule::default(), STEP).unwrap(), 0);
    assert!(held.model.download(&device).unwrap().is_empty());
    assert_eq!(densify(&device, &mut held, &Schedule::default(), STEP).unwrap(), 0);
    finish(&device);
}

#[test]
fn reset_opacity_keeps_no_more_than_the_limit() {
    let device = device();
    let (mut model, growth) = scene(100, 2);
    model.opacity_logits.iter_mut().for_each(|l| *l = if l.is_finite() { *l } else { 0.0 });
    let held = held(&device, &model, &growth);
    let before: Vec<Vec<[f32; 2]>> = attributes(&held).into_iter().map(|b| b.read(&device).unwrap()).collect();
    let mut recording = Recording::new();
    reset_opacity(&mut recording, &held, 0.01);
    device.run(recording).unwrap();
    let after = held.model.download(&device).unwrap();
    let limit = (0.01_f64 / 0.99).ln() as f32;
    for i in 0..100 {
        assert_eq!(after.opacity_logits[i], model.opacity_logits[i].min(limit));
        let (mut got, mut right) = (rows(&after, i), rows(&model, i));
        (got[10], right[10]) = (0, 0);
        assert_eq!(got, right, "all else stays");
    }
    assert!(model.opacity_logits.iter().any(|l| *l < limit) && model.opacity_logits.iter().any(|l| *l > limit));
    for (a, (buffer, before)) in attributes(&held).into_iter().zip(before).enumerate() {
        let now = buffer.read(&device).unwrap();
        assert!(if a == 3 { now.iter().all(|m| *m == [0.0; 2]) } else { now == before }, "attribute {a}");
    }
    finish(&device);
}

/// Parameters, moments, growth and count, as bits.
fn contents(device: &Device, training: &TrainingModel) -> Vec<Vec<u32>> {
    let model = training.model.download(device).unwrap();
    let words =
        |buffer: &Buffer<[f32; 2]>| buffer.read(device).unwrap().concat().into_iter().map(f32::to_bits).collect();
    let mut all: Vec<Vec<u32>> = attributes(training).into_iter().map(words).collect();
    all.extend([words(&training.growth), training.model.count.value.read(device).unwrap()[..1].to_vec()]);
    all.extend((0..model.len()).map(|i| rows(&model, i)));
    all
}

/// Thinning keeps what compaction keeps, in the memory that the arrays have: it makes four buffers (sources, kinds, the
/// transfer's and the gathered rows') and waits once, where compaction makes a buffer for each array.
#[test]
fn thinning_is_compaction_in_place() {
    let device = device();
    let (model, growth) = scene(500, 3);
    for tail in [0, 40] {
        let [mut new, mut old] = [(); 2].map(|()| held_with_tail(&device, &model, &growth, tail));
        for kept in [(0..460).step_by(3).collect(), vec![0, 2, 3, 150], vec![2], Vec::<u32>::new()] {
            compact(&device, &mut new, &kept).unwrap();
            let (used, before) = (device.memory_used().0, device.traffic());
            thin(&device, &mut old, &kept).unwrap();
            let after = device.traffic();
            assert_eq!(device.memory_used().0, used, "no memory more or less");
            let asked = [after.buffers - before.buffers, after.submissions - before.submissions];
            assert_eq!((asked, after.round_trips - before.round_trips), ([4, 1], 1));
            assert_eq!(old.model.len, kept.len() + tail);
            assert!(contents(&device, &old) == contents(&device, &new), "{} of a tail of {tail}", kept.len());
        }
    }
    finish(&device);
}

/// Growth to a plan makes the arrays once, at the planned size. A step is two submissions: what the host must know, and all
/// else. The first one has a third, after which the old arrays make room for the last new one.
#[test]
fn a_plan_has_its_memory_from_the_first_step() {
    let device = device();
    let (model, growth) = scene(300, 11);
    let plan = Growth { gaussians: Some(2000), ..Growth::default() };
    let schedule = Schedule { iterations: 2000, growth: Some(plan), ..Schedule::default() };
    let mut held = held(&device, &model, &growth);
    let mut used = 0;
    let mut numbers = vec![held.model.len];
    for iteration in [100, 300, 500, 700] {
        let before = device.traffic();
        numbers.push(densify(&device, &mut held, &schedule, Step { iteration, ..STEP }).unwrap());
        let (now, after) = (device.memory_used().0, device.traffic());
        let asked = [after.submissions - before.submissions, after.round_trips - before.round_trips];
        assert_eq!(asked, if used == 0 { [3, 2] } else { [2, 1] }, "{numbers:?}");
        assert!(used == 0 || now == used, "{numbers:?}: {used} bytes, then {now}");
        used = now;
        let n = held.model.len;
        assert_eq!(held.model.download(&device).unwrap().len(), n);
        held.growth.write(&device, &vec![[1.0, 2.0]; n]).unwrap();
    }
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    finish(&device);
}
