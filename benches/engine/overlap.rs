//! `overlap` and `rrdm`: a batch's matrices, in pairs per second; `participation`: the device's solver; `responses`:
//! time that gathering responses adds to an iteration.

use super::{bounds, device, group, row, scenes, time_of};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Error, Recording};
use qirf_vk::qirf::assemble::{Assembly, Options};
use qirf_vk::qirf::overlap::{Method, Metric};
use qirf_vk::qirf::participation::device::Problem;
use qirf_vk::qirf::plan::triangle;
use qirf_vk::qirf::rrdm::Density;
use qirf_vk::render::{BACKWARD_STAGES, Backward, STAGES, Settings, TrainingRenderer};
use qirf_vk::response::{Gather, HighPass, ResidentResponses, ResidentScores};
use std::time::Instant;

const GAUSSIANS: usize = 24_576;

/// Blocks of 48 members, the default partition's average, and of 512, its largest.
pub fn overlap(criterion: &mut Criterion) {
    let resident = Resident::upload(device(), &scenes::crowd(GAUSSIANS, 0, 1.0, 5)).unwrap();
    let members: Vec<u32> = (0..GAUSSIANS as u32).collect();
    let h = vec![[1.0; 8]; GAUSSIANS];
    let methods = [("qr", Method::Qr), ("determinant", Method::Determinant)];
    for stage in ["overlap", "rrdm"] {
        let mut group = group(criterion, stage);
        for m in [48_usize, 512] {
            let starts: Vec<u32> = (0..=GAUSSIANS as u32).step_by(m).collect();
            for (name, method) in methods.into_iter().filter(|(name, _)| stage == "overlap" || *name == "qr") {
                let density = (stage == "rrdm").then(|| Density { full: true, ..Density::default() });
                let options = Options { metric: Metric { method, ..Metric::default() }, density, ..Options::default() };
                let assembly = Assembly::new(device(), &resident, &members, &starts, &h, options).unwrap();
                let run = || {
                    let batch = &assembly.batches()[0];
                    let mut readback = assembly.readback().unwrap();
                    let start = Instant::now();
                    assembly.submit(batch, &mut readback).unwrap();
                    let (_, timings) = readback.wait().unwrap();
                    time_of(&timings, stage, start)
                };
                let blocks = assembly.batches()[0].blocks.len();
                let pairs = blocks * (triangle(m) - m);
                let bound = match stage {
                    "overlap" => bounds::overlap(name, blocks as f64, m as f64),
                    _ => bounds::rrdm(blocks as f64, m as f64),
                };
                bound.note(stage, &[name, &m.to_string()], &[("pairs", pairs as f64), ("members", m as f64)]);
                group.throughput(Throughput::Elements(pairs as u64));
                row(&mut group, BenchmarkId::new(name, m), run);
            }
        }
        group.finish();
    }
}

/// The eigenproblems of 3,072 Gaussians, in blocks per second.
pub fn participation(criterion: &mut Criterion) {
    const FEW: usize = 3072;
    let resident = Resident::upload(device(), &scenes::crowd(FEW, 0, 1.0, 5)).unwrap();
    let members: Vec<u32> = (0..FEW as u32).collect();
    let mut group = group(criterion, "participation");
    for m in [48_usize, 128, 512] {
        let starts: Vec<u32> = (0..=FEW as u32).step_by(m).collect();
        let options = Options { density: Some(Density::default()), ..Options::default() };
        let assembly = Assembly::new(device(), &resident, &members, &starts, &vec![[1.0; 8]; FEW], options).unwrap();
        let run = || {
            let start = Instant::now();
            let timings = assembly.solve_each::<Error>(Problem::default(), |_, _| Ok(())).unwrap();
            time_of(&timings, "participation", start)
        };
        group.throughput(Throughput::Elements((FEW / m) as u64));
        let blocks = (FEW / m) as f64;
        bounds::participation(blocks, m as f64).note("participation", &[&m.to_string()], &[("blocks", blocks)]);
        row(&mut group, BenchmarkId::from_parameter(m), run);
    }
    group.finish();
}

/// Device time of one view's passes, 20 k Gaussians at 320 x 240: forward, backward, responses, high pass and scores.
pub fn responses(criterion: &mut Criterion) {
    let device = device();
    let model = scenes::crowd(20_000, 3, 1.0, 6);
    let camera = scenes::camera(320, 240, 0.0);
    let resident = Resident::upload(device, &model).unwrap();
    let mut renderer = TrainingRenderer::new(device, Settings::default(), model.len(), [320, 240], 1 << 20).unwrap();
    renderer.make_room(&resident, &camera).unwrap();
    renderer.make_room_for_responses().unwrap();
    let gradient = device.buffer("image gradient", 320 * 240).unwrap();
    let (responses, scores) =
        (ResidentResponses::zeros(device, model.len()).unwrap(), ResidentScores::zeros(device, model.len()).unwrap());
    let high_pass = HighPass::new(device, 320 * 240).unwrap();
    let backward = Backward { residual: true, ..Backward::default() };
    let run = || {
        let mut recording = Recording::new();
        renderer.reset_overflow(&mut recording);
        renderer.record(&mut recording, &resident, &camera);
        high_pass.record(&mut recording, renderer.image(), &gradient, [320, 240]);
        renderer.record_backward(&mut recording, &resident, &camera, &gradient, backward);
        responses.record(&mut recording, &renderer, &resident, &camera, Gather::Mean { views: 1 });
        scores.record(&mut recording, &renderer, &resident, &camera, None);
        device.run(recording).unwrap()
    };
    let mut group = group(criterion, "responses");
    let stages = STAGES.into_iter().chain(BACKWARD_STAGES).chain(["high pass", "respond", "score"]);
    for stage in stages {
        row(&mut group, BenchmarkId::from_parameter(stage), || {
            let start = Instant::now();
            time_of(&run(), stage, start)
        });
    }
    group.finish();
}
