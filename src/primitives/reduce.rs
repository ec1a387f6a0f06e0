//! Ordered sum of an array.

use super::WORKGROUP;
use crate::gpu::{Buffer, Groups, Recording};
use crate::kernels::primitives::{Reduce, ReducePush, ReduceSpec};

/// Records `sum[0]` = sum of the first `count` elements, component by component, in a fixed order.
pub fn reduce(recording: &mut Recording, source: &Buffer<[f32; 4]>, count: u32, sum: &Buffer<[f32; 4]>) {
    let kernel = Reduce { source, sum, push: ReducePush { count }, spec: ReduceSpec { workgroup: WORKGROUP } };
    recording.dispatch(&kernel, Groups::Count(1));
}
