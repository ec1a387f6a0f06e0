//! `participation host`: the host's eigensolvers by members of a block, in blocks per second; `select`: from rankings
//! to a keep mask. The device's solver is the group `participation`; `qirf-vk sweep` measures all of them on a scene's
//! own blocks.

use super::{group, scenes::noise};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::qirf::CHANNELS;
use qirf_vk::qirf::participation::{Eigensolver, Factor, Gram};
use qirf_vk::qirf::partition::Partition;
use qirf_vk::qirf::select::Ranking;
use qirf_vk::qirf::select::budget::{Budget, Keep, choose};

/// A block's normalised overlaps, falling with distance on a line, and random responses.
fn block(m: usize) -> (Gram, Vec<[f64; CHANNELS]>) {
    let overlap: Vec<f32> =
        (0..m * m).map(|k| (-0.5 * ((k / m) as f32 - (k % m) as f32).powi(2) / 4.0).exp()).collect();
    let row = |i: usize| std::array::from_fn(|c| f64::from(noise(7, (i * CHANNELS + c) as u64)) / 4e9);
    (Gram::new(m, &overlap, None, 1e-4), (0..m).map(row).collect())
}

/// Every solver at the sizes that a partition may give.
pub fn participation(criterion: &mut Criterion) {
    let mut group = group(criterion, "participation host");
    for m in [16_usize, 64, 256] {
        let (metric, rows) = block(m);
        for solver in Eigensolver::ALL {
            group.throughput(Throughput::Elements(1));
            group.bench_function(BenchmarkId::new(solver.to_string(), m), |b| {
                b.iter(|| Factor::new(&metric, solver).participation(&rows, 0.95));
            });
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
