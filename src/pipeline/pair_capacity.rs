//! Capacity for (tile, Gaussian) pairs: an estimate that results do not depend on, since renderers grow buffers that
//! are too small.

use crate::gpu::Device;
use crate::render::LEAST_PAIRS;

/// Pairs per Gaussian that renderers begin with, on tiles of 16 pixels and on smaller ones.
const PER_GAUSSIAN: [u32; 2] = [4, 8];

/// Ratio of the pairs that estimates assume to those of trained models: models in training vary, and renderers that grow take a quarter
/// more than they need.
const ROOM: f64 = 1.5;

/// Capacity in pairs for `gaussians` in pictures of at most `size` pixels that estimates of memory assume.
///
/// With s = 8 sqrt(pixels / Gaussians) / tile, trained models that fill pictures have 1 + s + 0.88 s^2 pairs per Gaussian, within
/// a fifth; objects before nothing have down to half of that (docs/decisions.md, 208).
pub fn estimate(device: &Device, gaussians: usize, [width, height]: [u32; 2]) -> u32 {
    let (pixels, n) = (f64::from(width) * f64::from(height), gaussians.max(1) as f64);
    let tile = device.tuning().tile;
    let s = 8.0 * (pixels / n).sqrt() / f64::from(tile);
    let tiles = f64::from(width.div_ceil(tile)) * f64::from(height.div_ceil(tile));
    let pairs = n * (ROOM * (1.0 + s + 0.88 * s * s)).min(tiles);
    // Renderers begin with these, and may take a quarter more.
    let begun = initial(device, gaussians);
    (pairs as u32).max(begun.saturating_add(begun / 4))
}

/// Initial capacity in pairs for a trained model: those of half of its Gaussians, but at least what renderers begin with, and at most
/// what fits into one of the device's buffers.
pub fn initial(device: &Device, gaussians: usize) -> u32 {
    let each = PER_GAUSSIAN[usize::from(device.tuning().tile < 16)];
    let half = u32::try_from(gaussians / 2).unwrap_or(u32::MAX).saturating_mul(each);
    let bound = device.info().max_buffer_bytes / size_of::<[f32; 4]>() as u64;
    half.max(LEAST_PAIRS).min(u32::try_from(bound).unwrap_or(u32::MAX))
}
