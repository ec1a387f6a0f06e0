//! Assembles the blocks' matrices on the device, batch by batch, while the host works on the previous batch.

use super::overlap::{self, Metric};
use super::plan::{Arrays, Batch, LARGEST_BLOCK, MOST_MEMBERS, Plan, triangle};
use super::rrdm::{self, Density};
use super::{CHANNELS, RENDERING, Row};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Error, Readback, Recording, Result, Timings};
use std::ops::Range;

/// Options of an assembly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Parameters of N.
    pub metric: Metric,
    /// Parameters of W and P; if absent, only N is assembled.
    pub density: Option<Density>,
    /// Bytes of N per batch, which holds at least one block; results do not depend on it.
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

/// Assembles N and, if requested, W and P of all blocks of a partition.
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
    factors: &'a [f32],
    divisors: &'a [f32],
    densities: &'a [f32],
}

/// The matrices of one block of `m` members.
#[derive(Clone, Copy, Debug, Default)]
pub struct BlockMatrices<'a> {
    /// Number of its members.
    pub m: usize,
    /// Lower triangle of N, column by column without gaps: LAPACK's packed "L", m (m + 1) / 2 entries.
    pub overlap: &'a [f32],
    /// W, m x 8, column by column; empty unless [`Options::density`] asks for it.
    pub factor: &'a [f32],
    /// Squares of the divisors that turned the rendering and the optimisation columns of H into W: H = W sqrt(d). Zeros
    /// without W.
    pub divisors: [f32; 2],
    /// Lower triangle of P, packed like N's; empty unless [`Density::full`].
    pub density: &'a [f32],
}

impl BlockMatrices<'_> {
    /// Rows of W, m, widened to float64; values that are not finite count as zero, and their number is returned.
    pub fn rows(&self) -> (Vec<Row>, usize) {
        let mut repaired = 0;
        let mut finite = |x: f32| {
            repaired += usize::from(!x.is_finite());
            if x.is_finite() { f64::from(x) } else { 0.0 }
        };
        let rows = (0..self.m).map(|i| std::array::from_fn(|c| finite(self.factor[c * self.m + i]))).collect();
        (rows, repaired)
    }

    /// Factors, by column, that turn a row of W back into its row of H.
    pub fn scales(&self) -> Row {
        std::array::from_fn(|c| f64::from(self.divisors[c / RENDERING]).sqrt())
    }
}

/// A whole symmetric m x m matrix from its packed lower triangle.
///
/// # Panics
/// If the triangle is too short.
pub fn symmetric<T: From<f32> + Copy + Default>(m: usize, packed: &[f32]) -> Vec<T> {
    let (mut matrix, mut at) = (vec![T::default(); m * m], 0);
    for c in 0..m {
        for r in c..m {
            let value = T::from(packed[at]);
            (matrix[c * m + r], matrix[r * m + c]) = (value, value);
            at += 1;
        }
    }
    matrix
}

impl Assembled<'_> {
    /// The matrices of each block, with its number.
    pub fn iter(&self) -> impl Iterator<Item = (usize, BlockMatrices<'_>)> {
        let first = self.starts[self.blocks.start] as usize;
        let mut at = 0;
        self.blocks.clone().map(move |b| {
            let (start, end) = (self.starts[b] as usize, self.starts[b + 1] as usize);
            let m = end - start;
            let entries = at..at + triangle(m);
            at = entries.end;
            let divisors = self.divisors.as_chunks().0.get(b - self.blocks.start).copied().unwrap_or_default();
            let matrices = BlockMatrices {
                m,
                overlap: &self.overlaps[entries.clone()],
                factor: self.factors.get(CHANNELS * (start - first)..CHANNELS * (end - first)).unwrap_or(&[]),
                divisors,
                density: self.densities.get(entries).unwrap_or(&[]),
            };
            (b, matrices)
        })
    }
}

