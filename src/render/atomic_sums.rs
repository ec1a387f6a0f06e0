//! Per-Gaussian gradient sums for accumulation by float atomics.

use super::slot_sums::SlotSums;
use crate::gpu::{Buffer, Device, Result};

/// Per-Gaussian gradient sums, accumulated by float atomics.
pub struct AtomicSums {
    /// 0, 1, 2, ...: each Gaussian has one row of sums, its own.
    pub(super) own: Buffer<u32>,
    pub(super) sums: SlotSums,
}

impl AtomicSums {
    /// Sums of `gaussians` Gaussians, on a device with [`crate::gpu::Feature::FloatAtomics`].
    pub fn new(device: &Device, gaussians: usize) -> Result<Self> {
        let own: Vec<u32> = (0..gaussians as u32).collect();
        Ok(Self { own: device.upload("own rows", &own)?, sums: SlotSums::new(device, gaussians, false)? })
    }
}
