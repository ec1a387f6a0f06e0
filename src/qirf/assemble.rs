//! Assembles the blocks' matrices on the device, batch by batch, while the host works on the previous batch.

use super::CHANNELS;
use super::overlap::{self, Metric};
use super::plan::{Arrays, Batch, LARGEST_BLOCK, MOST_MEMBERS, Plan, triangle};
use super::rrdm::{self, Density};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Error, Readback, Recording, Result, Timings};
use std::ops::Range;

/// Options of an assembly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Parameters of N.
    pub metric: Metric,
    /// Parameters of W and P; without them only N is assembled.
    pub density: Option<Density>,
    /// Bytes of N in a batch, which holds at least one block; results do not depend on it.
    pub batch_bytes: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { metric: Metric::default(), density: None, batch_bytes: 64 << 20 }
    }
}

impl Options {
    fn wants_full(&self) -> bool {
        self.density.is_some_and(|d| d.full)
    }
}

/// Assembles N, and if asked for W and P, of all blocks of a partition.
pub struct Assembly<'a> {
    pub(super) device: Device,
    model: &'a Resident,
    pub(super) options: Options,
    pub(super) starts: Vec<u32>,
    batches: Vec<Batch>,
    pub(super) arrays: Arrays,
}

/// The matrices of one batch, on the host.
pub struct Assembled<'a> {
    starts: &'a [u32],
    blocks: Range<usize>,
    overlaps: &'a [f32],
    factors: Option<&'a [f32]>,
    densities: Option<&'a [f32]>,
}

/// The matrices of one block of `m` members.
#[derive(Clone, Copy, Debug)]
pub struct BlockMatrices<'a> {
    /// Its members.
    pub m: usize,
    /// Lower triangle of N, column by column without gaps: LAPACK's packed "L", m (m + 1) / 2 entries.
    pub overlap: &'a [f32],
    /// W, m x 8, column by column; only if [`Options::density`] asks for it.
    pub factor: Option<&'a [f32]>,
    /// Lower triangle of P, packed as that of N; only if [`Density::full`].
    pub density: Option<&'a [f32]>,
}

/// Writes a packed lower triangle into the lower triangle of an m x m matrix, column by column (LAPACK's "L"). The upper one
/// stays unchanged: a Cholesky factorisation does not read it.
///
/// # Panics
/// If a slice is too short.
pub fn unpack_lower<T: From<f32>>(m: usize, packed: &[f32], out: &mut [T]) {
    let mut at = 0;
    for c in 0..m {
        let column = &packed[at..at + m - c];
        out[c * m + c..(c + 1) * m].iter_mut().zip(column).for_each(|(o, v)| *o = T::from(*v));
        at += m - c;
    }
}

/// Writes a packed lower triangle into a whole symmetric m x m matrix.
///
/// # Panics
/// If a slice is too short.
pub fn unpack_symmetric<T: From<f32> + Copy>(m: usize, packed: &[f32], out: &mut [T]) {
    unpack_lower(m, packed, out);
    for c in 0..m {
        for r in c + 1..m {
            out[r * m + c] = out[c * m + r];
        }
    }
}

impl Assembled<'_> {
    /// The batch's blocks, as numbers in the partition.
    pub fn blocks(&self) -> Range<usize> {
        self.blocks.clone()
    }

    /// The matrices of each block, with its number.
    pub fn iter(&self) -> impl Iterator<Item = (usize, BlockMatrices<'_>)> {
        let first = self.starts[self.blocks.start] as usize;
        let mut at = 0;
        self.blocks.clone().map(move |b| {
            let (start, end) = (self.starts[b] as usize, self.starts[b + 1] as usize);
            let m = end - start;
            let entries = at..at + triangle(m);
            at = entries.end;
            let matrices = BlockMatrices {
                m,
                overlap: &self.overlaps[entries.clone()],
                factor: self.factors.map(|w| &w[CHANNELS * (start - first)..CHANNELS * (end - first)]),
                density: self.densities.map(|d| &d[entries]),
            };
            (b, matrices)
        })
    }
}

impl<'a> Assembly<'a> {
    /// Largest number of bytes of the assembly of N for any partition, including the host memory for its results.
    pub fn bytes(gaussians: usize, options: &Options) -> u64 {
        // At worst each member is a block of its own; blocks of 4,096 members have four tiles of 8 x 64 per member.
        let lists = Buffer::<u32>::bytes_of(gaussians) + Buffer::<[u32; 4]>::bytes_of(gaussians);
        let tiles = Buffer::<[u32; 2]>::bytes_of(4 * gaussians);
        let axes = Buffer::<[f32; 4]>::bytes_of(4 * gaussians.min(MOST_MEMBERS));
        let batch = (4 * triangle(gaussians.min(LARGEST_BLOCK)) as u64).min(options.batch_bytes as u64);
        lists + tiles + axes + 3 * batch
    }

