//! Rasterisation: blending each tile's Gaussians into its pixels.

use super::frame::{Frame, Shape};
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{Rasterise, RasteriseSpec};
use crate::primitives::Pairs;

pub(super) fn record(recording: &mut Recording, shape: &Shape, frame: &Frame, sorted: &Pairs, tiles: u32) {
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
            workgroup: shape.workgroup,
            tile: shape.tile,
            batch: shape.batch,
            stop: shape.settings.stop,
            pixels: shape.tile * shape.tile / shape.workgroup,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
}
