//! Stable radix sort of 32-bit keys with 32-bit values, over the given number of low bits.

use super::count::Count;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::sort::{COUNT_DIGITS, SCAN_DIGITS, SCATTER};
use crate::kernels::primitives::{Sort as Kernel, SortPush, SortSpec};

/// Largest width of a digit in bits.
const DIGIT_BITS: u32 = 8;
/// Largest number of blocks that each sum the counts of all previous ones, 1 KiB per block. More blocks take a phase of
/// their own, and sort their keys in shared memory before writing them.
const FEW_BLOCKS: u32 = 128;

/// Keys with their values.
#[derive(Clone)]
pub struct Pairs {
    /// Sort keys.
    pub keys: Buffer<u32>,
    /// Values that move with the keys.
    pub values: Buffer<u32>,
}

impl Pairs {
    /// Room for `capacity` pairs.
    pub fn new(device: &Device, name: &str, capacity: u32) -> Result<Self> {
        let room = || device.buffer(name, capacity as usize);
        Ok(Self { keys: room()?, values: room()? })
    }
}

/// Scratch memory and layout of a sort of at most a given number of pairs.
pub struct Sort {
    other: Pairs,
    digits: Buffer<u32>,
    shape: Shape,
}

#[derive(Clone, Copy)]
struct Shape {
    workgroup: u32,
    subgroup: u32,
    rows: u32,
    serial: bool,
    few_blocks: bool,
    staged: bool,
}

impl Shape {
    fn of(device: &Device, capacity: u32) -> Self {
        let tuning = device.tuning();
        let workgroup = tuning.sort_workgroup;
        let rows = (capacity / (workgroup * tuning.sort_workgroups))
            .clamp(tuning.sort_rows_min, tuning.sort_rows_max)
            .next_power_of_two();
        let serial = tuning.sort_serial;
        let few_blocks = !serial && capacity.div_ceil(workgroup * rows) <= FEW_BLOCKS;
        // A block's words reuse the space of its counters.
        let staged = !serial && !few_blocks && workgroup * rows <= (workgroup / tuning.subgroup) << DIGIT_BITS;
        Self { workgroup, subgroup: tuning.subgroup, rows, serial, few_blocks, staged }
    }

    fn block(self) -> u32 {
        self.workgroup * self.rows
    }

    /// Counters of all blocks of a sort, and of their sums.
    fn digits(self, capacity: u32) -> u32 {
        (capacity.div_ceil(self.block()) + 1) << DIGIT_BITS
    }

    /// Units of a workgroup, each of which ranks a run of keys.
    fn units(self) -> u32 {
        if self.serial { self.workgroup } else { self.workgroup / self.subgroup }
    }
}

/// Bits of a key that one pass sorts by.
#[derive(Clone, Copy)]
struct Digit {
    shift: u32,
    width: u32,
}

impl Sort {
    /// Pairs per workgroup, for sorts of this capacity on this device.
    pub fn block(device: &Device, capacity: u32) -> u32 {
        Shape::of(device, capacity).block()
    }

    /// Scratch memory for sorts of up to `capacity` pairs.
    pub fn new(device: &Device, capacity: u32) -> Result<Self> {
        let shape = Shape::of(device, capacity);
        let digits = shape.digits(capacity);
        Ok(Self {
            other: Pairs::new(device, "sort scratch", capacity)?,
            digits: device.buffer("sort digits", digits as usize)?,
            shape,
        })
    }

    /// Records a stable sort by the lowest `bits` bits of the keys; returns the result, which may lie in scratch
    /// memory.
    ///
    /// `count` must have been made with [`Sort::block`] among its sizes. If `bits` is 0, nothing is recorded.
    pub fn record<'a>(&'a self, recording: &mut Recording, count: &Count, pairs: &'a Pairs, bits: u32) -> &'a Pairs {
        let passes = bits.div_ceil(DIGIT_BITS);
        let (mut from, mut to) = (pairs, &self.other);
        let mut shift = 0;
        for pass in 0..passes {
            // Passes of even width: 11 bits are 6 and 5, not 8 and 3.
            let width = (bits - shift).div_ceil(passes - pass);
            self.pass(recording, count, from, to, Digit { shift, width });
            shift += width;
            std::mem::swap(&mut from, &mut to);
        }
        from
    }

    /// The buffers in which [`Sort::record`] leaves the result of sorting by `bits` bits.
    pub fn sorted<'a>(&'a self, pairs: &'a Pairs, bits: u32) -> &'a Pairs {
        if bits.div_ceil(DIGIT_BITS).is_multiple_of(2) { pairs } else { &self.other }
    }

    fn pass(&self, recording: &mut Recording, count: &Count, from: &Pairs, to: &Pairs, digit: Digit) {
        let Digit { shift, width } = digit;
        let Shape { workgroup, rows, serial, few_blocks, staged, .. } = self.shape;
        let blocks = count.groups(self.shape.block());
        // Serial kernels get rows and bits as push constants; for the others they are constants, so that loops can be unrolled.
        let (constant_rows, constant_bits) = if serial { (1, DIGIT_BITS) } else { (rows, width) };
        let by_digit = Groups::Count((1_u32 << width).div_ceil(self.shape.units()));
        let phases = [(COUNT_DIGITS, blocks), (SCAN_DIGITS, by_digit), (SCATTER, blocks)];
        for (phase, groups) in phases.into_iter().filter(|(phase, _)| *phase != SCAN_DIGITS || !few_blocks) {
            // Each phase binds the arrays that it reads and writes, with small ones that are bound anyway as
            // placeholders.
            let read = |there: bool, buffer| if there { buffer } else { &count.value };
            let written = |buffer| if phase == SCATTER { buffer } else { &self.digits };
            let kernel = Kernel {
                count: &count.value,
                keys_in: read(phase != SCAN_DIGITS, &from.keys),
                values_in: read(phase == SCATTER, &from.values),
                digits: &self.digits,
                keys_out: written(&to.keys),
                values_out: written(&to.values),
                push: SortPush { shift, serial_rows: rows, serial_bits: width },
                spec: SortSpec {
                    workgroup,
                    phase,
                    rows: constant_rows,
                    digit_bits: constant_bits,
                    serial,
                    few_blocks,
                    staged,
                },
            };
            recording.dispatch(&kernel, groups);
        }
    }
}
