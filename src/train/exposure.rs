//! Exposures: a 3 x 4 affine map of the rendered colours for each photo, learnt with the model and used in training
//! only.

use crate::gpu::{Buffer, Device, Feed, Groups, Recording, Result, Ticket};
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use crate::kernels::constants::exposure as shader;
use crate::kernels::train::{Exposure as Kernel, ExposurePush, ExposureSpec};
use crate::primitives::WORKGROUP;

/// Numbers of an affine map: three rows of red, green, blue and a constant.
pub const SIZE: usize = shader::SIZE as usize;
/// Initial learning rate if gains were measured: they are accurate to a percent, so that little is left to learn.
const REFINE: f64 = 0.004;
/// Initial learning rate otherwise: the 3DGS reference's, and a higher one for photos drawn less than a hundred times.
const RATE: (f64, f64) = (0.01, 0.05);
/// Final learning rate as a share of the initial one.
const LEFT: f64 = 0.1;
/// Pull of each affine map towards its initial gains, in learning rates per step. The loss cannot distinguish a change
/// that all photos share from a change of the model's colours: without the pull both would drift.
pub const PULL: f32 = 1.0;
/// Largest number of workgroups that sum gradients.
const GROUPS: u32 = 64;
/// The profiler's scope.
const SCOPE: &str = "exposure";

/// Affine maps of all photos with their moments, and the exposed colours of a picture.
pub struct Exposure {
    /// Photo x 12.
    pub affine: Buffer<f32>,
    /// Photo x red, green, blue: initial values, towards which the maps are pulled.
    pub gains: Buffer<f32>,
    /// First and second moment of each number of `affine`.
    pub moments: Buffer<[f32; 2]>,
    /// The picture as the loss sees it.
    pub image: Buffer<[f32; 4]>,
    partials: Buffer<f32>,
}

/// A step of Adam of one photo's map.
#[derive(Clone, Copy)]
pub struct Step<'a> {
    /// Word 1: the largest number of (tile, Gaussian) pairs needed so far; beyond `limit` nothing is updated.
    pub pairs: &'a Buffer<u32>,
    /// Capacity in pairs.
    pub limit: u32,
    /// Steps of this photo so far, including this one.
    pub number: u32,
    /// Learning rate.
    pub rate: f32,
}

impl<'a> Step<'a> {
    /// Placeholder values that no kernel reads.
    fn none(idle: &'a Buffer<u32>) -> Self {
        Self { pairs: idle, limit: 0, number: 1, rate: 0.0 }
    }
}

/// A rendered picture of a photo.
#[derive(Clone, Copy)]
pub struct Rendered<'a> {
    /// The photo's number among those trained on.
    pub photo: usize,
    /// The picture.
    pub image: &'a Buffer<[f32; 4]>,
    /// Its pixels.
    pub pixels: u32,
}

/// Learning rate at an iteration of a run of `length` iterations on `photos` photos.
pub fn rate(gains: &[[f32; 3]], iteration: u32, length: u32, photos: usize) -> f32 {
    let rounds = f64::from(length.max(1)) / photos.max(1) as f64;
    let t = f64::from(iteration) / f64::from(length.max(1));
    let begin = if gains.is_empty() { (1.0 / rounds).clamp(RATE.0, RATE.1) } else { REFINE };
    (begin * LEFT.powf(t)) as f32
}

/// Gains of each photo; 1 for photos beyond the list.
fn of_each(gains: &[[f32; 3]], photos: usize) -> impl Iterator<Item = [f32; 3]> {
    (0..photos).map(|k| gains.get(k).copied().unwrap_or([1.0; 3]))
}

/// The affine map that multiplies channels by these gains.
fn diagonal(gains: [f32; 3]) -> [f32; SIZE] {
    let mut affine = [0.0; SIZE];
    (0..3).for_each(|c| affine[5 * c] = gains[c]);
    affine
}

/// The mean of maps, less the identity.
fn shared(maps: &[f32]) -> [f32; SIZE] {
    let (identity, count) = (diagonal([1.0; 3]), (maps.len() / SIZE).max(1) as f64);
    std::array::from_fn(|k| {
        let sum: f64 = maps.iter().skip(k).step_by(SIZE).map(|value| f64::from(*value) - f64::from(identity[k])).sum();
        (sum / count) as f32
    })
}

