//! Ordered sums over contiguous segments.

use super::WORKGROUP;
use super::count::Count;
use crate::gpu::{Buffer, Recording};
use crate::kernels::primitives::{SegmentedSum, SegmentedSumSpec};

/// Records, for each of `count` segments, the sum of its rows of `width` floats: rows `starts[s]..starts[s] + lengths[s]`.
///
/// Rows are added in their order, so that the result is the same bits run after run.
pub fn segmented_sum(
    recording: &mut Recording,
    count: &Count,
    starts: &Buffer<u32>,
    lengths: &Buffer<u32>,
    rows: &Buffer<f32>,
    sums: &Buffer<f32>,
    width: u32,
) {
    let spec = SegmentedSumSpec { workgroup: WORKGROUP, width };
    let kernel = SegmentedSum { count: &count.value, starts, lengths, rows, sums, spec };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
}
