//! A count on the device, and the dispatch sizes computed from it.

use super::WORKGROUP;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::primitives::{Arguments, ArgumentsPush, ArgumentsSpec};

/// A number of elements that kernels compute; the host does not read it within a frame.
pub struct Count {
    /// Word 0: the count; word 1: the largest count requested so far, even beyond the limit.
    pub value: Buffer<u32>,
    pub(super) arguments: Buffer<u32>,
    pub(super) sizes: [u32; 4],
    pub(super) limit: u32,
}

impl Count {
    /// A count of at most `limit`, at first 0; dispatches may take `WORKGROUP` or any of up to three `sizes` elements per
    /// group. Waits for the device.
    ///
    /// # Panics
    /// If there are more than three sizes.
    pub fn new(device: &Device, name: &str, limit: u32, sizes: &[u32]) -> Result<Self> {
        let made = Self::unset(device, name, limit, sizes)?;
        let mut recording = Recording::new();
        made.reset(&mut recording);
        device.run(recording)?;
        Ok(made)
    }

    /// Like [`Count::new`], but without a wait: the count is undefined until it is set, and the largest requested so far until
    /// [`Count::reset`] is recorded.
    ///
    /// # Panics
    /// If there are more than three sizes.
    pub fn unset(device: &Device, name: &str, limit: u32, sizes: &[u32]) -> Result<Self> {
        let mut all = [WORKGROUP; 4];
        all[1..=sizes.len()].copy_from_slice(sizes);
        Ok(Self { value: device.buffer(name, 2)?, arguments: device.buffer(name, 12)?, sizes: all, limit })
    }

    /// Records that the count is 0, and was never requested to be larger. Sizes of dispatches follow once it is set.
    pub fn reset(&self, recording: &mut Recording) {
        recording.update(&self.value, &[0, 0]);
    }

    /// Bytes of a count on the device.
    pub const fn bytes() -> u64 {
        Buffer::<u32>::bytes_of(2) + Buffer::<u32>::bytes_of(12)
    }

    /// A count that the host knows.
    pub fn known(device: &Device, name: &str, count: u32, sizes: &[u32]) -> Result<Self> {
        let made = Self::unset(device, name, u32::MAX, sizes)?;
        let mut recording = Recording::new();
        recording.update(&made.value, &[count, 0]);
        made.size_dispatches(&mut recording);
        device.run(recording)?;
        Ok(made)
    }

    /// The largest valid count; a larger one becomes 0.
    pub fn limit(&self) -> u32 {
        self.limit
    }

    /// Sets the count from the host, and the dispatch sizes that follow from it.
    pub fn set(&self, recording: &mut Recording, count: u32) {
        recording.update(&self.value, &[count]);
        self.size_dispatches(recording);
    }

    fn size_dispatches(&self, recording: &mut Recording) {
        let kernel = Arguments {
            value: &self.value,
            arguments: &self.arguments,
            push: ArgumentsPush { limit: self.limit, sizes: self.sizes },
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
