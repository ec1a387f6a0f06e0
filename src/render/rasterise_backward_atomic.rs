//! Backward pass of the rasterisation by float atomics: each Gaussian's sums over all of its tiles, in no fixed order.
//! The engine never trains with it; it measures the cost of bit-identical runs.

use super::atomic_sums::AtomicSums;
use super::backward::{Pass, Sums};
use super::slot_sums::SlotSums;
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{RasteriseBackwardAtomic, RasteriseBackwardAtomicSpec};

/// Records the pass; the projection's backward pass then reads one row of each visible Gaussian.
pub(super) fn record<'a>(recording: &mut Recording, pass: &Pass<'a>, atomics: &'a AtomicSums) -> Sums<'a> {
    let Pass { launch, frame, image_gradient, tiles, .. } = *pass;
    let SlotSums { position, covariance, blue, .. } = &atomics.sums;
    recording.fill(position, 0);
    recording.fill(covariance, 0);
    recording.fill(blue, 0);
    let kernel = RasteriseBackwardAtomic {
        view: &frame.view,
        starts: &frame.starts,
        slots: &pass.sorted().values,
        owners: &frame.pairs.owners,
        geometry: &frame.geometry,
        shape: &frame.shape,
        colour: &frame.colour,
        image: &frame.image,
        image_gradient,
        position_sums: &position.cast(),
        covariance_sums: &covariance.cast(),
        blue_sums: &blue.cast(),
        spec: RasteriseBackwardAtomicSpec {
            workgroup: launch.backward_workgroup(),
            tile: launch.tuning.tile,
            stride: launch.tuning.row_stride,
            pixels: launch.tuning.tile * launch.tuning.tile / launch.backward_workgroup(),
            stop: launch.settings.stop,
            batch: launch.tuning.backward_batch,
            count_takers: false,
        },
    };
    recording.dispatch(&kernel, Groups::Count(tiles));
    Sums { counts: &frame.visible, first: &atomics.own, rows: &atomics.sums }
}
