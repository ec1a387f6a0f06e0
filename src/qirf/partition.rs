//! Blocks of Gaussians: voxels of their centres, computed on the host, so that the blocks are the same for every
//! device.
//!
//! A voxel index is floor(x / v) in float64, clamped to int32. Indices are packed with the Gaussian's own into one
//! 128-bit key: x, y, z, Gaussian; sorted, blocks are runs and their members ascend.

use rayon::prelude::*;
use rustc_hash::FxHashSet;
use serde::{Deserialize, Serialize};

use crate::random::mix;

/// Splits with more members than this use two threads.
const PARALLEL: usize = 1 << 15;
/// Search for the voxel edge that gives a wanted occupancy: largest number of steps, and tolerance as the logarithm of
/// a ratio.
const SEARCH: (usize, f64) = (24, 0.02);
/// Levels of parent voxels: after 32 halvings an index is zero.
const LEVELS: u32 = 32;

/// Gaussians grouped by block, each Gaussian in exactly one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Blocks {
    /// Gaussians by block, ascending within each, n.
    pub members: Vec<u32>,
    /// Start of each block in `members`, and the end: blocks + 1 entries.
    pub starts: Vec<u32>,
}

impl Blocks {
    /// Blocks with the given members.
    pub fn of(blocks: impl IntoIterator<Item = impl AsRef<[u32]>>) -> Self {
        let mut out = Self { members: Vec::new(), starts: vec![0] };
        blocks.into_iter().for_each(|block| out.push(block.as_ref()));
        out
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Returns true if there are no blocks.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Gaussians of block `b`.
    pub fn block(&self, b: usize) -> &[u32] {
        &self.members[self.starts[b] as usize..self.starts[b + 1] as usize]
    }

    /// Each block's Gaussians.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        (0..self.len()).map(|b| self.block(b))
    }

    fn push(&mut self, members: &[u32]) {
        self.members.extend_from_slice(members);
        self.starts.push(self.members.len() as u32);
    }
}

/// A rule that makes blocks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Partition {
    /// The paper's rule: voxels of a fixed edge, doubled if there are more than 0.15 blocks per Gaussian.
    Paper {
        /// Edge in world units.
        voxel: f64,
        /// Blocks with more members are split, which limits memory and time; the paper does not do so.
        cap: usize,
    },
    /// Voxels with a wanted mean occupancy; small blocks are joined in parent voxels, large ones are split.
    Adaptive {
        /// Mean members of an occupied voxel.
        mean: usize,
        /// Voxels with fewer members are joined in voxels of twice the edge, until no group is smaller.
        least: usize,
        /// Blocks with more members are split at the median of their longest axis.
        most: usize,
    },
}

/// Blocks per Gaussian above which the paper's voxel is doubled.
pub const SPARSE: f64 = 0.15;

impl Partition {
    /// The paper's parameters.
    pub const PAPER: Self = Self::Paper { voxel: 0.03, cap: 4096 };
    /// The best parameters in measurements.
    pub const ADAPTIVE: Self = Self::Adaptive { mean: 48, least: 8, most: 128 };
}

impl Default for Partition {
    fn default() -> Self {
        Self::ADAPTIVE
    }
}

/// Blocks, and statistics of the partition.
#[derive(Clone, Debug, PartialEq)]
pub struct Partitioned {
    /// The blocks.
    pub blocks: Blocks,
    /// Edge of the finest voxels in world units.
    pub voxel: f64,
    /// True if the paper's voxel was doubled.
    pub doubled: bool,
    /// Gaussians in voxels that were joined because they held too few.
    pub rebinned: usize,
    /// Voxels that were split because they held too many.
    pub split: usize,
    /// Largest number of members of a voxel before splitting.
    pub fullest: usize,
}

