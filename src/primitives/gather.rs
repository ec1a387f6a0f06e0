//! Gather by index.

use super::WORKGROUP;
use super::count::Count;
use crate::gpu::{Buffer, Recording};
use crate::kernels::primitives::{Gather, GatherSpec};

/// Records `target[i] = source[indices[i]]` for i < count.
pub fn gather(
    recording: &mut Recording,
    count: &Count,
    indices: &Buffer<u32>,
    source: &Buffer<u32>,
    target: &Buffer<u32>,
) {
    let kernel = Gather { count: &count.value, indices, source, target, spec: GatherSpec { workgroup: WORKGROUP } };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
}
