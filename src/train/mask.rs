//! Masks, which hide parts of photos from the loss.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::mask::{BACKWARD, HIDE};
use crate::kernels::train::{Mask as Kernel, MaskPush, MaskSpec};
use crate::primitives::WORKGROUP;

/// A picture with the background in its hidden parts.
pub struct Mask {
    /// The picture as the loss sees it.
    pub image: Buffer<[f32; 4]>,
    background: [f32; 3],
}

impl Mask {
    /// Room for pictures of at most `pixels`.
    pub fn new(device: &Device, pixels: usize, background: [f32; 3]) -> Result<Self> {
        Ok(Self { image: device.buffer("masked image", pixels)?, background })
    }

    /// Records `image`, with the background wherever the photo's fourth byte hides it, into [`Mask::image`].
    pub fn apply(&self, recording: &mut Recording, photo: &Buffer<u32>, image: &Buffer<[f32; 4]>, pixels: u32) {
        self.phase(recording, HIDE, photo, image, pixels);
    }

    /// Records the backward pass of `gradient`.
    pub fn backward(&self, recording: &mut Recording, photo: &Buffer<u32>, gradient: &Buffer<[f32; 4]>, pixels: u32) {
        self.phase(recording, BACKWARD, photo, gradient, pixels);
    }

    /// One pass over `values`: the picture's pixels, or in the backward pass those of its gradient.
    fn phase(
        &self,
        recording: &mut Recording,
        phase: u32,
        photo: &Buffer<u32>,
        values: &Buffer<[f32; 4]>,
        pixels: u32,
    ) {
        let [r, g, b] = self.background;
        let kernel = Kernel {
            photo,
            image: values,
            masked: &self.image,
            gradient: values,
            push: MaskPush { background: [r, g, b, 0.0], pixels },
            spec: MaskSpec { workgroup: WORKGROUP, phase },
        };
        recording.scope("masks", |r| r.dispatch(&kernel, Groups::Count(pixels.div_ceil(WORKGROUP))));
    }
}