impl Partition {
    /// Blocks of Gaussians at `positions` (n, world units); equal positions give equal blocks on every machine.
    ///
    /// NaN positions share the lowest voxel. Only the last remainder of the `Adaptive` rule can stay below its least
    /// occupancy.
    pub fn of(&self, positions: &[[f32; 3]]) -> Partitioned {
        match *self {
            Self::Paper { voxel, cap } => {
                let voxel = if voxel.is_finite() && voxel > 0.0 { voxel } else { 0.03 };
                let mut keys = keys(positions, voxel);
                let sparse = runs(&keys).count() as f64 > SPARSE * positions.len() as f64;
                let edge = if sparse { 2.0 * voxel } else { voxel };
                if sparse {
                    keys = self::keys(positions, edge);
                }
                Partitioned { doubled: sparse, ..gather(positions, keys, edge, 1, cap) }
            }
            Self::Adaptive { mean, least, most } => {
                let edge = occupied_by(positions, mean.max(1) as f64);
                gather(positions, keys(positions, edge), edge, least, most)
            }
        }
    }
}

/// Voxel index of a coordinate, offset so that it can be sorted and halved as an unsigned number.
fn index(x: f32, voxel: f64) -> u32 {
    ((f64::from(x) / voxel).floor() as i32 as u32) ^ (1 << 31)
}

/// x, y and z of the voxel in 96 bits.
fn voxel_of(p: [f32; 3], voxel: f64) -> u128 {
    if p.iter().any(|x| x.is_nan()) {
        return 0;
    }
    p.iter().fold(0, |key, &x| key << 32 | u128::from(index(x, voxel)))
}

fn keys(positions: &[[f32; 3]], voxel: f64) -> Vec<u128> {
    let key = |(i, &p): (usize, &[f32; 3])| voxel_of(p, voxel) << 32 | i as u128;
    let mut keys: Vec<u128> = positions.par_iter().enumerate().map(key).collect();
    keys.par_sort_unstable();
    keys
}

/// The keys, voxel by voxel.
fn runs(keys: &[u128]) -> impl Iterator<Item = &[u128]> {
    keys.chunk_by(|a, b| a >> 32 == b >> 32)
}

/// The key of the voxel of twice the edge.
fn parent(key: u128) -> u128 {
    const LOW: u128 = 0x7fff_ffff_7fff_ffff_7fff_ffff;
    (key >> 33 & LOW) << 32 | key & 0xffff_ffff
}

/// Blocks of sorted keys: groups smaller than `least` are joined in their parents' voxels, those larger than `most` are
/// split.
fn gather(positions: &[[f32; 3]], mut keys: Vec<u128>, voxel: f64, least: usize, most: usize) -> Partitioned {
    let mut blocks = Blocks { members: Vec::with_capacity(keys.len()), starts: vec![0] };
    let (mut rebinned, mut split, mut fullest) = (0, 0, 0);
    let mut members: Vec<u32> = Vec::new();
    for level in 0..=LEVELS {
        let mut few: Vec<u128> = Vec::new();
        for run in runs(&keys) {
            if run.len() < least && level < LEVELS {
                few.extend(run.iter().map(|&key| parent(key)));
                continue;
            }
            members.clear();
            members.extend(run.iter().map(|&key| key as u32));
            fullest = fullest.max(run.len());
            split += usize::from(run.len() > most.max(1));
            let mut rest = members.as_mut_slice();
            for size in halve(rest, positions, most.max(1)) {
                let (block, after) = rest.split_at_mut(size);
                blocks.push(block);
                rest = after;
            }
        }
        if level == 0 {
            rebinned = few.len();
        }
        few.par_sort_unstable();
        keys = few;
    }
    Partitioned { blocks, voxel, doubled: false, rebinned, split, fullest }
}

