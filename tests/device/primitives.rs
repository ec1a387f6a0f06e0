//! Primitives against the host, at every size at or next to a block, a subgroup or a power of two.

use crate::support::{device, finish};
use qirf_vk::gpu::{Buffer, Device, Recording};
use qirf_vk::primitives::{Count, Pairs, Scan, Sort, WORKGROUP, Words, compact, gather, reduce};

/// Sizes around every boundary: subgroups, workgroups, blocks, powers of two.
fn sizes(device: &Device) -> Vec<u32> {
    let subgroup = device.info().subgroup_size;
    let mut sizes = vec![0, 1, 2, 3];
    for edge in [subgroup, 64, 256, 1024, Scan::block(device), 2 * Scan::block(device), 1 << 16] {
        sizes.extend([edge - 1, edge, edge + 1]);
    }
    sizes.push(1_000_003);
    sizes
}

/// A small counter-based generator: the same numbers on every machine.
fn noise(seed: u64, i: u64) -> u32 {
    let mut x = (i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ seed.wrapping_mul(0xD1B5_4A32_D192_ED03);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (x >> 32) as u32
}

/// A buffer of `data` with a sentinel behind it, which no kernel may touch.
fn with_sentinel(device: &Device, data: &[u32]) -> Buffer<u32> {
    let mut all = data.to_vec();
    all.extend([0xDEAD_BEEF; 8]);
    device.upload("with sentinel", &all).unwrap()
}

fn without_sentinel(device: &Device, buffer: &Buffer<u32>) -> Vec<u32> {
    let mut all = buffer.read(device).unwrap();
    let sentinel = all.split_off(all.len() - 8);
    assert_eq!(sentinel, [0xDEAD_BEEF; 8], "a kernel wrote behind its buffer");
    all
}

fn run(device: &Device, record: impl FnOnce(&mut Recording)) {
    let mut recording = Recording::new();
    record(&mut recording);
    device.run(recording).unwrap();
}

/// The sums of the words before each, and of all.
fn sums_before(words: impl IntoIterator<Item = u32>) -> (Vec<u32>, u32) {
    let mut sum = 0;
    let next = |word| {
        sum += word;
        sum - word
    };
    (words.into_iter().map(next).collect(), sum)
}

#[test]
fn scan_is_exact() {
    let device = device();
    // The sums of this many blocks are scanned in two rounds.
    let two_rounds = (device.tuning().scan_workgroup + 1) * Scan::block(&device);
    for n in sizes(&device).into_iter().chain([two_rounds]) {
        let data: Vec<u32> = (0..n).map(|i| noise(1, u64::from(i)) % 1000).collect();
        let (expected, sum) = sums_before(data.iter().copied());
        let count = Count::known(&device, "n", n, &[Scan::block(&device)]).unwrap();
        for capacity in [n, many_blocks(&device)] {
            let source = with_sentinel(&device, &data);
            let target = with_sentinel(&device, &vec![7; n as usize]);
            let total = Count::new(&device, "total", u32::MAX, &[]).unwrap();
            let scan = Scan::new(&device, capacity).unwrap();
            run(&device, |recording| scan.record(recording, &count, (&source).into(), &target, &total));
            assert_eq!(without_sentinel(&device, &target), expected, "n = {n} of {capacity}");
            assert_eq!(total.value.read(&device).unwrap(), [sum; 2], "n = {n} of {capacity}");
            // In place.
            run(&device, |recording| scan.record(recording, &count, (&source).into(), &source, &total));
            assert_eq!(without_sentinel(&device, &source), expected, "n = {n} of {capacity}, in place");
        }
    }
    finish(&device);
}

/// Room for more words than a scan of few blocks: the scan then has a phase for their sums.
fn many_blocks(device: &Device) -> u32 {
    5000 * Scan::block(device)
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

/// With room for these keys alone, and with room for more blocks than can sum each other's counts.
fn check_sort(device: &Device, keys: &[u32], bits: u32) {
    let n = keys.len() as u32;
    let values: Vec<u32> = (0..n).collect();
    let mask = if bits == 32 { u32::MAX } else { (1 << bits) - 1 };
    let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    expected.sort_by_key(|(k, _)| k & mask); // stable, as the device's sort must be
    for capacity in [n, n.max(1 << 20)] {
        let pairs = Pairs { keys: with_sentinel(device, keys), values: with_sentinel(device, &values) };
        let count = Count::known(device, "n", n, &[Sort::block(device, capacity)]).unwrap();
        let sort = Sort::new(device, capacity).unwrap();
        let mut recording = Recording::new();
        let sorted = sort.record(&mut recording, &count, &pairs, bits);
        device.run(recording).unwrap();
        let read = |words: &Buffer<u32>| words.read_first(device, n as usize).unwrap();
        let got: Vec<_> = read(&sorted.keys).into_iter().zip(read(&sorted.values)).collect();
        assert!(got == expected, "n = {n} of {capacity}, {bits} bits");
        without_sentinel(device, &pairs.keys);
        without_sentinel(device, &pairs.values);
    }
}

#[test]
fn sort_is_stable_and_exact() {
    let device = device();
    for n in sizes(&device) {
        let keys: Vec<u32> = (0..n).map(|i| noise(2, u64::from(i))).collect();
        check_sort(&device, &keys, 32);
    }
    for bits in [1, 5, 8, 9, 13, 16, 17, 31] {
        let keys: Vec<u32> = (0..5000).map(|i| noise(3, i)).collect();
        check_sort(&device, &keys, bits);
    }
    check_sort(&device, &vec![42; 10_000], 32);
    check_sort(&device, &(0..10_000).collect::<Vec<_>>(), 32);
    check_sort(&device, &(0..10_000).rev().collect::<Vec<_>>(), 32);
    check_sort(&device, &[u32::MAX; 3000], 32);
    finish(&device);
}

/// Flags, keys, and the pairs (key, index) that are kept.
fn check_compact(device: &Device, flags: &[u32]) {
    let n = flags.len() as u32;
    let keys: Vec<u32> = (0..n).map(|i| noise(6, u64::from(i))).collect();
    let kept: Vec<u32> = (0..n).filter(|i| flags[*i as usize] != 0).collect();
    let kept_keys: Vec<u32> = kept.iter().map(|i| keys[*i as usize]).collect();
    let count = Count::known(device, "n", n, &[Scan::block(device)]).unwrap();
    let (flags, keys) = (with_sentinel(device, flags), with_sentinel(device, &keys));
    let unwritten = vec![9; n as usize];
    let rest = vec![9; n as usize - kept.len()];
    for capacity in [n, many_blocks(device)] {
        let kept_count = Count::new(device, "kept", n, &[]).unwrap();
        let pairs = Pairs { keys: with_sentinel(device, &unwritten), values: with_sentinel(device, &unwritten) };
        let gathered = with_sentinel(device, &unwritten);
        let scan = Scan::new(device, capacity).unwrap();
        let mut recording = Recording::new();
        compact(&mut recording, &scan, &count, [&flags, &keys], &pairs, &kept_count);
        gather(&mut recording, &kept_count, &pairs.values, &keys, &gathered);
        device.run(recording).unwrap();
        assert_eq!(kept_count.value.read(device).unwrap(), [kept.len() as u32; 2], "n = {n} of {capacity}");
        assert_eq!(without_sentinel(device, &pairs.values), [&kept[..], &rest].concat(), "n = {n} of {capacity}");
        assert_eq!(without_sentinel(device, &pairs.keys), [&kept_keys[..], &rest].concat(), "n = {n} of {capacity}");
        assert_eq!(without_sentinel(device, &gathered), [&kept_keys[..], &rest].concat(), "n = {n} of {capacity}");
    }
}

#[test]
fn compact_and_gather() {
    let device = device();
    for n in sizes(&device) {
        check_compact(
            &device,
            &(0..n).map(|i| u32::from(noise(4, u64::from(i)).is_multiple_of(3))).collect::<Vec<_>>(),
        );
    }
    // All kept, then none.
    for flag in [0, 1] {
        for n in [1, 256, Scan::block(&device) + 1, 70_001] {
            check_compact(&device, &vec![flag; n as usize]);
        }
    }
    finish(&device);
}

/// The words are gathered once, into the target of the sums.
#[test]
fn scan_of_gathered_words() {
    let device = device();
    for n in sizes(&device) {
        let source: Vec<u32> = (0..1000).map(|i| noise(8, i) % 1000).collect();
        let indices: Vec<u32> = (0..n).map(|i| noise(9, u64::from(i)) % 1000).collect();
        let (expected, sum) = sums_before(indices.iter().map(|i| source[*i as usize]));
        let count = Count::known(&device, "n", n, &[Scan::block(&device)]).unwrap();
        let total = Count::new(&device, "total", 1000 * n, &[64]).unwrap();
        let (source, indices) = (with_sentinel(&device, &source), with_sentinel(&device, &indices));
        let target = with_sentinel(&device, &vec![9; n as usize]);
        let words = Words { source: &source, indices: Some(&indices) };
        let scan = Scan::new(&device, n).unwrap();
        run(&device, |recording| scan.record(recording, &count, words, &target, &total));
        assert_eq!(without_sentinel(&device, &target), expected, "n = {n}");
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
        let words = |i: u32, c: u64| (noise(7 + c, u64::from(i)) % 100) as f32;
        let mut source: Vec<[f32; 4]> = (0..n).map(|i| [0, 1, 2, 3].map(|c| words(i, c))).collect();
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