    /// Allocates memory for the batches of a partition: block `b` has the Gaussians `members[starts[b]..starts[b + 1]]`.
    ///
    /// `h` holds the rows of H, normalised over the scene, which contain the weights sqrt(eta) and sqrt(1 - eta). It is not
    /// read if only N is asked for.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for a block whose triangle a kernel cannot bind (8,191 members at 128 MiB); device memory.
    ///
    /// # Panics
    /// If `starts` does not rise from 0 to the number of members, or if `h` does not hold one row per Gaussian although W is
    /// asked for.
    pub fn new(
        device: &Device,
        model: &'a Resident,
        members: &[u32],
        starts: &[u32],
        h: &[[f32; CHANNELS]],
        options: Options,
    ) -> Result<Self> {
        assert!(starts.first() == Some(&0) && starts.is_sorted(), "block starts rise from 0");
        assert_eq!(starts.last().map(|s| *s as usize), Some(members.len()), "the last block ends with the members");
        let h: &[f32] = options.density.map_or(&[0.0], |_| h.as_flattened());
        assert!(options.density.is_none() || h.len() == CHANNELS * model.len, "one row a Gaussian");
        assert!(members.iter().all(|i| (*i as usize) < model.len), "members are Gaussians of the model");
        let (rows, columns) = (device.info().subgroup_size, device.tuning().overlap_columns);
        let plan = Plan::new(starts, options.batch_bytes, [rows, columns])?;
        let most = |f: fn(&Batch) -> usize| plan.batches.iter().map(f).max().unwrap_or(0);
        let (entries, room) = (most(|b| b.entries), most(|b| b.members.len()));
        let arrays = Arrays {
            members: device.upload("block members", members)?,
            blocks: device.upload("blocks", &plan.blocks)?,
            tiles: device.upload("tiles of blocks", &plan.tiles)?,
            axes: device.buffer("axes", 4 * room)?,
            responses: device.upload("rows of H", h)?,
            overlaps: device.buffer("overlaps", entries)?,
            factors: device.buffer("response factors", if options.density.is_some() { CHANNELS * room } else { 1 })?,
            densities: device.buffer("density matrices", if options.wants_full() { entries } else { 1 })?,
            rows,
            columns,
        };
        let starts = starts.to_vec();
        Ok(Self { device: device.clone(), model, options, starts, batches: plan.batches, arrays })
    }

    /// The batches, in order.
    pub fn batches(&self) -> &[Batch] {
        &self.batches
    }

    /// Host memory for the matrices of one batch.
    ///
    /// # Errors
    /// Memory.
    pub fn readback(&self) -> Result<Readback<f32>> {
        let floats = |b: &Batch| self.counts(b).iter().sum();
        self.device.readback("block matrices", self.batches.iter().map(floats).max().unwrap_or(0))
    }

    /// Starts a batch.
    ///
    /// # Errors
    /// Device errors.
    pub fn submit(&self, batch: &Batch, readback: &mut Readback<f32>) -> Result<()> {
        let mut recording = Recording::new();
        self.record(&mut recording, batch);
        let arrays = &self.arrays;
        let [n, w, p] = self.counts(batch);
        let from = [(&arrays.overlaps, n), (&arrays.factors, w), (&arrays.densities, p)];
        readback.submit(&self.device, recording, &from)
    }

    pub(super) fn record(&self, recording: &mut Recording, batch: &Batch) {
        let arrays = &self.arrays;
        recording.scope("overlap", |r| overlap::record(r, arrays, self.model, batch, &self.options.metric));
        if let Some(density) = &self.options.density {
            recording.scope("rrdm", |r| rrdm::record(r, arrays, batch, density));
        }
    }

    /// Floats of N, W and P of a batch.
    fn counts(&self, batch: &Batch) -> [usize; 3] {
        let w = if self.options.density.is_some() { CHANNELS * batch.members.len() } else { 0 };
        let p = if self.options.wants_full() { batch.entries } else { 0 };
        [batch.entries, w, p]
    }

    /// The matrices within the values of a batch.
    fn matrices<'b>(&'b self, batch: &Batch, values: &'b [f32]) -> Assembled<'b> {
        let [n, w, p] = self.counts(batch);
        let (overlaps, rest) = values.split_at(n);
        let (factors, rest) = rest.split_at(w);
        let factors = self.options.density.map(|_| factors);
        let densities = self.options.wants_full().then(|| &rest[..p]);
        Assembled { starts: &self.starts, blocks: batch.blocks.clone(), overlaps, factors, densities }
    }

    /// Calls `body` with every batch, in order, while the device assembles the next one. Returns the device times.
    ///
    /// # Errors
    /// Device errors; the first error of `body`.
    pub fn for_each<E: From<Error>>(
        &self,
        mut body: impl FnMut(&Assembled<'_>) -> std::result::Result<(), E>,
    ) -> std::result::Result<Timings, E> {
        let readbacks = [self.readback()?, self.readback()?];
        let submit = |batch: &Batch, readback: &mut Readback<f32>| self.submit(batch, readback);
        self.overlapped(readbacks, submit, |batch, values| body(&self.matrices(batch, values)))
    }

    /// Submits every batch before `body` is called with the results of the previous one.
    pub(super) fn overlapped<E: From<Error>>(
        &self,
        mut readbacks: [Readback<f32>; 2],
        submit: impl Fn(&Batch, &mut Readback<f32>) -> Result<()>,
        mut body: impl FnMut(&Batch, &[f32]) -> std::result::Result<(), E>,
    ) -> std::result::Result<Timings, E> {
        let mut timings = Timings::default();
        if let Some(first) = self.batches.first() {
            submit(first, &mut readbacks[0])?;
        }
        for (b, batch) in self.batches.iter().enumerate() {
            if let Some(next) = self.batches.get(b + 1) {
                submit(next, &mut readbacks[(b + 1) % 2])?;
            }
            let (values, times) = readbacks[b % 2].wait()?;
            timings.merge(&times);
            body(batch, values)?;
        }
        Ok(timings)
    }
}
