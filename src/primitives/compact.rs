//! Stream compaction.

use super::count::Count;
use super::scan::Scan;
use super::sort::Pairs;
use crate::gpu::{Buffer, Recording};
use crate::kernels::constants::scan::APPLY;
use crate::kernels::primitives::{Compact, CompactPush, CompactSpec};

/// Records `kept` = the pairs (`keys[i]`, i) for i < count with `flags[i]` = 1 (else 0), in order, and sets `total` to
/// their number.
///
/// `count` must have been made with [`Scan::block`] among its sizes.
pub fn compact(
    recording: &mut Recording,
    scan: &Scan,
    count: &Count,
    [flags, keys]: [&Buffer<u32>; 2],
    kept: &Pairs,
    total: &Count,
) {
    scan.blocks(recording, count, flags.into(), flags, total);
    let [value, arguments] = scan.set_in(APPLY, total);
    let kernel = Compact {
        count: &count.value,
        flags,
        sums: &scan.sums,
        keys,
        kept_keys: &kept.keys,
        kept: &kept.values,
        value,
        arguments,
        push: CompactPush { limit: total.limit, sizes: total.sizes },
        spec: CompactSpec { workgroup: scan.workgroup, rows: scan.rows, few_blocks: scan.few_blocks },
    };
    recording.dispatch(&kernel, count.groups(scan.workgroup * scan.rows));
}
