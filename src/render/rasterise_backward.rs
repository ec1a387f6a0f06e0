//! Backward pass of the rasterisation: each (tile, Gaussian) slot's sums over the tile's pixels.

use super::backward::{Pass, Sums};
use super::frame::SlotSums;
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{RasteriseBackward, RasteriseBackwardSpec};

pub(super) fn record<'a>(recording: &mut Recording, pass: &Pass<'a>, sums: &'a SlotSums) -> Sums<'a> {
    let Pass { launch, frame, image_gradient, tiles, options } = *pass;
    let kernel = RasteriseBackward {
        view: &frame.view,
        starts: &frame.starts,
        slots: &pass.sorted().values,
        owners: &frame.pairs.owners,
        geometry: &frame.geometry,
        shape: &frame.shape,
        colour: &frame.colour,
        image: &frame.image,
        image_gradient,
        position_sums: &sums.position,
        covariance_sums: &sums.covariance,
        colour_sums: &sums.colour,
        spec: RasteriseBackwardSpec {
            workgroup: launch.subgroup,
            tile: launch.tuning.tile,
            pixels: launch.tuning.tile * launch.tuning.tile / launch.subgroup,
            stop: launch.settings.stop,
            residual: options.residual,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
    Sums { counts: &frame.tile_counts, first: &frame.first_slots, rows: sums }
}
