//! `participation host`: the host's eigensolvers by members of a block, in blocks per second; `select`: from rankings
//! to a keep mask; `selection`: whole studies of blocks by each solver and by column subset, with the device's and the
//! host's parts separate. The device's solver alone is the group `participation`; `qirf-vk sweep` measures all of them
//! on a scene's own blocks.

use super::{device, facts, group, quick, scenes, scenes::noise, thousands};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::qirf::CHANNELS;
use qirf_vk::qirf::participation::{Eigensolver, Gram, solve};
use qirf_vk::qirf::partition::Partition;
use qirf_vk::qirf::select::budget::{Budget, Keep, choose};
use qirf_vk::qirf::select::{Ranking, Selector};
use qirf_vk::qirf::study::{Basis, Observed, Seconds, Study};
use qirf_vk::response::Responses;
use std::time::{Duration, Instant};

/// A block's normalised overlaps, falling with distance on a line, and random responses.
fn block(m: usize) -> (Gram, Vec<[f64; CHANNELS]>) {
    let overlap: Vec<f32> =
        (0..m * m).map(|k| (-0.5 * ((k / m) as f32 - (k % m) as f32).powi(2) / 4.0).exp()).collect();
    let row = |i: usize| std::array::from_fn(|c| f64::from(noise(7, (i * CHANNELS + c) as u64)) / 4e9);
    (Gram::new(m, &overlap, None, 1e-4), (0..m).map(row).collect())
}

/// Every solver of the host at the block sizes that a partition may produce.
pub fn participation(criterion: &mut Criterion) {
    let mut group = group(criterion, "participation host");
    for m in [16_usize, 64, 256] {
        let (metric, rows) = block(m);
        let product = |c: usize, r: usize| rows[c].iter().zip(&rows[r]).map(|(x, y)| x * y).sum::<f64>() as f32;
        let density: Vec<f32> = (0..m).flat_map(|c| (c..m).map(move |r| (c, r))).map(|(c, r)| product(c, r)).collect();
        for solver in Eigensolver::HOST {
            group.throughput(Throughput::Elements(1));
            group.bench_function(BenchmarkId::new(solver.to_string(), m), |b| {
                b.iter(|| solve(&metric, &rows, &density, solver, 0.95));
            });
        }
    }
    group.finish();
}

/// A part of a study's time, by its name.
type Part = (&'static str, fn(&Seconds) -> f64);

/// Studies of 100 k and 1 M Gaussians in blocks of about 48: by each solver of the eigenproblem, and by column subset.
/// Rows `device` and `host` are the concurrent parts of a study; bytes read back go into the facts.
pub fn selection(criterion: &mut Criterion) {
    let parts: [Part; 3] =
        [("whole", |s| s.wall), ("device", |s| s.overlap + s.rrdm + s.participation), ("host", |s| s.solve)];
    let mut group = group(criterion, "selection");
    group.sample_size(10);
    for n in if quick() { vec![100_000] } else { vec![100_000, 1_000_000] } {
        let model = scenes::crowd(n, 0, 1.0, 5);
        let value = |k: usize| (f64::from(noise(11, k as u64)) / 4e9).powi(3) as f32;
        let channels = (0..n).map(|i| std::array::from_fn(|c| value(CHANNELS * i + c))).collect();
        let responses = Responses { channels, ..Responses::default() };
        let resident = Resident::upload_shapes(device(), &model).unwrap();
        let observed = Observed { resident: &resident, model: &model, responses: &responses };
        let asked = [
            ("low-rank", Selector::Gnso, Eigensolver::LowRank),
            ("dsygvd", Selector::Gnso, Eigensolver::Dsygvd),
            ("device", Selector::Gnso, Eigensolver::Device),
            ("css", Selector::Css, Eigensolver::LowRank),
        ];
        for (name, selector, solver) in asked {
            let basis = Basis { solver, ..Basis::default() };
            let study = || Study::new(device(), observed, &basis, &[selector], 1).unwrap();
            let read_back = study().read_back as f64;
            group.throughput(Throughput::Elements(n as u64));
            for (part, seconds) in parts {
                let row = format!("{name}, {part}");
                facts::note("selection", &[&row, &thousands(n)], &[("read_back", read_back)]);
                group.bench_function(BenchmarkId::new(row, thousands(n)), |b| {
                    b.iter_custom(|iterations| {
                        let one = || {
                            let start = Instant::now();
                            let study = study();
                            let whole = start.elapsed();
                            if part == "whole" { whole } else { Duration::from_secs_f64(seconds(&study.seconds)) }
                        };
                        (0..iterations).map(|_| one()).sum::<Duration>()
                    });
                });
            }
        }
    }
    group.finish();
}

/// The three ways to divide a count, over 100,000 Gaussians.
pub fn select(criterion: &mut Criterion) {
    const GAUSSIANS: usize = 100_000;
    let place = |i: usize, c: usize| noise(8, (3 * i + c) as u64) as f32 / 4e9;
    let means: Vec<[f32; 3]> = (0..GAUSSIANS).map(|i| [place(i, 0), place(i, 1), place(i, 2)]).collect();
    let blocks = Partition::ADAPTIVE.of(&means).blocks;
    let score: Vec<f64> = (0..GAUSSIANS).map(|i| f64::from(noise(9, i as u64))).collect();
    let ranking = Ranking::by_score(&blocks, &score);
    let r = vec![1; blocks.len()];
    let mut group = group(criterion, "select");
    group.throughput(Throughput::Elements(GAUSSIANS as u64));
    for (name, budget) in [("per-block", Budget::PerBlock), ("hybrid", Budget::Hybrid), ("global", Budget::Global)] {
        group.bench_function(BenchmarkId::from_parameter(name), |b| {
            b.iter(|| choose(&blocks, &ranking, &r, budget, Keep::Share(0.28), None));
        });
    }
    group.finish();
}
