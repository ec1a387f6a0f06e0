//! Backward of the rasterisation: each (tile, Gaussian) slot's sums over the tile's pixels.

use super::frame::{Frame, Moments, Shape};
use crate::gpu::{Buffer, Groups, Recording};
use crate::kernels::render::{RasteriseBackward, RasteriseBackwardSpec};
use crate::primitives::Pairs;

pub(super) fn record(
    recording: &mut Recording,
    shape: &Shape,
    frame: &Frame,
    sorted: &Pairs,
    moments: &Moments,
    image_gradient: &Buffer<[f32; 4]>,
    tiles: u32,
    residual: bool,
) {
    let kernel = RasteriseBackward {
        view: &frame.view,
        starts: &frame.starts,
        slots: &sorted.values,
        owners: &frame.pairs.owners,
        geometry: &frame.geometry,
        shape: &frame.shape,
        colour: &frame.colour,
        image: &frame.image,
        image_gradient,
        moments_a: &moments.a,
        moments_b: &moments.b,
        moments_c: &moments.c,
        spec: RasteriseBackwardSpec {
            workgroup: shape.subgroup,
            tile: shape.tile,
            pixels: shape.tile * shape.tile / shape.subgroup,
            stop: shape.settings.stop,
            residual,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
}
