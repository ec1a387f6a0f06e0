//! Random numbers that are the same on every machine, and distances between arrays.

pub use qirf_vk::random::Random;

/// The seed of random hard cases, printed so that a failure can be repeated: `QIRF_SEED`, by default 1.
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
