//! The smallest of many numbers, found on all cores: a histogram of their leading bits, then a selection within one
//! bin.

use rayon::prelude::*;

/// Leading bits of a key that the histogram counts by: for a float its sign, its exponent and four bits of its
/// mantissa.
const BITS: u32 = 16;
/// Numbers that one thread counts at a time.
const CHUNK: usize = 1 << 16;

/// An integer with the order of [`f64::total_cmp`].
pub fn key(x: f64) -> u64 {
    let bits = x.to_bits();
    if bits >> 63 == 0 { bits ^ (1 << 63) } else { !bits }
}

/// The float of a key.
pub fn float(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 { key ^ (1 << 63) } else { !key })
}

fn bin(key: u64) -> usize {
    (key >> (64 - BITS)) as usize
}

/// The key at place `n`, from 0, of all in ascending order.
///
/// # Panics
/// If there are only `n` keys or fewer.
pub fn nth(keys: &[u64], n: usize) -> u64 {
    assert!(n < keys.len(), "place {n} of {} keys", keys.len());
    let none = || vec![0_usize; 1 << BITS];
    let count = |mut bins: Vec<usize>, keys: &[u64]| {
        for k in keys {
            bins[bin(*k)] += 1;
        }
        bins
    };
    let add = |mut a: Vec<usize>, b: Vec<usize>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    let bins = keys.par_chunks(CHUNK).fold(none, count).reduce(none, add);
    let mut before = 0;
    let own = bins.iter().position(|count| {
        let here = n < before + count;
        before += if here { 0 } else { *count };
        here
    });
    let own = own.expect("bins count every key");
    let mut within: Vec<u64> = keys.par_iter().copied().filter(|k| bin(*k) == own).collect();
    *within.select_nth_unstable(n - before).1
}

/// The `count` smallest of `scored` (score, item), or all if there are fewer, in their original order; among equal
/// scores the first are taken.
pub fn smallest(scored: Vec<(f64, usize)>, count: usize) -> Vec<usize> {
    if count >= scored.len() {
        return scored.into_iter().map(|(_, i)| i).collect();
    }
    if count == 0 {
        return Vec::new();
    }
    let keys: Vec<u64> = scored.par_iter().map(|(score, _)| key(*score)).collect();
    let last = nth(&keys, count - 1);
    let mut ties = count - keys.par_iter().filter(|k| **k < last).count();
    let mut taken = |key: u64| {
        let tie = key == last && ties > 0;
        ties -= usize::from(tie);
        key < last || tie
    };
    scored.into_iter().zip(keys).filter(|(_, key)| taken(*key)).map(|((_, i), _)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    #[test]
    fn keys_order_as_floats() {
        let floats = [f64::NEG_INFINITY, -1e300, -1.0, -1e-320, -0.0, 0.0, 1e-320, 1.0, 1.5, f64::INFINITY, f64::NAN];
        assert!(floats.iter().all(|x| float(key(*x)).to_bits() == x.to_bits()));
        assert!(floats.windows(2).all(|pair| key(pair[0]) < key(pair[1])), "{:?}", floats.map(key));
    }

    /// The result equals that of sorting, with equal numbers and with more numbers than a thread counts at a time.
    #[test]
    fn as_by_sorting() {
        for (n, values) in [(1, 1.0), (7, 3.0), (1000, 50.0), (200_000, 1e4), (200_000, 1e12)] {
            let score = |i: usize| (uniform(&[n as u64, i as u64]) * values).floor() - 0.3 * values;
            let scored: Vec<(f64, usize)> = (0..n).map(|i| (score(i), 3 * i)).collect();
            let mut sorted = scored.clone();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for count in [0, 1, n / 3, n - 1, n, n + 5] {
                let mut expected: Vec<usize> = sorted.iter().take(count).map(|(_, i)| *i).collect();
                expected.sort_unstable();
                assert_eq!(smallest(scored.clone(), count), expected, "{count} of {n}");
            }
        }
    }
}
