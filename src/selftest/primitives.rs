//! Scan, sort and compaction: exact against the host.

use super::Allowed::Exact;
use super::Measure;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::primitives::{Count, Pairs, Scan, Sort, compact, gather};
use crate::random::Random;

const LARGE: u32 = 1_000_003;

/// Sizes around every boundary: subgroups, workgroups, blocks, powers of two.
pub fn sizes(device: &Device) -> Vec<u32> {
    let mut sizes = vec![0, 1, 2, 3];
    let block = Scan::block(device);
    for edge in [device.info().subgroup_size, 64, 256, 1024, block, 2 * block, 1 << 16] {
        sizes.extend([edge - 1, edge, edge + 1]);
    }
    sizes
}

/// Words of more blocks than a scan lets each sum all before it: with room for so many it has a phase for their sums.
pub fn many_blocks(device: &Device) -> u32 {
    Scan::block(device).saturating_mul(5000)
}

/// Pairs of more blocks than a sort lets each sum all before it.
pub(super) const MANY_PAIRS: u32 = 1 << 20;

/// `n` random words.
pub fn words(n: u32, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..n).map(|_| (random.word() >> 32) as u32).collect()
}

fn differing<T: PartialEq>(got: &[T], expected: &[T]) -> f64 {
    let unequal = got.iter().zip(expected).filter(|(g, e)| g != e).count();
    (unequal + got.len().abs_diff(expected.len())) as f64
}

/// Words behind those of a buffer, which no kernel may change.
const SENTINEL: [u32; 8] = [0xDEAD_BEEF; 8];

/// A buffer of `data` with the sentinel behind it.
pub fn guarded(device: &Device, data: &[u32]) -> Result<Buffer<u32>> {
    device.upload("guarded", &[data, &SENTINEL].concat())
}

/// Number of the first words of a guarded buffer that differ from `expected`; infinite if its sentinel does.
pub fn wrong_words(device: &Device, buffer: &Buffer<u32>, expected: &[u32]) -> Result<f64> {
    let words = buffer.read(device)?;
    let beyond = if words.ends_with(&SENTINEL) { 0.0 } else { f64::INFINITY };
    Ok(beyond + differing(&words[..expected.len().min(words.len())], expected))
}

/// The sums of the words before each word, and of all; 2^32 - 1 if they are larger.
pub fn exclusive_sum(data: &[u32]) -> (Vec<u32>, u32) {
    let mut sum = 0_u32;
    let mut sums = Vec::with_capacity(data.len());
    for v in data {
        sums.push(sum);
        sum = sum.saturating_add(*v);
    }
    (sums, sum)
}

/// Number of words that differ in the prefix sums of `data`, in a buffer of their own and in place, and in the total;
/// for sums beyond 32 bits, in the total alone. Infinite if words behind these are written. The scan has room for
/// `capacity` words.
fn scan(device: &Device, data: &[u32], capacity: u32) -> Result<f64> {
    let (source, target) = (guarded(device, data)?, guarded(device, &vec![7; data.len()])?);
    let total = Count::new(device, "total", u32::MAX, &[])?;
    let count = Count::known(device, "count", data.len() as u32, &[Scan::block(device)])?;
    let scan = Scan::new(device, capacity)?;
    let (sums, sum) = exclusive_sum(data);
    let mut wrong = 0.0;
    for target in [&target, &source] {
        let mut recording = Recording::new();
        scan.record(&mut recording, &count, (&source).into(), target, &total);
        device.run(recording)?;
        wrong += differing(&total.value.read(device)?, &[sum; 2]);
        wrong += wrong_words(device, target, if sum < u32::MAX { &sums } else { &[] })?;
    }
    Ok(wrong)
}

/// Words whose sum stays within 32 bits.
fn small_words(n: u32) -> Vec<u32> {
    words(n, 1).iter().map(|word| word >> 20).collect()
}

/// Number of words that differ, over all `sizes`, with room for at least `room` words; unless that is 0, over larger sizes
/// too.
fn over_sizes(device: &Device, room: u32, case: impl Fn(u32, u32) -> Result<f64>) -> Result<Vec<Measure>> {
    let mut wrong = 0.0;
    for n in sizes(device) {
        wrong += case(n, room.max(n))?;
    }
    // The sums of so many blocks are scanned in two rounds.
    let two_rounds = (device.tuning().scan_workgroup + 1).saturating_mul(Scan::block(device));
    for n in [two_rounds, LARGE].into_iter().filter(|_| room > 0) {
        wrong += case(n, n)? + case(n, room.max(n))?;
    }
    Ok(vec![("wrong words", wrong, Exact(0.0))])
}

pub(super) fn scans(device: &Device, room: u32) -> Result<Vec<Measure>> {
    over_sizes(device, room, |n, room| scan(device, &small_words(n), room))
}

