//! L1 + SSIM (+ L2) of a picture against a photo, and its gradient by the picture.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::train::{Loss as Kernel, LossPush, LossSpec};
use crate::primitives::{WORKGROUP, reduce};

/// Outputs that one invocation owns; see `loss.comp`.
const RUN: u32 = 8;

/// Weights of the loss's terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of mean |x - y|.
    pub l1: f32,
    /// Of 1 - mean SSIM.
    pub ssim: f32,
    /// Of mean (x - y)^2.
    pub l2: f32,
}

impl Default for Weights {
    fn default() -> Self {
        Self { l1: 0.8, ssim: 0.2, l2: 0.0 }
    }
}

/// Scratch of the loss for pictures of up to a number of pixels.
pub struct Loss {
    means: Buffer<f32>,
    partials: Buffer<f32>,
    terms: Buffer<[f32; 4]>,
    sums: Buffer<[f32; 4]>,
    /// Gradient by red, green, blue and alpha of each pixel.
    pub gradient: Buffer<[f32; 4]>,
}

impl Loss {
    /// Bytes of [`Loss::new`].
    pub fn bytes(width: u32, height: u32) -> u64 {
        let (pixels, runs) = (width as usize * height as usize, Self::runs(width, height));
        let planes = Buffer::<f32>::bytes_of(15 * pixels) + Buffer::<f32>::bytes_of(18 * pixels);
        let of = Buffer::<[f32; 4]>::bytes_of;
        planes + of(runs) + of(1) + of(pixels)
    }

    /// Invocations that a picture of this size, or lying on its side, takes at most.
    fn runs(width: u32, height: u32) -> usize {
        3 * width.max(height) as usize * width.max(height).div_ceil(RUN) as usize
    }

    /// Scratch for pictures of at most `width` x `height`.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, width: u32, height: u32) -> Result<Self> {
        let pixels = width as usize * height as usize;
        let runs = Self::runs(width, height);
        Ok(Self {
            means: device.buffer("window means", 15 * pixels)?,
            partials: device.buffer("SSIM partials", 18 * pixels)?,
            terms: device.buffer("loss terms", runs)?,
            sums: device.buffer("loss sums", 1)?,
            gradient: device.buffer("image gradient", pixels)?,
        })
    }

    /// Records the loss of `image` against `photo` (RGBA, 8 bits each) and its gradient.
    ///
    /// Where `transparent`, the photo's fourth byte is its opacity over `background`.
    pub fn record(
        &self,
        recording: &mut Recording,
        image: &Buffer<[f32; 4]>,
        photo: &Buffer<u32>,
        [width, height]: [u32; 2],
        transparent: bool,
        background: [f32; 3],
        weights: Weights,
    ) {
        let share = 1.0 / (3.0 * width as f32 * height as f32);
        let [r, g, b] = background;
        for phase in 0..4 {
            let (lines, length) = if phase % 2 == 0 { (width, height) } else { (height, width) };
            let kernel = Kernel {
                image: &image.cast(),
                photo,
                means: &self.means,
                partials: &self.partials,
                gradient: &self.gradient.cast(),
                terms: &self.terms,
                push: LossPush {
                    background: [r, g, b, 0.0],
                    width,
                    height,
                    l1: weights.l1 * share,
                    ssim: weights.ssim * share,
                    l2: weights.l2 * share,
                },
                spec: LossSpec { workgroup: WORKGROUP, phase, alpha: u32::from(transparent) },
            };
            let runs = 3 * lines * length.div_ceil(RUN);
            recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
        }
    }

    /// Records the sums that [`Loss::value`] reads: only iterations that someone looks at pay for them.
    pub fn record_value(&self, recording: &mut Recording, [width, height]: [u32; 2]) {
        let runs = 3 * height * width.div_ceil(RUN);
        reduce(recording, &self.terms, runs, &self.sums);
    }

    /// The value of the loss recorded last with its sums.
    ///
    /// # Errors
    /// Device errors.
    pub fn value(&self, device: &Device, [width, height]: [u32; 2], weights: Weights) -> Result<f32> {
        let sums = self.sums.read(device)?[0];
        let share = 1.0 / (3.0 * width as f32 * height as f32);
        Ok(weights.l1 * sums[0] * share + weights.ssim * (1.0 - sums[1] * share) + weights.l2 * sums[2] * share)
    }
}