impl Exposure {
    /// Exposures whose maps begin as these gains of red, green and blue; 1 for photos beyond the list.
    pub fn new(device: &Device, gains: &[[f32; 3]], photos: usize, pixels: usize) -> Result<Self> {
        let affine: Vec<f32> = of_each(gains, photos).flat_map(diagonal).collect();
        Self::with(device, gains, &affine, &vec![0.0; 2 * affine.len()], pixels)
    }

    /// Exposures with these maps (photo x 12) and moments (first and second interleaved), which began as these gains.
    pub fn with(device: &Device, gains: &[[f32; 3]], affine: &[f32], moments: &[f32], pixels: usize) -> Result<Self> {
        Ok(Self {
            affine: device.upload("exposures", affine)?,
            gains: device
                .upload("exposures' gains", of_each(gains, affine.len() / SIZE).collect::<Vec<_>>().as_flattened())?,
            moments: device.upload::<f32>("exposures' moments", moments)?.cast(),
            image: device.buffer("exposed image", pixels)?,
            partials: device.buffer("exposure sums", SIZE * GROUPS as usize)?,
        })
    }

    /// Takes out of all maps what they share, so that the model has the mean photo's colours. Returns the work that writes
    /// the new maps.
    pub fn centre(&self, device: &Device) -> Result<Ticket> {
        let mut maps = self.affine.read(device)?;
        let shared = shared(&maps);
        maps.chunks_exact_mut(SIZE)
            .for_each(|map| map.iter_mut().zip(shared).for_each(|(value, shared)| *value -= shared));
        let mut recording = Recording::new();
        Feed::new(device, self.affine.name(), maps.len(), 1)?.record(&mut recording, &maps, &self.affine)?;
        device.submit(recording)
    }

    /// Records the application of a photo's exposure to its picture, into [`Exposure::image`].
    pub fn apply(&self, recording: &mut Recording, rendered: Rendered<'_>) {
        let idle = self.partials.cast();
        recording.scope(SCOPE, |r| self.phase(r, shader::APPLY, rendered, rendered.image, Step::none(&idle)));
    }

    /// Records the backward pass: `gradient` changes from the one by the exposed colours to the one by the rendered
    /// colours. `step` updates the map; without it the map stays unchanged.
    pub fn backward(
        &self,
        recording: &mut Recording,
        rendered: Rendered<'_>,
        gradient: &Buffer<[f32; 4]>,
        step: Option<Step<'_>>,
    ) {
        recording.scope(SCOPE, |r| {
            let idle = self.partials.cast();
            self.phase(r, shader::BACKWARD, rendered, gradient, step.unwrap_or(Step::none(&idle)));
            if let Some(step) = step {
                self.phase(r, shader::UPDATE, rendered, gradient, step);
            }
        });
    }

    fn phase(
        &self,
        recording: &mut Recording,
        phase: u32,
        Rendered { photo, image, pixels }: Rendered<'_>,
        gradient: &Buffer<[f32; 4]>,
        step: Step<'_>,
    ) {
        let correction = |beta: f64| 1.0 - beta.powf(f64::from(step.number));
        let sums = pixels.div_ceil(WORKGROUP).clamp(1, GROUPS);
        let groups = match phase {
            shader::APPLY => pixels.div_ceil(WORKGROUP),
            shader::BACKWARD => sums,
            _ => 1,
        };
        let kernel = Kernel {
            pairs: step.pairs,
            image,
            exposed: &self.image,
            gradient,
            partials: &self.partials,
            affine: &self.affine,
            moments: &self.moments,
            gains: &self.gains,
            push: ExposurePush {
                photo: photo as u32,
                pixels,
                groups: sums,
                pair_limit: step.limit,
                rate: step.rate,
                correction1: (1.0 / correction(BETA1)) as f32,
                correction2: (1.0 / correction(BETA2).sqrt()) as f32,
                pull: PULL,
            },
            spec: ExposureSpec { workgroup: WORKGROUP, phase },
        };
        recording.dispatch(&kernel, Groups::Count(groups));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_share_their_mean_less_the_identity() {
        let maps = [diagonal([1.5, 1.0, 0.5]), diagonal([1.1, 1.0, 1.1])].concat();
        let shared = shared(&maps);
        let expected = diagonal([0.3, 0.0, -0.2]);
        assert!(shared.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{shared:?}");
    }
}