impl<'a> Assembly<'a> {
    /// Largest number of bytes of an assembly for any partition, including the host memory for its results.
    pub fn bytes(gaussians: usize, options: &Options) -> u64 {
        // At worst each member is a block of its own; blocks of 4,096 members have four tiles of 8 x 64 per member.
        let lists = Buffer::<u32>::bytes_of(gaussians) + Buffer::<[u32; 4]>::bytes_of(gaussians);
        let tiles = Buffer::<[u32; 2]>::bytes_of(4 * gaussians);
        let axes = Buffer::<[f32; 4]>::bytes_of(4 * gaussians.min(MOST_MEMBERS));
        let triangles = (4 * triangle(gaussians.min(LARGEST_BLOCK)) as u64).min(options.batch_bytes as u64);
        let rows = |n: usize| Buffer::<f32>::bytes_of(CHANNELS * n);
        let density = options.density.map_or(0, |density| {
            // W is on the device and twice on the host, and the device's solver has the modes as well.
            rows(gaussians) + 4 * rows(gaussians.min(MOST_MEMBERS)) + if density.full { 3 * triangles } else { 0 }
        });
        lists + tiles + axes + 3 * triangles + density
    }

    /// Allocates memory for the batches of a partition: block `b` has the Gaussians `members[starts[b]..starts[b +
    /// 1]]`.
    ///
    /// `h` holds the rows of H, normalised over the scene, which contain the weights sqrt(eta) and sqrt(1 - eta). It is
    /// not read if only N is requested.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for a block whose triangle a kernel cannot bind (8,191 members at 128 MiB); device memory.
    ///
    /// # Panics
    /// If `starts` does not rise from 0 to the number of members, or if `h` does not hold one row per Gaussian although
    /// W is requested.
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
        let (entries, room, blocks) = (most(|b| b.entries), most(|b| b.members.len()), most(|b| b.blocks.len()));
        let arrays = Arrays {
            members: device.upload("block members", members)?,
            blocks: device.upload("blocks", &plan.blocks)?,
            tiles: device.upload("tiles of blocks", &plan.tiles)?,
            axes: device.buffer("axes", 4 * room)?,
            responses: device.upload("rows of H", h)?,
            overlaps: device.buffer("overlaps", entries)?,
            factors: device.buffer("response factors", if options.density.is_some() { CHANNELS * room } else { 1 })?,
            divisors: device.buffer("divisors of responses", if options.density.is_some() { 2 * blocks } else { 1 })?,
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
    pub fn readback(&self) -> Result<Readback<f32>> {
        let floats = |b: &Batch| self.counts(b).iter().sum();
        self.device.readback("block matrices", self.batches.iter().map(floats).max().unwrap_or(0))
    }

    /// Starts a batch.
    pub fn submit(&self, batch: &Batch, readback: &mut Readback<f32>) -> Result<()> {
        let mut recording = Recording::new();
        self.record(&mut recording, batch);
        let arrays = &self.arrays;
        let [n, w, d, p] = self.counts(batch);
        let from = [(&arrays.overlaps, n), (&arrays.factors, w), (&arrays.divisors, d), (&arrays.densities, p)];
        readback.submit(&self.device, recording, &from)
    }

    pub(super) fn record(&self, recording: &mut Recording, batch: &Batch) {
        let arrays = &self.arrays;
        recording.scope("overlap", |r| overlap::record(r, arrays, self.model, batch, &self.options.metric));
        if let Some(density) = &self.options.density {
            recording.scope("rrdm", |r| rrdm::record(r, arrays, batch, density));
        }
    }

    /// Floats of N, W, its divisors and P of a batch.
    fn counts(&self, batch: &Batch) -> [usize; 4] {
        let if_asked = |asked: bool, count: usize| if asked { count } else { 0 };
        let density = self.options.density.is_some();
        [
            batch.entries,
            if_asked(density, CHANNELS * batch.members.len()),
            if_asked(density, 2 * batch.blocks.len()),
            if_asked(self.options.wants_full(), batch.entries),
        ]
    }

    /// The matrices within the values of a batch.
    fn matrices<'b>(&'b self, batch: &Batch, values: &'b [f32]) -> Assembled<'b> {
        let [n, w, d, p] = self.counts(batch);
        let (overlaps, rest) = values.split_at(n);
        let (factors, rest) = rest.split_at(w);
        let (divisors, rest) = rest.split_at(d);
        let densities = &rest[..p];
        Assembled { starts: &self.starts, blocks: batch.blocks.clone(), overlaps, factors, divisors, densities }
    }

    /// Calls `body` with every batch, in order, while the device assembles the next one. Returns the device times.
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
