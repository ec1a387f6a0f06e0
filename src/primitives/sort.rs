//! Stable radix sort of 32-bit keys with 32-bit values, over the given number of low bits.

use super::count::Count;
use super::scan::Scan;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::constants::sort::{COUNT_DIGITS, SCATTER};
use crate::kernels::primitives::{Sort as Kernel, SortPush, SortSpec};

/// Largest width of a digit in bits.
const DIGIT_BITS: u32 = 8;

/// Keys with their values.
#[derive(Clone)]
pub struct Pairs {
    /// Sort keys.
    pub keys: Buffer<u32>,
    /// Values that move with the keys.
    pub values: Buffer<u32>,
}

impl Pairs {
    /// Bytes of [`Pairs::new`].
    pub fn bytes(capacity: u32) -> u64 {
        2 * Buffer::<u32>::bytes_of(capacity as usize)
    }

    /// Room for `capacity` pairs.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, name: &str, capacity: u32) -> Result<Self> {
        let room = || device.buffer(name, capacity as usize);
        Ok(Self { keys: room()?, values: room()? })
    }
}

/// Scratch memory and layout of a sort of at most a given number of pairs.
pub struct Sort {
    other: Pairs,
    digits: Buffer<u32>,
    digit_count: Count,
    scan: Scan,
    shape: Shape,
}

#[derive(Clone, Copy)]
struct Shape {
    workgroup: u32,
    rows: u32,
    serial: bool,
}

impl Shape {
    fn of(device: &Device, capacity: u32) -> Self {
        let tuning = device.tuning();
        let workgroup = tuning.sort_workgroup;
        let rows = (capacity / (workgroup * tuning.sort_workgroups))
            .clamp(tuning.sort_rows_min, tuning.sort_rows_max)
            .next_power_of_two();
        Self { workgroup, rows, serial: tuning.sort_serial }
    }

    fn block(self) -> u32 {
        self.workgroup * self.rows
    }

    /// Counters of all blocks of a sort.
    fn digits(self, capacity: u32) -> u32 {
        capacity.div_ceil(self.block()).max(1) << DIGIT_BITS
    }
}

/// Bits of a key that one pass sorts by.
#[derive(Clone, Copy)]
struct Digit {
    shift: u32,
    width: u32,
}

impl Sort {
    /// Pairs that one workgroup takes, for sorts of this capacity on this device.
    pub fn block(device: &Device, capacity: u32) -> u32 {
        Shape::of(device, capacity).block()
    }

    /// Bytes of [`Sort::new`].
    pub fn bytes(device: &Device, capacity: u32) -> u64 {
        let digits = Shape::of(device, capacity).digits(capacity);
        Pairs::bytes(capacity) + Buffer::<u32>::bytes_of(digits as usize) + Count::bytes() + Scan::bytes(device, digits)
    }

    /// Scratch for sorts of up to `capacity` pairs.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, capacity: u32) -> Result<Self> {
        let shape = Shape::of(device, capacity);
        let digits = shape.digits(capacity);
        Ok(Self {
            other: Pairs::new(device, "sort scratch", capacity)?,
            digits: device.buffer("sort digits", digits as usize)?,
            digit_count: Count::new(device, "sort digit count", digits, &[Scan::block(device)])?,
            scan: Scan::new(device, digits)?,
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
        let kernel = |phase| Kernel {
            count: &count.value,
            keys_in: &from.keys,
            values_in: &from.values,
            digits: &self.digits,
            keys_out: &to.keys,
            values_out: &to.values,
            push: SortPush { shift },
            spec: SortSpec {
                workgroup: self.shape.workgroup,
                phase,
                rows: self.shape.rows,
                digit_bits: width,
                serial: self.shape.serial,
            },
        };
        let groups = count.groups(self.shape.block());
        recording.dispatch(&kernel(COUNT_DIGITS), groups);
        self.digit_count.derive(recording, count, self.shape.block(), 1 << width);
        self.scan.record(recording, &self.digit_count, &self.digits, &self.digits, None);
        recording.dispatch(&kernel(SCATTER), groups);
    }
}
