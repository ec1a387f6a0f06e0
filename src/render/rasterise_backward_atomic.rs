//! Backward pass of the rasterisation by float atomics: each Gaussian's sums over all of its tiles, in no order. The
//! engine never trains with it; it shows what bit-identical runs cost.

use super::atomic_sums::AtomicSums;
use super::backward::{Pass, Sums};
use super::frame::SlotSums;
use crate::gpu::{Groups, Recording};
use crate::kernels::render::{
    RasteriseBackwardAtomic, RasteriseBackwardAtomicSpec, RasteriseBackwardCas, RasteriseBackwardCasSpec,
};

/// Records the pass; the projection's backward pass then reads one row of each visible Gaussian.
pub(super) fn record<'a>(recording: &mut Recording, pass: &Pass<'a>, atomics: &'a AtomicSums) -> Sums<'a> {
    let Pass { launch, frame, image_gradient, tiles, .. } = *pass;
    let SlotSums { position, covariance, colour } = &atomics.sums;
    for sums in [position, covariance, colour] {
        recording.fill(sums, 0);
    }
    // One body, two shaders: a module that names float atomics is invalid on a device without them.
    macro_rules! dispatch {
        ($kernel:ident, $spec:ident) => {{
            let kernel = $kernel {
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
                colour_sums: &colour.cast(),
                spec: $spec {
                    workgroup: launch.subgroup,
                    tile: launch.tuning.tile,
                    pixels: launch.tuning.tile * launch.tuning.tile / launch.subgroup,
                    stop: launch.settings.stop,
                },
            };
            recording.dispatch(&kernel, Groups::Count(tiles));
        }};
    }
    if atomics.native {
        dispatch!(RasteriseBackwardAtomic, RasteriseBackwardAtomicSpec);
    } else {
        dispatch!(RasteriseBackwardCas, RasteriseBackwardCasSpec);
    }
    Sums { counts: &frame.visible, first: &atomics.own, rows: &atomics.sums }
}
