//! Backward pass of the rasterisation: each (tile, Gaussian) slot's sums over the tile's pixels.

use super::backward::{Pass, Sums};
use super::slot_sums::SlotSums;
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
        blue_sums: &sums.blue,
        response_sums: if options.residual { sums.responses() } else { &frame.unused },
        spec: RasteriseBackwardSpec {
            workgroup: launch.backward_workgroup(),
            tile: launch.tuning.tile,
            stride: launch.tuning.row_stride,
            pixels: launch.tuning.tile * launch.tuning.tile / launch.backward_workgroup(),
            stop: launch.settings.stop,
            residual: options.residual,
            batch: launch.tuning.backward_batch,
            count_takers: false,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
    Sums { counts: &frame.tile_counts, first: &frame.first_slots, rows: sums }
}
