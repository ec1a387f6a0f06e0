//! The loss: L1, SSIM and on request L2 of a picture against a photo, and its gradient by the picture.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::loss::{GRADIENT, MAP, MEANS, TAPS};
use crate::kernels::constants::photo;
use crate::kernels::train::{Loss as Kernel, LossPush, LossSpec};
use crate::primitives::{WORKGROUP, reduce};
use crate::response::Target;

/// The profiler's scope.
pub const STAGE: &str = "loss";

/// Numbers of runs of the rows phase and of a columns phase.
fn runs([width, height]: [u32; 2], rounds: u32) -> [u32; 2] {
    [3 * height * width.div_ceil(TAPS * (rounds - 1) + 1), 3 * width * height.div_ceil(TAPS * rounds)]
}

/// Largest number of terms of a picture of at most this size.
fn terms(size: [u32; 2], rounds: u32) -> usize {
    runs(size, rounds).iter().map(|r| *r as usize).sum()
}

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

/// Scratch memory of the loss for pictures of at most a number of pixels.
pub struct Loss {
    rounds: u32,
    means: Buffer<f32>,
    partials: Buffer<f32>,
    terms: Buffer<[f32; 4]>,
    sums: Buffer<[f32; 4]>,
    /// Gradient by red, green, blue and alpha of each pixel.
    pub gradient: Buffer<[f32; 4]>,
}

impl Loss {
    /// Bytes of [`Loss::new`].
    pub fn bytes(device: &Device, width: u32, height: u32) -> u64 {
        let pixels = width as usize * height as usize;
        let planes = Buffer::<f32>::bytes_of(12 * pixels) + Buffer::<f32>::bytes_of(9 * pixels);
        let of = Buffer::<[f32; 4]>::bytes_of;
        planes + of(terms([width, height], device.tuning().loss_rounds)) + of(1) + of(pixels)
    }

    /// Scratch memory for pictures of at most `width` x `height`.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, width: u32, height: u32) -> Result<Self> {
        let (pixels, rounds) = (width as usize * height as usize, device.tuning().loss_rounds);
        Ok(Self {
            rounds,
            means: device.buffer("window means", 12 * pixels)?,
            partials: device.buffer("SSIM partials", 9 * pixels)?,
            terms: device.buffer("loss terms", terms([width, height], rounds))?,
            sums: device.buffer("loss sums", 1)?,
            gradient: device.buffer("image gradient", pixels)?,
        })
    }

    /// Records the loss of `image` against the target and its gradient by the image.
    pub fn record(&self, recording: &mut Recording, image: &Buffer<[f32; 4]>, target: Target<'_>, weights: Weights) {
        let Target { photo, size: [width, height], fourth_byte, background } = target;
        let share = 1.0 / (3.0 * width as f32 * height as f32);
        let [r, g, b] = background;
        let [row_runs, column_runs] = runs([width, height], self.rounds);
        for (phase, runs) in [(MEANS, column_runs), (MAP, row_runs), (GRADIENT, column_runs)] {
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
                    row_runs,
                },
                spec: LossSpec {
                    workgroup: WORKGROUP,
                    phase,
                    alpha: if fourth_byte.shows_background() { photo::OPACITY } else { photo::OPAQUE },
                    rounds: self.rounds,
                },
            };
            recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
        }
    }

    /// Records the sums that [`Loss::value`] reads, which only iterations that the host checks need.
    pub fn record_value(&self, recording: &mut Recording, size: [u32; 2]) {
        reduce(recording, &self.terms, runs(size, self.rounds).iter().sum(), &self.sums);
    }

    /// The value of the last loss whose sums were recorded.
    ///
    /// # Errors
    /// Device errors.
    pub fn value(&self, device: &Device, [width, height]: [u32; 2], weights: Weights) -> Result<f32> {
        let sums = self.sums.read(device)?[0];
        let share = 1.0 / (3.0 * width as f32 * height as f32);
        Ok(weights.l1 * sums[0] * share + weights.ssim * (1.0 - sums[1] * share) + weights.l2 * sums[2] * share)
    }
}
