//! Binning: (tile, slot) pairs in depth order, then by tile, and where each tile's begin.

use super::frame::{Frame, Shape};
use crate::gaussians::resident::Resident;
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{Bin, BinSpec, Ranges, RangesPush, RangesSpec};
use crate::primitives::{Pairs, WORKGROUP, compact, gather};

/// Records the list of visible Gaussians, nearest first; equal depths keep the order of the model.
pub(super) fn depth_sort<'a>(recording: &mut Recording, frame: &'a Frame, model: &Resident) -> &'a Pairs {
    let (scan, total) = (&frame.scan, Some(&frame.visible_count.value));
    scan.record(recording, &model.count, &frame.visible, &frame.offsets, total);
    let order = &frame.by_depth.values;
    compact(recording, &model.count, &frame.visible, &frame.offsets, order);
    frame.visible_count.prepare(recording);
    gather(recording, &frame.visible_count, order, &frame.depth, &frame.by_depth.keys);
    frame.depth_sort.record(recording, &frame.visible_count, &frame.by_depth, 32)
}

/// Records the pairs of all visible Gaussians, in depth order.
pub(super) fn record(recording: &mut Recording, shape: &Shape, frame: &Frame, order: &Pairs) {
    let pairs = &frame.pairs;
    gather(recording, &frame.visible_count, &order.values, &frame.tile_counts, &frame.offsets);
    let (scan, total) = (&frame.scan, Some(&pairs.count.value));
    scan.record(recording, &frame.visible_count, &frame.offsets, &frame.offsets, total);
    pairs.count.prepare(recording);
    let kernel = Bin {
        view: &frame.view,
        count: &frame.visible_count.value,
        pairs: &pairs.count.value,
        order: &order.values,
        offsets: &frame.offsets,
        tile_counts: &frame.tile_counts,
        geometry: &frame.geometry,
        shape: &frame.shape,
        keys: &pairs.by_tile.keys,
        slots: &pairs.by_tile.values,
        owners: &pairs.owners,
        first_slots: &frame.first_slots,
        spec: BinSpec { workgroup: WORKGROUP, tile: shape.tile, culling: shape.settings.culling as u32 },
    };
    recording.dispatch(&kernel, frame.visible_count.groups(WORKGROUP));
}

/// Bits of a tile key: keys run to `tiles` itself, the key of pairs of no tile.
fn key_bits(tiles: u32) -> u32 {
    32 - tiles.leading_zeros()
}

/// The pairs by tile, once sorted.
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
