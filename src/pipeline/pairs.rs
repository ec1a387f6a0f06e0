//! Room for (tile, Gaussian) pairs, a guess that results do not depend on: renderers grow what turns out too small.

use crate::gpu::Device;

/// Pairs expected for each Gaussian.
const PER_GAUSSIAN: u32 = 16;
/// Room in every case.
const LEAST: u32 = 1 << 14;

/// Pairs that `gaussians` in training are given room for, and that estimates of memory assume.
pub fn room(gaussians: usize) -> u32 {
    u32::try_from(gaussians).unwrap_or(u32::MAX).saturating_mul(PER_GAUSSIAN).max(LEAST)
}

/// As [`room`], but no more than one of the device's buffers holds.
pub fn most(device: &Device, gaussians: usize) -> u32 {
    let bound = device.info().max_buffer_bytes / size_of::<[f32; 4]>() as u64;
    room(gaussians).min(u32::try_from(bound).unwrap_or(u32::MAX))
}

/// Pairs that a trained model is first given room for: a quarter of [`most`]'s.
pub fn few(device: &Device, gaussians: usize) -> u32 {
    most(device, gaussians / 4)
}
