//! How large a compressed file may become: one rule for gzip, SPZ, SOG and glTF.

use crate::gaussians::Attributes;

/// Any file may become this large: a model of equal Gaussians compresses to almost nothing.
const FREE: u64 = 64 << 20;
/// Beyond that, a file may become this many times larger. Models take 4 to 7 times the bytes of their SPZ or SOG in memory. Gaussians of
/// SH degree 3 that differ only in position take 17 times those of a gzip PLY, 32 of an SPZ, 56 of a SOG.
const RATIO: u64 = 128;

/// The most bytes of memory that a compressed file of `packed` bytes may fill.
pub(super) fn most(packed: usize) -> u64 {
    (packed as u64).saturating_mul(RATIO).max(FREE)
}

/// True if a file of `packed` bytes may hold `n` Gaussians of this SH degree.
pub(super) fn fits(n: usize, degree: usize, packed: usize) -> bool {
    let row = 4 * Attributes::widths(degree).map(|width| width as u64).sum();
    (n as u64).saturating_mul(row) <= most(packed)
}
