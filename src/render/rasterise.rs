//! Rasterisation: blending each tile's Gaussians into its pixels.

use super::frame::{Frame, Launch};
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{Rasterise, RasteriseSpec};
use crate::primitives::Pairs;

pub(super) fn record(recording: &mut Recording, launch: &Launch, frame: &Frame, sorted: &Pairs, tiles: u32) {
    let kernel = Rasterise {
        view: &frame.view,
        starts: &frame.starts,
        slots: &sorted.values,
        owners: &frame.pairs.owners,
        geometry: &frame.geometry,
        shape: &frame.shape,
        colour: &frame.colour,
        image: &frame.image,
        spec: RasteriseSpec {
            workgroup: launch.tuning.rasterise_workgroup,
            tile: launch.tuning.tile,
            stride: launch.tuning.row_stride,
            batch: launch.tuning.rasterise_batch,
            stop: launch.settings.stop,
            pixels: launch.tuning.tile * launch.tuning.tile / launch.tuning.rasterise_workgroup,
            count_batches: false,
            count_blended: launch.count_blended,
            medians: launch.medians,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
}
