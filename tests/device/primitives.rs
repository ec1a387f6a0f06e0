//! Primitives against the host, beyond the selftest's cases: totals, gathered words, limits, sums.

use crate::support::{Random, device, finish};
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::primitives::{Count, Pairs, Scan, WORKGROUP, Words, compact, reduce};
use qirf_vk::selftest::primitives::{exclusive_sum, guarded, many_blocks, sizes, words, wrong_words};

fn run(device: &Device, record: impl FnOnce(&mut Recording)) {
    let mut recording = Recording::new();
    record(&mut recording);
    device.run(recording).unwrap();
}

/// A total beyond 32 bits must not appear to fit, wherever in the scan it becomes too large.
#[test]
fn totals_saturate() {
    let device = device();
    let block = Scan::block(&device) as usize;
    let half = 1_u32 << 31;
    let apart = |gap: usize| [vec![half], vec![0; gap], vec![half, 5]].concat();
    let cases = [
        (vec![half, half, 5], u32::MAX),
        (vec![half, half - 1, 0], u32::MAX),
        (vec![half, half - 2, 1], u32::MAX),
        (vec![half, 7, 5], half + 12),
        (vec![u32::MAX; 3], u32::MAX),
        (vec![u32::MAX; 3 * block + 1], u32::MAX),
        (vec![1 << 20; 4096], u32::MAX),
        (apart(block / 2), u32::MAX),
        (apart(block), u32::MAX),
        (apart(300 * block), u32::MAX),
    ];
    for (data, expected) in cases {
        let n = data.len() as u32;
        let (source, target) = (device.upload("source", &data).unwrap(), device.buffer("target", data.len()).unwrap());
        let count = Count::known(&device, "n", n, &[Scan::block(&device)]).unwrap();
        for capacity in [n, many_blocks(&device)] {
            let scan = Scan::new(&device, capacity).unwrap();
            let fits = Count::new(&device, "fits", u32::MAX - 1, &[]).unwrap();
            run(&device, |recording| scan.record(recording, &count, (&source).into(), &target, &fits));
            let valid = if expected == u32::MAX { 0 } else { expected };
            assert_eq!(fits.value.read(&device).unwrap(), [valid, expected], "{n} words of {capacity}");
        }
    }
    finish(&device);
}

/// The words are gathered once, into the target of the sums.
#[test]
fn scan_of_gathered_words() {
    let device = device();
    for n in sizes(&device).into_iter().chain([1_000_003]) {
        let below = |count: u32, seed: u64| words(count, seed).iter().map(|word| word % 1000).collect::<Vec<_>>();
        let (source, indices) = (below(1000, 8), below(n, 9));
        let gathered: Vec<u32> = indices.iter().map(|i| source[*i as usize]).collect();
        let (expected, sum) = exclusive_sum(&gathered);
        let count = Count::known(&device, "n", n, &[Scan::block(&device)]).unwrap();
        let total = Count::new(&device, "total", 1000 * n, &[64]).unwrap();
        let [source, indices] = [source, indices].map(|words| device.upload("words", &words).unwrap());
        let target = guarded(&device, &vec![9; n as usize]).unwrap();
        let words = Words { source: &source, indices: Some(&indices) };
        let scan = Scan::new(&device, n).unwrap();
        run(&device, |recording| scan.record(recording, &count, words, &target, &total));
        assert_eq!(wrong_words(&device, &target, &expected).unwrap(), 0.0, "n = {n}");
        assert_eq!(total.value.read(&device).unwrap(), [sum; 2], "n = {n}");
    }
    finish(&device);
}

#[test]
fn compact_reads_no_flag_beyond_the_count() {
    let device = device();
    let (flags, keys) = (device.upload("flags", &[1_u32; 64]).unwrap(), device.upload("keys", &[5_u32; 64]).unwrap());
    let unwritten = || device.upload("kept", &[u32::MAX; 64]).unwrap();
    let kept = Pairs { keys: unwritten(), values: unwritten() };
    let count = Count::known(&device, "count", 40, &[Scan::block(&device)]).unwrap();
    let total = Count::new(&device, "total", 64, &[]).unwrap();
    let scan = Scan::new(&device, 64).unwrap();
    run(&device, |recording| compact(recording, &scan, &count, [&flags, &keys], &kept, &total));
    let expected: Vec<u32> = (0..64).map(|i| if i < 40 { i } else { u32::MAX }).collect();
    assert_eq!(kept.values.read(&device).unwrap(), expected);
    assert_eq!(total.value.read(&device).unwrap(), [40, 40]);
    finish(&device);
}

/// Whole numbers below 2^24 add up exactly in any order: each element is counted once, whatever their number.
#[test]
fn reduce_counts_every_element_once() {
    let device = device();
    for n in sizes(&device).into_iter().filter(|n| *n < 100_000) {
        let mut random = Random(7);
        let mut source: Vec<[f32; 4]> = (0..n).map(|_| [0; 4].map(|_| (random.word() % 100) as f32)).collect();
        let expected = [0, 1, 2, 3].map(|c| source.iter().map(|r| r[c]).sum::<f32>());
        source.extend([[f32::NAN; 4]; 3]); // beyond the count: must not be included in the sum
        let source = device.upload("source", &source).unwrap();
        let sum = device.upload("sum", &[[f32::NAN; 4]]).unwrap();
        run(&device, |recording| reduce(recording, &source, n, &sum));
        assert_eq!(sum.read(&device).unwrap(), [expected], "n = {n}");
    }
    finish(&device);
}

#[test]
fn a_count_beyond_its_limit_becomes_zero_and_is_remembered() {
    let device = device();
    let count = Count::new(&device, "pairs", 100, &[]).unwrap();
    run(&device, |recording| count.set(recording, 5000));
    assert_eq!(count.value.read(&device).unwrap(), [0, 5000]);
    assert_eq!(WORKGROUP, 256);
    finish(&device);
}
