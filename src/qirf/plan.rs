//! Layout of blocks for the device: batches to assemble, tiles of the matrices, and the arrays.

use crate::gpu::{Buffer, Error, Result};
use crate::kernels::constants::blocks::ROW_SHIFT;
use std::ops::Range;

/// Largest number of members of a batch: at 64 bytes of axes each, well within the size that a kernel can bind.
pub(super) const MOST_MEMBERS: usize = 1 << 18;
/// Largest number of members of a block: row and column of a tile's corner share a word.
pub(super) const LARGEST_BLOCK: usize = 1 << 15;
const _: () = assert!(LARGEST_BLOCK <= 1 << ROW_SHIFT);

/// Number of entries of a packed triangle.
pub const fn triangle(m: usize) -> usize {
    m * (m + 1) / 2
}

/// Successive blocks that are assembled together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Its blocks.
    pub blocks: Range<usize>,
    /// Their members, as positions in the list of all members.
    pub members: Range<usize>,
    pub(super) tiles: Range<usize>,
    /// Number of entries of its packed triangles.
    pub(super) entries: usize,
}

/// Device arrays of the assembly.
pub(super) struct Arrays {
    pub members: Buffer<u32>,
    /// Per block: first member, size, offset of the triangle in its batch, unused.
    pub blocks: Buffer<[u32; 4]>,
    /// Per tile: block; first row and first column.
    pub tiles: Buffer<[u32; 2]>,
    pub axes: Buffer<[f32; 4]>,
    pub responses: Buffer<f32>,
    pub overlaps: Buffer<f32>,
    /// W, m x 8 per block.
    pub factors: Buffer<f32>,
    /// d of each block's two groups of channels.
    pub divisors: Buffer<f32>,
    pub densities: Buffer<f32>,
    /// Rows and columns of a tile.
    pub rows: u32,
    pub columns: u32,
}

/// Blocks and tiles in the layout of the kernels, and their batches.
pub(super) struct Plan {
    pub batches: Vec<Batch>,
    pub blocks: Vec<[u32; 4]>,
    pub tiles: Vec<[u32; 2]>,
}

impl Plan {
    pub fn new(starts: &[u32], batch_bytes: usize, [rows, columns]: [u32; 2]) -> Result<Self> {
        let most = batch_bytes / size_of::<f32>();
        let mut plan = Self { batches: Vec::new(), blocks: Vec::with_capacity(starts.len()), tiles: Vec::new() };
        let mut batch = Batch { blocks: 0..0, members: 0..0, tiles: 0..0, entries: 0 };
        for (b, bounds) in starts.windows(2).enumerate() {
            let m = (bounds[1] - bounds[0]) as usize;
            if m >= LARGEST_BLOCK {
                return Err(Error::TooLarge {
                    name: format!("overlaps of a block of {m} Gaussians"),
                    needed: triangle(m) as u64 * 4,
                    limit: triangle(LARGEST_BLOCK - 1) as u64 * 4,
                    device: "any device".into(),
                });
            }
            let full = batch.entries + triangle(m) > most || batch.members.len() + m > MOST_MEMBERS;
            if full && !batch.blocks.is_empty() {
                let next = Batch {
                    blocks: b..b,
                    members: batch.members.end..batch.members.end,
                    tiles: batch.tiles.end..batch.tiles.end,
                    entries: 0,
                };
                plan.batches.push(std::mem::replace(&mut batch, next));
            }
            plan.blocks.push([bounds[0], m as u32, batch.entries as u32, 0]);
            for row in (0..m as u32).step_by(rows as usize) {
                for column in (0..(row + rows).min(m as u32)).step_by(columns as usize) {
                    plan.tiles.push([b as u32, row << ROW_SHIFT | column]);
                }
            }
            batch.blocks.end = b + 1;
            batch.members.end += m;
            batch.tiles.end = plan.tiles.len();
            batch.entries += triangle(m);
        }
        if !batch.blocks.is_empty() {
            plan.batches.push(batch);
        }
        Ok(plan)
    }
}
