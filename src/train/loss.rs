//! The loss: L1, SSIM and optionally L2 of a picture against a photo, and its gradient by the picture.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::loss::{GRADIENT, MAP, MEANS};
use crate::kernels::constants::ssim::TAPS;
use crate::kernels::constants::{loss_tiles, photo};
use crate::kernels::train::{Loss as Runs, LossPush, LossSpec, LossTiles as Tiles, LossTilesPush, LossTilesSpec};
use crate::primitives::{WORKGROUP, reduce};
use crate::response::Target;

/// The profiler's scope.
pub const STAGE: &str = "loss";

/// Method by which a device computes the loss.
#[derive(Clone, Copy)]
enum Shape {
    /// Each invocation walks a run of a line, of this many rounds.
    Runs(u32),
    /// Each workgroup takes a square tile with sides of this many pixels.
    Tiles(u32),
}

impl Shape {
    fn of(device: &Device) -> Self {
        match device.tuning().loss_tile {
            0 => Self::Runs(device.tuning().loss_rounds),
            side => Self::Tiles(side),
        }
    }

    /// Numbers of terms of the phases that compute the map and the gradient.
    fn terms(self, [width, height]: [u32; 2]) -> [u32; 2] {
        match self {
            Self::Runs(rounds) => {
                [3 * height * width.div_ceil(TAPS * (rounds - 1) + 1), 3 * width * height.div_ceil(TAPS * rounds)]
            }
            Self::Tiles(side) => [width.div_ceil(side) * height.div_ceil(side); 2],
        }
    }

    /// Number of window means kept between phases.
    fn means(self, pixels: usize) -> usize {
        if matches!(self, Self::Runs(_)) { 12 * pixels } else { 0 }
    }
}

/// Weights of the loss's terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Weight of mean |x - y|.
    pub l1: f32,
    /// Weight of 1 - mean SSIM.
    pub ssim: f32,
    /// Weight of mean (x - y)^2.
    pub l2: f32,
}

impl Weights {
    /// All weights multiplied by a factor.
    pub(super) fn times(self, factor: f32) -> Self {
        Self { l1: self.l1 * factor, ssim: self.ssim * factor, l2: self.l2 * factor }
    }
}

impl Default for Weights {
    fn default() -> Self {
        Self { l1: 0.8, ssim: 0.2, l2: 0.0 }
    }
}

/// Scratch memory of the loss for pictures up to a number of pixels.
pub struct Loss {
    shape: Shape,
    means: Buffer<f32>,
    partials: Buffer<f32>,
    terms: Buffer<[f32; 4]>,
    sums: Buffer<[f32; 4]>,
    /// Gradient by red, green, blue and alpha of each pixel.
    pub gradient: Buffer<[f32; 4]>,
}

/// Inputs of the loss.
struct Job<'a> {
    image: &'a Buffer<[f32; 4]>,
    target: Target<'a>,
    /// Weights divided by the number of values.
    weights: Weights,
    /// Meaning of the photo's fourth byte: `lib/photo.glsl`.
    alpha: u32,
}

impl Loss {
    /// Scratch memory for pictures of at most `width` x `height`.
    pub fn new(device: &Device, width: u32, height: u32) -> Result<Self> {
        let (pixels, shape) = (width as usize * height as usize, Shape::of(device));
        let terms: u32 = shape.terms([width, height]).iter().sum();
        Ok(Self {
            shape,
            means: device.buffer("window means", shape.means(pixels))?,
            partials: device.buffer("SSIM partials", 9 * pixels)?,
            terms: device.buffer("loss terms", terms as usize)?,
            sums: device.buffer("loss sums", 1)?,
            gradient: device.buffer("image gradient", pixels)?,
        })
    }

    /// Records the loss of `image` against the target and its gradient by the image.
    pub fn record(&self, recording: &mut Recording, image: &Buffer<[f32; 4]>, target: Target<'_>, weights: Weights) {
        let share = 1.0 / (3.0 * target.size[0] as f32 * target.size[1] as f32);
        let weights = Weights { l1: weights.l1 * share, ssim: weights.ssim * share, l2: weights.l2 * share };
        let alpha = if target.alpha_role.shows_background() { photo::OPACITY } else { photo::OPAQUE };
        let job = Job { image, target, weights, alpha };
        match self.shape {
            Shape::Runs(rounds) => self.runs(recording, &job, rounds),
            Shape::Tiles(side) => self.tiles(recording, &job, side),
        }
    }

    fn runs(&self, recording: &mut Recording, job: &Job<'_>, rounds: u32) {
        let Target { photo, size: [width, height], background: [r, g, b], .. } = job.target;
        let Weights { l1, ssim, l2 } = job.weights;
        let [row_runs, column_runs] = self.shape.terms([width, height]);
        for (phase, runs) in [(MEANS, column_runs), (MAP, row_runs), (GRADIENT, column_runs)] {
            let kernel = Runs {
                image: &job.image.cast(),
                photo,
                means: &self.means,
                partials: &self.partials,
                gradient: &self.gradient.cast(),
                terms: &self.terms,
                push: LossPush { background: [r, g, b, 0.0], width, height, l1, ssim, l2, row_runs },
                spec: LossSpec { workgroup: WORKGROUP, phase, alpha: job.alpha, rounds },
            };
            recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
        }
    }

    fn tiles(&self, recording: &mut Recording, job: &Job<'_>, side: u32) {
        let Target { photo, size: [width, height], background: [r, g, b], .. } = job.target;
        let Weights { l1, ssim, l2 } = job.weights;
        let [tiles, _] = self.shape.terms([width, height]);
        for phase in [loss_tiles::MAP, loss_tiles::GRADIENT] {
            let kernel = Tiles {
                image: &job.image.cast(),
                photo,
                partials: &self.partials,
                gradient: &self.gradient,
                terms: &self.terms,
                push: LossTilesPush { background: [r, g, b, 0.0], width, height, l1, ssim, l2 },
                spec: LossTilesSpec { workgroup: side * side, phase, alpha: job.alpha, tile: side },
            };
            recording.dispatch(&kernel, Groups::Count(tiles));
        }
    }

    /// Records the sums that [`Loss::value`] reads; needed only in iterations that the host checks.
    pub fn record_value(&self, recording: &mut Recording, size: [u32; 2]) {
        reduce(recording, &self.terms, self.shape.terms(size).iter().sum(), &self.sums);
    }

    /// The value of the last loss whose sums were recorded.
    pub fn value(&self, device: &Device, [width, height]: [u32; 2], weights: Weights) -> Result<f32> {
        Ok(Self::value_of(self.sums.read(device)?[0], [width, height], weights))
    }

    /// The sums that [`Loss::value`] reads.
    pub fn sums(&self) -> &Buffer<[f32; 4]> {
        &self.sums
    }

    /// The loss of a picture of this size from its sums.
    pub fn value_of(sums: [f32; 4], [width, height]: [u32; 2], weights: Weights) -> f32 {
        let share = 1.0 / (3.0 * width as f32 * height as f32);
        weights.l1 * sums[0] * share + weights.ssim * (1.0 - sums[1] * share) + weights.l2 * sums[2] * share
    }
}