/// Sorts `members` into groups of at most `most`, each ascending, and returns their sizes in order.
fn halve(members: &mut [u32], positions: &[[f32; 3]], most: usize) -> Vec<usize> {
    let n = members.len();
    if n <= most {
        members.sort_unstable();
        return vec![n];
    }
    let axis = longest_axis(members, positions);
    let coordinate = |i: u32| positions[i as usize][axis];
    // Coincident points differ in their index, so every split is into halves.
    members.select_nth_unstable_by(n / 2, |&a, &b| coordinate(a).total_cmp(&coordinate(b)).then(a.cmp(&b)));
    let (low, high) = members.split_at_mut(n / 2);
    let (mut sizes, upper) = if n > PARALLEL {
        rayon::join(|| halve(low, positions, most), || halve(high, positions, most))
    } else {
        (halve(low, positions, most), halve(high, positions, most))
    };
    sizes.extend(upper);
    sizes
}

fn longest_axis(members: &[u32], positions: &[[f32; 3]]) -> usize {
    let extent = |axis: usize| {
        let finite = members.iter().map(|&i| positions[i as usize][axis]).filter(|x| x.is_finite());
        let (low, high) = finite.fold((f32::MAX, f32::MIN), |(low, high), x| (low.min(x), high.max(x)));
        f64::from(high) - f64::from(low)
    };
    let extents: [f64; 3] = std::array::from_fn(extent);
    (1..3).fold(0, |best, axis| if extents[axis] > extents[best] { axis } else { best })
}

/// The edge at which occupied voxels hold `mean` Gaussians on average, or the closest one found.
fn occupied_by(positions: &[[f32; 3]], mean: f64) -> f64 {
    let mut edge = first_guess(positions, mean);
    let (mut finer, mut coarser) = (0.0_f64, f64::INFINITY);
    let mut best = (f64::INFINITY, edge);
    for _ in 0..SEARCH.0 {
        // Positive if voxels are too full.
        let off = (positions.len().max(1) as f64 / occupied(positions, edge).max(1) as f64 / mean).ln();
        if off.abs() < best.0 {
            best = (off.abs(), edge);
        }
        if off.abs() < SEARCH.1 {
            break;
        }
        if off > 0.0 {
            coarser = coarser.min(edge);
        } else {
            finer = finer.max(edge);
        }
        // Scenes are surfaces: occupancy grows with the square of the edge.
        let step = edge * (-off / 2.0).exp().clamp(1.0 / 16.0, 16.0);
        edge = if step > finer && step < coarser { step } else { (finer * coarser).sqrt() };
        if !(edge.is_finite() && edge > 0.0) {
            break;
        }
    }
    best.1
}

/// A first edge from the spread of the middle nine tenths of a sample, which outliers do not affect.
fn first_guess(positions: &[[f32; 3]], mean: f64) -> f64 {
    let stride = (positions.len() / 4096).max(1);
    let spread = (0..3).map(|axis| {
        let mut sample: Vec<f32> =
            positions.iter().step_by(stride).map(|p| p[axis]).filter(|x| x.is_finite()).collect();
        sample.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| sample.get((sample.len() as f64 * share) as usize).map_or(0.0, |&x| f64::from(x));
        at(0.95) - at(0.05)
    });
    let spread = spread.fold(0.0, f64::max);
    let guess = spread * (mean / positions.len().max(1) as f64).sqrt();
    if guess.is_finite() && guess > 0.0 { guess } else { 1.0 }
}

/// Number of occupied voxels.
fn occupied(positions: &[[f32; 3]], voxel: f64) -> usize {
    type Seen = FxHashSet<u64>;
    let union = |mut a: Seen, mut b: Seen| {
        if a.len() < b.len() {
            std::mem::swap(&mut a, &mut b);
        }
        a.extend(b);
        a
    };
    let seen = |mut seen: Seen, p: &[f32; 3]| {
        let key = voxel_of(*p, voxel);
        seen.insert(mix(mix((key >> 64) as u64) ^ key as u64));
        seen
    };
    positions.par_iter().with_min_len(PARALLEL).fold(Seen::default, seen).reduce(Seen::default, union).len()
}
