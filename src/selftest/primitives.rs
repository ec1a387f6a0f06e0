//! Scan, sort and compaction: exact against the host.

use super::Allowed::Exact;
use super::Measure;
use crate::gpu::{Device, Recording, Result};
use crate::primitives::{Count, Pairs, Scan, Sort, compact};
use crate::random::Random;

pub(super) const LARGE: u32 = 1_000_003;

/// Sizes at and next to those of a subgroup, a workgroup and a block.
fn sizes(device: &Device) -> Vec<u32> {
    let mut sizes = vec![0, 1];
    for edge in [device.info().subgroup_size, 256, Scan::block(device), 1 << 16] {
        sizes.extend([edge - 1, edge, edge + 1]);
    }
    sizes
}

pub(super) fn words(n: u32, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..n).map(|_| (random.word() >> 32) as u32).collect()
}

fn differing<T: PartialEq>(got: &[T], expected: &[T]) -> f64 {
    let unequal = got.iter().zip(expected).filter(|(g, e)| g != e).count();
    (unequal + got.len().abs_diff(expected.len())) as f64
}

fn exclusive_sum(data: &[u32]) -> (Vec<u32>, u32) {
    let mut sum = 0_u32;
    let mut sums = Vec::with_capacity(data.len());
    for v in data {
        sums.push(sum);
        sum = sum.saturating_add(*v);
    }
    (sums, sum)
}

/// Number of words that differ in the prefix sums of `data`, and in the total; for sums beyond 32 bits, in the total
/// alone.
pub(super) fn scan(device: &Device, data: &[u32]) -> Result<f64> {
    let n = data.len() as u32;
    let source = device.upload("source", data)?;
    let target = device.buffer::<u32>("target", n as usize)?;
    let total = Count::new(device, "total", u32::MAX, &[])?;
    let count = Count::known(device, "count", n, &[Scan::block(device)])?;
    let scan = Scan::new(device, n)?;
    let mut recording = Recording::new();
    scan.record(&mut recording, &count, (&source).into(), &target, &total);
    device.run(recording)?;
    let (sums, sum) = exclusive_sum(data);
    let wrong = if sum < u32::MAX { differing(&target.read_first(device, n as usize)?, &sums) } else { 0.0 };
    Ok(wrong + differing(&total.value.read_first(device, 1)?, &[sum]))
}

/// Words whose sum stays within 32 bits.
pub(super) fn small_words(n: u32) -> Vec<u32> {
    words(n, 1).iter().map(|word| word >> 20).collect()
}

/// Number of words that differ, over all `sizes`.
pub(super) fn over_sizes(device: &Device, case: impl Fn(&Device, u32) -> Result<f64>) -> Result<Vec<Measure>> {
    let mut wrong = 0.0;
    for n in sizes(device) {
        wrong += case(device, n)?;
    }
    Ok(vec![("wrong words", wrong, Exact(0.0))])
}

pub(super) fn scan_large(device: &Device) -> Result<Vec<Measure>> {
    let beyond = scan(device, &words(LARGE, 1))?;
    Ok(vec![
        ("wrong words", scan(device, &small_words(LARGE))?, Exact(0.0)),
        ("wrong total beyond 32 bits", beyond, Exact(0.0)),
    ])
}

/// Number of words that differ after a sort of `keys` by their lowest `bits`.
pub(super) fn sort(device: &Device, keys: &[u32], bits: u32) -> Result<f64> {
    let n = keys.len() as u32;
    let values: Vec<u32> = (0..n).collect();
    let pairs = Pairs { keys: device.upload("keys", keys)?, values: device.upload("values", &values)? };
    let count = Count::known(device, "count", n, &[Sort::block(device, n)])?;
    let sort = Sort::new(device, n)?;
    let mut recording = Recording::new();
    let sorted = sort.record(&mut recording, &count, &pairs, bits);
    device.run(recording)?;
    let mask = u32::MAX >> (32 - bits);
    let mut expected = values;
    expected.sort_by_key(|v| keys[*v as usize] & mask); // stable, as the device's must be
    let expected_keys: Vec<u32> = expected.iter().map(|v| keys[*v as usize]).collect();
    Ok(differing(&sorted.values.read_first(device, n as usize)?, &expected)
        + differing(&sorted.keys.read_first(device, n as usize)?, &expected_keys))
}

pub(super) fn sort_kinds(device: &Device) -> Result<Vec<Measure>> {
    let mut wrong = 0.0;
    for bits in [1, 5, 8, 9, 13, 17, 31] {
        wrong += sort(device, &words(5000, 3), bits)?;
    }
    for keys in [vec![42; 9000], (0..9000).collect(), (0..9000).rev().collect(), vec![u32::MAX; 3000]] {
        wrong += sort(device, &keys, 32)?;
    }
    Ok(vec![("wrong words", wrong, Exact(0.0))])
}

pub(super) fn compaction(device: &Device) -> Result<Vec<Measure>> {
    over_sizes(device, |device, n| {
        let flags: Vec<u32> = words(n, 5).into_iter().map(|w| u32::from(w % 3 == 0)).collect();
        let kept: Vec<u32> = (0..n).filter(|i| flags[*i as usize] != 0).collect();
        let count = Count::known(device, "count", n, &[Scan::block(device)])?;
        let keys: Vec<u32> = words(n, 7);
        let kept_keys: Vec<u32> = kept.iter().map(|i| keys[*i as usize]).collect();
        let (flags, keys) = (device.upload("flags", &flags)?, device.upload("keys", &keys)?);
        let (pairs, total) = (Pairs::new(device, "kept", n)?, Count::new(device, "kept", n, &[])?);
        let scan = Scan::new(device, n)?;
        let mut recording = Recording::new();
        compact(&mut recording, &scan, &count, [&flags, &keys], &pairs, &total);
        device.run(recording)?;
        let number = differing(&total.value.read_first(device, 1)?, &[kept.len() as u32]);
        let keys = differing(&pairs.keys.read_first(device, kept.len())?, &kept_keys);
        Ok(number + keys + differing(&pairs.values.read_first(device, kept.len())?, &kept))
    })
}
