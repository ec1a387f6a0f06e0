//! From a rendered picture to the gradient by it: exposure and mask before the loss, and both on the way back.

use super::error::Result;
use super::exposure::{Exposure, Step};
use super::loss::{self, Loss};
use super::mask::Mask;
use super::options::Options;
use crate::gpu::{Buffer, Device, Recording};
use crate::response::record_residual;

/// What a picture is compared with.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    /// The view, as its number among those trained on.
    pub view: usize,
    /// Its photo, RGBA of 8 bits each.
    pub photo: &'a Buffer<u32>,
    /// Width and height.
    pub size: [u32; 2],
}

/// What pictures are judged by.
pub(super) struct Objective {
    pub loss: Loss,
    /// Exposures of the photos, where they have any.
    pub exposure: Option<Exposure>,
    /// What hides parts of photos, where they have masks.
    pub mask: Option<Mask>,
}

impl Objective {
    /// For so many photos of at most `size`.
    pub fn new(device: &Device, photos: usize, [width, height]: [u32; 2], options: &Options) -> Result<Self> {
        let pixels = width as usize * height as usize;
        let background = options.settings.background;
        Ok(Self {
            loss: Loss::new(device, width, height)?,
            exposure: options
                .exposure
                .as_ref()
                .map(|gains| Exposure::new(device, gains, photos, pixels))
                .transpose()?,
            mask: options.masked.then(|| Mask::new(device, pixels, background)).transpose()?,
        })
    }

    /// Records the gradient by `rendered`, and the loss's sums where its value is asked for; `step` updates the photo's
    /// exposure, none leaves it. Returns the picture that the loss saw.
    pub fn record<'a>(
        &'a self,
        recording: &mut Recording,
        rendered: &'a Buffer<[f32; 4]>,
        target: Target<'_>,
        options: &Options,
        with_value: bool,
        step: Option<Step<'_>>,
    ) -> &'a Buffer<[f32; 4]> {
        let Target { view, photo, size } = target;
        let (gradient, pixels) = (&self.loss.gradient, size[0] * size[1]);
        let mut seen = rendered;
        if let Some(exposure) = &self.exposure {
            exposure.apply(recording, view, seen, pixels);
            seen = &exposure.image;
        }
        if let Some(mask) = &self.mask {
            mask.apply(recording, photo, seen, pixels);
            seen = &mask.image;
        }
        recording.scope(loss::STAGE, |r| {
            self.loss.record(r, seen, photo, size, options.over(), options.settings.background, options.weights);
            if with_value {
                self.loss.record_value(r, size);
            }
        });
        if let Some(mask) = &self.mask {
            mask.backward(recording, photo, gradient, pixels);
        }
        if let Some(exposure) = &self.exposure {
            exposure.backward(recording, view, rendered, gradient, pixels, step);
        }
        seen
    }

    /// Records the residual of what the loss saw into the gradient's fourth component, after [`Objective::record`].
    pub fn record_residual(
        &self,
        recording: &mut Recording,
        seen: &Buffer<[f32; 4]>,
        target: Target<'_>,
        options: &Options,
    ) {
        let (gradient, background) = (&self.loss.gradient, options.settings.background);
        record_residual(recording, seen, target.photo, gradient, target.size, options.over(), background);
    }
}
