//! Random numbers that are the same on every machine, and distances between arrays.

/// SplitMix64: uniform in [0, 1).
pub struct Random(pub u64);

impl Random {
    /// The next number.
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e3779b97f4a7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58476d1ce4e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d049bb133111eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// The seed of random hard cases, printed so that a failure can be repeated: `QIRF_SEED`, else 1.
pub fn seed() -> u64 {
    let seed = std::env::var("QIRF_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    println!("QIRF_SEED={seed}");
    seed
}

/// Euclidean distance over the Euclidean norm of `b`.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = b.iter().map(|b| b * b).sum();
    (difference / size.max(f64::MIN_POSITIVE)).sqrt()
}

/// Largest absolute difference.
pub fn greatest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}
