//! Exclusive prefix sum of 32-bit words.

use super::count::Count;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::scan::{APPLY, REDUCE, SPINE};
use crate::kernels::primitives::{Scan as Kernel, ScanSpec};

/// Scratch memory and layout of a prefix sum over at most a given number of words.
pub struct Scan {
    sums: Buffer<u32>,
    unasked: Buffer<u32>,
    workgroup: u32,
    rows: u32,
}

impl Scan {
    /// Words that one workgroup scans on this device.
    pub fn block(device: &Device) -> u32 {
        device.tuning().scan_workgroup * device.tuning().scan_rows
    }

    /// Bytes of [`Scan::new`].
    pub fn bytes(device: &Device, capacity: u32) -> u64 {
        Buffer::<u32>::bytes_of(capacity.div_ceil(Self::block(device)) as usize) + Buffer::<u32>::bytes_of(1)
    }

    /// Scratch for scans of up to `capacity` words.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, capacity: u32) -> Result<Self> {
        let (workgroup, rows) = (device.tuning().scan_workgroup, device.tuning().scan_rows);
        let sums = device.buffer("scan sums", capacity.div_ceil(workgroup * rows) as usize)?;
        Ok(Self { sums, unasked: device.buffer("scan total", 1)?, workgroup, rows })
    }

    /// Records `target[i] = sum of source[..i]` for i < count, and the sum of all into `total[0]` if requested.
    ///
    /// `source` and `target` may be the same buffer. `count` must have been made with [`Scan::block`] among its sizes.
    pub fn record(
        &self,
        recording: &mut Recording,
        count: &Count,
        source: &Buffer<u32>,
        target: &Buffer<u32>,
        total: Option<&Buffer<u32>>,
    ) {
        let total = total.unwrap_or(&self.unasked);
        let blocks = count.groups(self.workgroup * self.rows);
        for (phase, groups) in [(REDUCE, blocks), (SPINE, Groups::Count(1)), (APPLY, blocks)] {
            let spec = ScanSpec { workgroup: self.workgroup, phase, rows: self.rows };
            let kernel = Kernel { count: &count.value, source, sums: &self.sums, target, total, spec };
            recording.dispatch(&kernel, groups);
        }
    }
}
