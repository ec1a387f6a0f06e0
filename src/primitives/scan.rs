//! Exclusive prefix sum of 32-bit words.

use super::count::Count;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::scan::{APPLY, REDUCE, SPINE};
use crate::kernels::primitives::{Scan as Kernel, ScanPush, ScanSpec};

/// Largest number of blocks that each sum all previous ones: a workgroup then reads 16 KiB. More blocks take a phase of
/// their own.
const FEW_BLOCKS: u32 = 4096;

/// Scratch memory and layout of a prefix sum over at most a given number of words.
pub struct Scan {
    /// Sums of blocks if these are few; otherwise of all previous blocks.
    pub(super) sums: Buffer<u32>,
    pub(super) few_blocks: bool,
    pub(super) workgroup: u32,
    pub(super) rows: u32,
}

/// Words to scan.
#[derive(Clone, Copy)]
pub struct Words<'a> {
    /// The array that they are in.
    pub source: &'a Buffer<u32>,
    /// Their positions in it, if they are not simply its first words.
    pub indices: Option<&'a Buffer<u32>>,
}

/// Data that phases share.
#[derive(Clone, Copy)]
struct Job<'a> {
    count: &'a Count,
    words: Words<'a>,
    target: &'a Buffer<u32>,
    total: &'a Count,
}

impl Scan {
    /// Words that one workgroup scans on this device.
    pub fn block(device: &Device) -> u32 {
        device.tuning().scan_workgroup * device.tuning().scan_rows
    }

    /// Scratch memory for scans of up to `capacity` words.
    pub fn new(device: &Device, capacity: u32) -> Result<Self> {
        let (workgroup, rows) = (device.tuning().scan_workgroup, device.tuning().scan_rows);
        let blocks = capacity.div_ceil(workgroup * rows);
        let sums = device.buffer("scan sums", blocks as usize)?;
        Ok(Self { sums, few_blocks: blocks <= FEW_BLOCKS, workgroup, rows })
    }

    /// Records `target[i] = sum of words[..i]` for i < count, and sets `total` to the sum of all.
    ///
    /// `count` must have been made with [`Scan::block`] among its sizes. `target` may be the source, unless words have indices.
    pub fn record(
        &self,
        recording: &mut Recording,
        count: &Count,
        words: Words<'_>,
        target: &Buffer<u32>,
        total: &Count,
    ) {
        self.blocks(recording, count, words, target, total);
        self.phase(recording, APPLY, Job { count, words, target, total });
    }

    /// Records the phases before the last: sums of blocks and, if these are many, of all previous blocks and the total.
    /// Words with indices are left in `target`.
    pub(super) fn blocks(
        &self,
        recording: &mut Recording,
        count: &Count,
        words: Words<'_>,
        target: &Buffer<u32>,
        total: &Count,
    ) {
        for phase in [REDUCE, SPINE].into_iter().filter(|phase| *phase != SPINE || !self.few_blocks) {
            self.phase(recording, phase, Job { count, words, target, total });
        }
    }

    /// The buffers that a phase binds for the total: the total's own in the phase that sets it, placeholders in the
    /// others.
    pub(super) fn set_in<'a>(&'a self, phase: u32, total: &'a Count) -> [&'a Buffer<u32>; 2] {
        if phase == if self.few_blocks { APPLY } else { SPINE } {
            [&total.value, &total.arguments]
        } else {
            [&self.sums; 2]
        }
    }

    fn phase(&self, recording: &mut Recording, phase: u32, job: Job<'_>) {
        let Job { count, words: Words { source, indices }, target, total } = job;
        let gather = indices.is_some();
        // Each phase binds the arrays that it reads and writes, with small ones that are bound anyway as placeholders.
        let (reads, writes) = match phase {
            REDUCE => (true, gather),
            APPLY => (!gather, true),
            _ => (false, false),
        };
        let [value, arguments] = self.set_in(phase, total);
        let kernel = Kernel {
            count: &count.value,
            indices: indices.filter(|_| phase == REDUCE).unwrap_or(&count.value),
            source: if reads { source } else { &count.value },
            sums: &self.sums,
            target: if writes { target } else { &self.sums },
            value,
            arguments,
            push: ScanPush { limit: total.limit, sizes: total.sizes },
            spec: ScanSpec { workgroup: self.workgroup, phase, rows: self.rows, gather, few_blocks: self.few_blocks },
        };
        let blocks = count.groups(self.workgroup * self.rows);
        recording.dispatch(&kernel, if phase == SPINE { Groups::Count(1) } else { blocks });
    }
}

impl<'a> From<&'a Buffer<u32>> for Words<'a> {
    fn from(source: &'a Buffer<u32>) -> Self {
        Self { source, indices: None }
    }
}
