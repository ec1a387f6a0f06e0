//! Capacity for (tile, Gaussian) pairs: an estimate that results do not depend on, since renderers grow buffers that
//! are too small.

use crate::gpu::Device;
use crate::render::LEAST_PAIRS;

/// Pairs expected for each Gaussian, on tiles of 16 pixels and on smaller ones.
const PER_GAUSSIAN: [u32; 2] = [4, 8];

/// Capacity in pairs for `gaussians` that estimates of memory assume: a quarter more than is expected, as renderers take when
/// they grow.
pub fn estimate(device: &Device, gaussians: usize) -> u32 {
    let usual = usual(device, gaussians);
    usual.saturating_add(usual / 4)
}

/// Pairs expected in a picture of `gaussians`.
fn expected(device: &Device, gaussians: usize) -> u32 {
    let each = PER_GAUSSIAN[usize::from(device.tuning().tile < 16)];
    u32::try_from(gaussians).unwrap_or(u32::MAX).saturating_mul(each)
}

/// The same, but at least what renderers begin with.
fn usual(device: &Device, gaussians: usize) -> u32 {
    expected(device, gaussians).max(LEAST_PAIRS)
}

/// The expected pairs of `gaussians`, but at most what fits into one of the device's buffers.
pub fn device_max(device: &Device, gaussians: usize) -> u32 {
    let bound = device.info().max_buffer_bytes / size_of::<[f32; 4]>() as u64;
    usual(device, gaussians).min(u32::try_from(bound).unwrap_or(u32::MAX))
}

/// Initial capacity in pairs for a trained model: half of [`device_max`]'s.
pub fn initial(device: &Device, gaussians: usize) -> u32 {
    device_max(device, gaussians / 2)
}
