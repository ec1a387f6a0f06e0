//! Stream compaction.

use super::WORKGROUP;
use super::count::Count;
use crate::gpu::{Buffer, Recording};
use crate::kernels::primitives::{Compact, CompactSpec};

/// Records `indices = [i for i < count if flags[i] != 0]`, in order; `offsets` is the scan of `flags`.
pub fn compact(
    recording: &mut Recording,
    count: &Count,
    flags: &Buffer<u32>,
    offsets: &Buffer<u32>,
    indices: &Buffer<u32>,
) {
    let kernel = Compact { count: &count.value, flags, offsets, indices, spec: CompactSpec { workgroup: WORKGROUP } };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
}
