//! `sort` and `scan`: rates in elements per second.

use super::{bounds, device, group, has_timestamps, row, scenes::noise, time_of, timed};
use criterion::{BenchmarkId, Criterion, Throughput};
use qirf_vk::gpu::Recording;
use qirf_vk::primitives::{Count, Pairs, Scan, Sort};
use std::time::Instant;

const POWERS: [u32; 3] = [16, 20, 22];

/// Pairs of random 32-bit keys and 32-bit values, all 32 bits sorted.
pub fn sort(criterion: &mut Criterion) {
    let device = device();
    let mut group = group(criterion, "sort");
    for power in POWERS {
        let n = 1_u32 << power;
        let keys: Vec<u32> = (0..n).map(|i| noise(1, u64::from(i))).collect();
        let fresh = device.upload("keys", &keys).unwrap();
        let pairs = Pairs::new(device, "pairs", n).unwrap();
        let count = Count::known(device, "n", n, &[Sort::block(device, n)]).unwrap();
        let sort = Sort::new(device, n).unwrap();
        let run = || {
            let mut recording = Recording::new();
            // The last result overwrites the keys: each run sorts a fresh copy of the same keys. The copy is not timed
            // if the device has timestamps.
            recording.copy(&fresh, &pairs.keys, n as usize);
            recording.scope("sort", |r| {
                sort.record(r, &count, &pairs, 32);
            });
            let start = Instant::now();
            time_of(&device.run(recording).unwrap(), "sort", start)
        };
        group.throughput(Throughput::Elements(u64::from(n)));
        bounds::sort(f64::from(n)).note("sort", &[&format!("2^{power}")], &[("elements", f64::from(n))]);
        row(&mut group, BenchmarkId::from_parameter(format!("2^{power}")), run);
    }
    if !has_timestamps() {
        println!("sort: no timestamps on this device; times include a copy of the keys and the submission");
    }
    group.finish();
}

/// Exclusive prefix sum of 32-bit words.
pub fn scan(criterion: &mut Criterion) {
    let device = device();
    let mut group = group(criterion, "scan");
    for power in POWERS {
        let n = 1_u32 << power;
        let words: Vec<u32> = (0..n).map(|i| noise(2, u64::from(i)) % 1000).collect();
        let source = device.upload("words", &words).unwrap();
        let target = device.buffer("sums", n as usize).unwrap();
        let count = Count::known(device, "n", n, &[Scan::block(device)]).unwrap();
        let total = Count::new(device, "total", u32::MAX, &[]).unwrap();
        let scan = Scan::new(device, n).unwrap();
        let run = || timed("scan", |r| scan.record(r, &count, (&source).into(), &target, &total));
        group.throughput(Throughput::Elements(u64::from(n)));
        bounds::scan(f64::from(n)).note("scan", &[&format!("2^{power}")], &[("elements", f64::from(n))]);
        row(&mut group, BenchmarkId::from_parameter(format!("2^{power}")), run);
    }
    group.finish();
}