pub(super) fn large_total(device: &Device) -> Result<Vec<Measure>> {
    Ok(vec![("wrong words", scan(device, &words(LARGE, 1), LARGE)?, Exact(0.0))])
}

/// Number of words that differ after a sort of `keys` by their lowest `bits`, with room for `capacity` pairs; infinite if
/// words behind the pairs are written.
fn sort(device: &Device, keys: &[u32], bits: u32, capacity: u32) -> Result<f64> {
    let n = keys.len() as u32;
    let values: Vec<u32> = (0..n).collect();
    let pairs = Pairs { keys: guarded(device, keys)?, values: guarded(device, &values)? };
    let count = Count::known(device, "count", n, &[Sort::block(device, capacity)])?;
    let sort = Sort::new(device, capacity)?;
    let mut recording = Recording::new();
    let sorted = sort.record(&mut recording, &count, &pairs, bits);
    device.run(recording)?;
    let mask = u32::MAX >> (32 - bits);
    let mut expected = values;
    expected.sort_by_key(|v| keys[*v as usize] & mask); // stable, as the device's must be
    let expected_keys: Vec<u32> = expected.iter().map(|v| keys[*v as usize]).collect();
    let mut wrong = differing(&sorted.values.read_first(device, n as usize)?, &expected);
    wrong += differing(&sorted.keys.read_first(device, n as usize)?, &expected_keys);
    // The result may lie in scratch memory.
    for words in [&pairs.keys, &pairs.values] {
        wrong += wrong_words(device, words, &[])?;
    }
    Ok(wrong)
}

pub(super) fn sorts(device: &Device, room: u32) -> Result<Vec<Measure>> {
    over_sizes(device, room, |n, room| sort(device, &words(n, 2), 32, room))
}

pub(super) fn sort_kinds(device: &Device, room: u32) -> Result<Vec<Measure>> {
    let mut wrong = 0.0;
    for bits in [1, 5, 8, 9, 13, 16, 17, 31] {
        wrong += sort(device, &words(5000, 3), bits, room.max(5000))?;
    }
    for keys in [vec![42; 10_000], (0..10_000).collect(), (0..10_000).rev().collect(), vec![u32::MAX; 3000]] {
        wrong += sort(device, &keys, 32, room.max(keys.len() as u32))?;
    }
    Ok(vec![("wrong words", wrong, Exact(0.0))])
}

/// Flags of which about a third are set.
fn flags(n: u32) -> Vec<u32> {
    words(n, 5).into_iter().map(|word| u32::from(word % 3 == 0)).collect()
}

/// Number of words that differ after a compaction of random keys by `flags`, and after the kept ones are gathered by
/// their indices; words behind the kept ones must stay. Infinite if words behind these buffers are written. The scan has
/// room for `capacity` words.
fn compaction(device: &Device, flags: &[u32], capacity: u32) -> Result<f64> {
    let n = flags.len() as u32;
    let keys = words(n, 7);
    let kept: Vec<u32> = (0..n).filter(|i| flags[*i as usize] != 0).collect();
    let kept_keys: Vec<u32> = kept.iter().map(|i| keys[*i as usize]).collect();
    let number = kept.len() as u32;
    let rest = vec![9_u32; (n - number) as usize];
    let (kept, kept_keys) = ([kept, rest.clone()].concat(), [kept_keys, rest].concat());
    let (flags, keys) = (device.upload("flags", flags)?, device.upload("keys", &keys)?);
    let unwritten = || guarded(device, &vec![9; n as usize]);
    let (pairs, gathered) = (Pairs { keys: unwritten()?, values: unwritten()? }, unwritten()?);
    let count = Count::known(device, "count", n, &[Scan::block(device)])?;
    let total = Count::new(device, "kept", n, &[])?;
    let scan = Scan::new(device, capacity)?;
    let mut recording = Recording::new();
    compact(&mut recording, &scan, &count, [&flags, &keys], &pairs, &total);
    gather(&mut recording, &total, &pairs.values, &keys, &gathered);
    device.run(recording)?;
    let mut wrong = differing(&total.value.read(device)?, &[number; 2]);
    for (got, expected) in [(&pairs.values, &kept), (&pairs.keys, &kept_keys), (&gathered, &kept_keys)] {
        wrong += wrong_words(device, got, expected)?;
    }
    Ok(wrong)
}

/// A third of the words kept, none, and all.
pub(super) fn compactions(device: &Device, room: u32) -> Result<Vec<Measure>> {
    over_sizes(device, room, |n, room| {
        let [none, all] = [0, 1].map(|flag| vec![flag; n as usize]);
        Ok(compaction(device, &flags(n), room)? + compaction(device, &none, room)? + compaction(device, &all, room)?)
    })
}
