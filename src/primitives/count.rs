//! A count on the device, and the dispatch sizes computed from it.

use super::WORKGROUP;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::primitives::{Arguments, ArgumentsPush, ArgumentsSpec};

/// A number of elements that kernels compute; the host does not read it within a frame.
pub struct Count {
    /// Word 0: the count; word 1: the largest count requested so far, even beyond the limit.
    pub value: Buffer<u32>,
    arguments: Buffer<u32>,
    sizes: [u32; 4],
    limit: u32,
}

impl Count {
    /// A count of at most `limit`; dispatches may take `WORKGROUP` or any of up to three `sizes` elements per group.
    ///
    /// # Errors
    /// Device memory.
    ///
    /// # Panics
    /// If there are more than three sizes.
    pub fn new(device: &Device, name: &str, limit: u32, sizes: &[u32]) -> Result<Self> {
        let mut all = [WORKGROUP; 4];
        all[1..=sizes.len()].copy_from_slice(sizes);
        let value = device.upload(name, &[0, 0])?;
        Ok(Self { value, arguments: device.buffer(name, 12)?, sizes: all, limit })
    }

    /// Bytes of a count on the device.
    pub const fn bytes() -> u64 {
        Buffer::<u32>::bytes_of(2) + Buffer::<u32>::bytes_of(12)
    }

    /// A count that the host knows.
    ///
    /// # Errors
    /// Device memory.
    pub fn known(device: &Device, name: &str, count: u32, sizes: &[u32]) -> Result<Self> {
        let made = Self::new(device, name, u32::MAX, sizes)?;
        let mut recording = Recording::new();
        made.set(&mut recording, count);
        device.run(recording)?;
        Ok(made)
    }

    /// The largest valid count; [`Count::prepare`] replaces a larger one by 0.
    pub fn limit(&self) -> u32 {
        self.limit
    }

    /// Sets the count from the host.
    pub fn set(&self, recording: &mut Recording, count: u32) {
        recording.update(&self.value, &[count]);
        self.prepare(recording);
    }

    /// Computes the dispatch sizes, once a kernel has written the count.
    pub fn prepare(&self, recording: &mut Recording) {
        self.record(recording, &self.value, 1, 1);
    }

    /// Sets this count to ceil(`of` / `per`) x `times`, and its dispatch sizes.
    pub fn derive(&self, recording: &mut Recording, of: &Self, per: u32, times: u32) {
        self.record(recording, &of.value, per, times);
    }

    fn record(&self, recording: &mut Recording, source: &Buffer<u32>, per: u32, times: u32) {
        let kernel = Arguments {
            source,
            value: &self.value,
            arguments: &self.arguments,
            push: ArgumentsPush { per, times, limit: self.limit, sizes: self.sizes },
            spec: ArgumentsSpec { workgroup: 32 },
        };
        recording.dispatch(&kernel, Groups::Count(1));
    }

    /// The number of groups that cover the count at `per_group` elements each.
    ///
    /// # Panics
    /// If `per_group` is not among the sizes.
    pub fn groups(&self, per_group: u32) -> Groups<'_> {
        let slot = self.sizes.iter().position(|s| *s == per_group).expect("a size named in Count::new");
        Groups::Indirect(&self.arguments, 3 * slot as u32)
    }
}
