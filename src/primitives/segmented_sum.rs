//! Ordered sums over contiguous segments.

use super::WORKGROUP;
use super::count::Count;
use crate::gpu::{Buffer, Recording};
use crate::kernels::primitives::{SegmentedSum, SegmentedSumSpec};

/// Range of each segment's rows: `starts[s]..starts[s] + lengths[s]`.
#[derive(Clone, Copy)]
pub struct Segments<'a> {
    /// First row of each.
    pub starts: &'a Buffer<u32>,
    /// Number of rows of each.
    pub lengths: &'a Buffer<u32>,
}

/// Records, for each of `count` segments, the sum of its rows of `width` floats.
///
/// Rows are added in their order, so that results are bit-identical from run to run.
pub fn segmented_sum(
    recording: &mut Recording,
    count: &Count,
    segments: Segments<'_>,
    rows: &Buffer<f32>,
    sums: &Buffer<f32>,
    width: u32,
) {
    let Segments { starts, lengths } = segments;
    let spec = SegmentedSumSpec { workgroup: WORKGROUP, width };
    let kernel = SegmentedSum { count: &count.value, starts, lengths, rows, sums, spec };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
}
