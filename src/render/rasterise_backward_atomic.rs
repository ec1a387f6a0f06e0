//! Backward of the rasterisation by float atomics: each Gaussian's sums over all of its tiles, in no order. The engine never
//! trains with it; it shows what bit-identical runs cost.

use super::backward::{Pass, Sums};
use super::frame::SlotSums;
use crate::gpu::{Buffer, Device, Feature, Groups, Recording, Result};
use crate::kernels::render::{
    RasteriseBackwardAtomic, RasteriseBackwardAtomicSpec, RasteriseBackwardCas, RasteriseBackwardCasSpec,
};

/// Sums by Gaussian, and how they are added to.
pub struct AtomicSums {
    native: bool,
    /// 0, 1, 2, ...: a Gaussian's sums are one row, its own.
    own: Buffer<u32>,
    sums: SlotSums,
}

impl AtomicSums {
    /// Bytes of the sums of so many Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<u32>::bytes_of(gaussians) + SlotSums::bytes(gaussians)
    }

    /// Whether the device adds floats atomically; all others do it by comparing and swapping words.
    pub fn are_native(device: &Device) -> bool {
        device.info().has(Feature::FloatAtomics)
    }

    /// Room for so many Gaussians; `native` asks for the device's own float atomics, which it must have.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, gaussians: usize, native: bool) -> Result<Self> {
        let own: Vec<u32> = (0..gaussians as u32).collect();
        Ok(Self { native, own: device.upload("own rows", &own)?, sums: SlotSums::new(device, gaussians)? })
    }

    /// Projection's backward then reads one row of each visible Gaussian.
    pub(super) fn record<'a>(&'a self, recording: &mut Recording, pass: &Pass<'a>) -> Sums<'a> {
        let Pass { launch, frame, image_gradient, tiles, .. } = *pass;
        let SlotSums { position, covariance, colour } = &self.sums;
        for sums in [position, covariance, colour] {
            recording.fill(sums, 0);
        }
        // One body, two shaders: a module that names float atomics is void on a device without them.
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
        if self.native {
            dispatch!(RasteriseBackwardAtomic, RasteriseBackwardAtomicSpec);
        } else {
            dispatch!(RasteriseBackwardCas, RasteriseBackwardCasSpec);
        }
        Sums { counts: &frame.visible, first: &self.own, rows: &self.sums }
    }
}
