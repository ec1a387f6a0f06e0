//! A substitute for the loss and its residual for models without photos.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::high_pass::{COLUMNS, ROWS, RUN};
use crate::kernels::response::{HighPass as Kernel, HighPassPush, HighPassSpec};
use crate::primitives::WORKGROUP;

/// A substitute for the loss without photos: L = sum C (C - blur C), with a blur of sigma 2 pixels and the bracket held
/// constant.
pub struct HighPass {
    scratch: Buffer<f32>,
}

impl HighPass {
    /// Scratch memory for pictures of up to `pixels`.
    pub fn new(device: &Device, pixels: usize) -> Result<Self> {
        Ok(Self { scratch: device.buffer("blurred columns", 3 * pixels)? })
    }

    /// Records C - blur C into the gradient, and the mean of its absolute value over the colours into the fourth
    /// component.
    pub fn record(
        &self,
        recording: &mut Recording,
        image: &Buffer<[f32; 4]>,
        gradient: &Buffer<[f32; 4]>,
        [width, height]: [u32; 2],
    ) {
        recording.scope("high pass", |r| {
            for (phase, lines, length) in [(COLUMNS, width, height), (ROWS, height, width)] {
                let kernel = Kernel {
                    image: &image.cast(),
                    scratch: &self.scratch,
                    gradient: &gradient.cast(),
                    push: HighPassPush { width, height },
                    spec: HighPassSpec { workgroup: WORKGROUP, phase },
                };
                r.dispatch(&kernel, Groups::Count((lines * length.div_ceil(RUN)).div_ceil(WORKGROUP)));
            }
        });
    }
}
