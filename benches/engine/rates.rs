//! `device`: the device's peak rates, from which the bounds of all other groups are computed.

use super::peak::{By, Chain, Copy, MultiplyAdd};
use super::{device, facts, group, row, timed};
use criterion::{BenchmarkId, Criterion, Throughput};

/// Size in MiB of each of two buffers: within a core's cache, within a shared one, and in memory. The largest is the
/// size that every device of Vulkan 1.2 can bind.
const SIZES: [usize; 4] = [1, 8, 32, 128];

/// Bytes copied, counting both reads and writes, and float32 operations, two per multiply-add.
pub fn rates(criterion: &mut Criterion) {
    let device = device();
    let mut group = group(criterion, "device");
    // The fastest sample is the rate: many samples, so that at least one has the device to itself.
    group.sample_size(40);
    for mib in SIZES {
        for (by, name) in [(By::Kernel, "copy by a kernel"), (By::Command, "copy by command")] {
            let copy = Copy::new(device, mib << 18, by).unwrap();
            let id = format!("2 x {mib} MiB");
            facts::note("device", &[name, &id], &[("bytes", copy.moved() as f64), ("buffers", (mib << 21) as f64)]);
            group.throughput(Throughput::Bytes(copy.moved()));
            row(&mut group, BenchmarkId::new(name, id), || timed("copy", |r| copy.record(r)));
        }
    }
    let chain = Chain::new(device).unwrap();
    facts::note("device", &["chain of dispatches"], &[("dispatches", f64::from(Chain::DISPATCHES))]);
    group.throughput(Throughput::Elements(u64::from(Chain::DISPATCHES)));
    row(&mut group, BenchmarkId::from_parameter("chain of dispatches"), || timed("chain", |r| chain.record(r)));
    let multiply_add = MultiplyAdd::new(device).unwrap();
    facts::note("device", &["multiply-add"], &[("operations", multiply_add.operations() as f64)]);
    group.throughput(Throughput::Elements(multiply_add.operations()));
    row(&mut group, BenchmarkId::from_parameter("multiply-add"), || timed("multiply-add", |r| multiply_add.record(r)));
    group.finish();
}
