//! Binning: (tile, slot) pairs in depth order, then by tile, and the start of each tile's range.

use super::frame::{Frame, Launch};
use crate::gaussians::resident::Resident;
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{Bin, BinSpec, Ranges, RangesPush, RangesSpec};
use crate::primitives::{Pairs, WORKGROUP, Words, compact, gather};

/// Records the list of visible Gaussians, nearest first; equal depths keep the order of the model. If tiles have a
/// depth order of their own, the whole list keeps the order of the model.
pub(super) fn depth_sort<'a>(
    recording: &mut Recording,
    launch: &Launch,
    frame: &'a Frame,
    model: &Resident,
) -> &'a Pairs {
    let visible = [&frame.visible, &frame.depth];
    compact(recording, &frame.scan, &model.count, visible, &frame.by_depth, &frame.visible_count);
    if launch.settings.style.depth_order {
        return &frame.by_depth;
    }
    frame.depth_sort.record(recording, &frame.visible_count, &frame.by_depth, 32)
}

/// Records the pairs of all visible Gaussians, in depth order.
pub(super) fn record(recording: &mut Recording, launch: &Launch, frame: &Frame, model: &Resident, order: &Pairs) {
    let pairs = &frame.pairs;
    // If tiles have a depth order of their own, the keys of the first sort are depths.
    let (keys, depths) = (pairs.tiles.as_ref().unwrap_or(&pairs.by_tile.keys), &pairs.by_tile.keys);
    let tile_counts = Words { source: &frame.tile_counts, indices: Some(&order.values) };
    frame.scan.record(recording, &frame.visible_count, tile_counts, &frame.offsets, &pairs.count);
    let kernel = Bin {
        view: &frame.view,
        count: &frame.visible_count.value,
        pairs: &pairs.count.value,
        order: &order.values,
        offsets: &frame.offsets,
        tile_counts: &frame.tile_counts,
        geometry: &frame.geometry,
        shape: &frame.shape,
        keys,
        slots: &pairs.by_tile.values,
        owners: &pairs.owners,
        first_slots: &frame.first_slots,
        depths,
        means: &model.parameters.means,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        spec: BinSpec {
            workgroup: WORKGROUP,
            tile: launch.tuning.tile,
            culling: launch.settings.culling as u32,
            depth_order: launch.settings.style.depth_order,
            many: launch.tuning.bin_many,
        },
    };
    recording.dispatch(&kernel, frame.visible_count.groups(WORKGROUP));
}

/// Records the stable sort of pairs by the depth that each tile sees, if tiles have a depth order of their own.
pub(super) fn depth_order(recording: &mut Recording, frame: &Frame) {
    let pairs = &frame.pairs;
    let Some(tiles) = &pairs.tiles else { return };
    recording.scope("depth order", |r| {
        let sorted = pairs.sort.record(r, &pairs.count, &pairs.by_tile, 32);
        gather(r, &pairs.count, &sorted.values, tiles, &sorted.keys);
    });
}

/// Number of bits of a tile key: the largest key is `tiles`, which marks pairs without a tile.
fn key_bits(tiles: u32) -> u32 {
    32 - tiles.leading_zeros()
}

/// The pairs, once sorted by tile.
pub(super) fn sorted(frame: &Frame, tiles: u32) -> &Pairs {
    frame.pairs.sort.sorted(&frame.pairs.by_tile, key_bits(tiles))
}

/// Records the stable sort by tile, and the tiles' ranges.
pub(super) fn tile_sort(recording: &mut Recording, frame: &Frame, tiles: u32) {
    let pairs = &frame.pairs;
    let sorted = pairs.sort.record(recording, &pairs.count, &pairs.by_tile, key_bits(tiles));
    let kernel = Ranges {
        pairs: &pairs.count.value,
        keys: &sorted.keys,
        starts: &frame.starts,
        push: RangesPush { tiles },
        spec: RangesSpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, Groups::Count((tiles + 1).div_ceil(WORKGROUP)));
}
