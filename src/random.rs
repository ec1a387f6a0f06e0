//! Random numbers by key, without state, so that a resumed run draws the same ones; and a sequence of them for tests.

/// SplitMix64's increment: 2^64 over the golden ratio.
pub const INCREMENT: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes 64 bits so that each depends on all (SplitMix64's step; Steele, Lea, Flood 2014).
pub const fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(INCREMENT);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Mixes a key to 64 random bits.
pub fn bits(key: &[u64]) -> u64 {
    key.iter().fold(INCREMENT, |state, word| mix(state ^ word))
}

/// A random number by key, uniform in [0, 1).
pub fn uniform(key: &[u64]) -> f64 {
    (bits(key) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A sequence of random numbers from a seed (SplitMix64): the inputs of the selftest and of tests.
pub struct Random(pub u64);

impl Random {
    /// 64 random bits.
    pub fn word(&mut self) -> u64 {
        let word = mix(self.0);
        self.0 = self.0.wrapping_add(INCREMENT);
        word
    }

    /// The next number, uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.word() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The next number, uniform in [low, high).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// A permutation of 0..n (Fisher and Yates).
pub fn permutation(n: usize, key: &[u64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        let mut full = key.to_vec();
        full.push(i as u64);
        order.swap(i, (bits(&full) % (i as u64 + 1)) as usize);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn permutations_hold_each_once_and_differ_by_key() {
        let mut a = permutation(100, &[1, 2]);
        assert_ne!(a, permutation(100, &[1, 3]));
        assert_eq!(a, permutation(100, &[1, 2]));
        a.sort_unstable();
        assert_eq!(a, (0..100).collect::<Vec<_>>());
    }

    #[test]
    fn uniform_numbers_fill_their_interval() {
        let mean: f64 = (0..10_000).map(|i| uniform(&[7, i])).sum::<f64>() / 10_000.0;
        assert!((mean - 0.5).abs() < 0.01);
    }
}
