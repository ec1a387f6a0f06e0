//! Gradient sums by Gaussian, to be added to by float atomics.

use super::frame::SlotSums;
use crate::gpu::{Buffer, Device, Feature, Result};

/// Sums by Gaussian, and how they are added to.
pub struct AtomicSums {
    pub(super) native: bool,
    /// 0, 1, 2, ...: a Gaussian's sums are one row, its own.
    pub(super) own: Buffer<u32>,
    pub(super) sums: SlotSums,
}

impl AtomicSums {
    /// Bytes of the sums of so many Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<u32>::bytes_of(gaussians) + SlotSums::bytes(gaussians)
    }

    /// Whether the device adds floats atomically; all others do it by comparing and swapping words.
    pub fn are_native(device: &Device) -> bool {
        device.info().has(Feature::FloatAtomics)
    }

    /// Room for so many Gaussians; `native` asks for the device's own float atomics, which it must have.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, gaussians: usize, native: bool) -> Result<Self> {
        let own: Vec<u32> = (0..gaussians as u32).collect();
        Ok(Self { native, own: device.upload("own rows", &own)?, sums: SlotSums::new(device, gaussians)? })
    }
}
