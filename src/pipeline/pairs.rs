//! Capacity for (tile, Gaussian) pairs: an estimate that results do not depend on, since renderers grow buffers that
//! are too small.

use crate::gpu::Device;

/// Pairs expected for each Gaussian.
const PER_GAUSSIAN: u32 = 16;
/// Smallest capacity.
const LEAST: u32 = 1 << 14;

/// Capacity in pairs for `gaussians` in training, also assumed by estimates of memory.
pub fn room(gaussians: usize) -> u32 {
    u32::try_from(gaussians).unwrap_or(u32::MAX).saturating_mul(PER_GAUSSIAN).max(LEAST)
}

/// As [`room`], but at most what fits into one of the device's buffers.
pub fn most(device: &Device, gaussians: usize) -> u32 {
    let bound = device.info().max_buffer_bytes / size_of::<[f32; 4]>() as u64;
    room(gaussians).min(u32::try_from(bound).unwrap_or(u32::MAX))
}

/// Initial capacity in pairs for a trained model: a quarter of [`most`]'s.
pub fn few(device: &Device, gaussians: usize) -> u32 {
    most(device, gaussians / 4)
}
