//! The gradient by a rendered picture: exposure and mask, loss, and the backward passes of both.

use super::error::Result;
use super::exposure::{Exposure, Rendered, Step};
use super::loss::{self, Loss, Weights};
use super::mask::Mask;
use super::options::{Exposures, Options};
use crate::gpu::{Buffer, Device, Recording};
use crate::response::{Target, record_residual};
use crate::scene::camera::Camera;
use crate::scene::{AlphaRole, Photo};

/// The photo that a picture is rendered for.
#[derive(Clone, Copy)]
pub(super) struct Current<'a> {
    /// Its number among the photos trained on.
    pub number: usize,
    /// Its pixels, RGBA of 8 bits each.
    pub pixels: &'a Buffer<u32>,
    /// Width and height.
    pub size: [u32; 2],
    /// Share of the whole photo's pixels.
    pub share: f32,
}

impl<'a> Current<'a> {
    /// The photo's pixels as seen by this camera.
    pub fn new(number: usize, pixels: &'a Buffer<u32>, camera: &Camera) -> Self {
        Self { number, pixels, size: [camera.width, camera.height], share: camera.share() as f32 }
    }
}

/// Compares pictures with photos.
pub(super) struct Objective {
    pub loss: Loss,
    /// Weights of the loss.
    pub weights: Weights,
    alpha_role: AlphaRole,
    background: [f32; 3],
    /// Exposures of the photos, if they have any.
    pub exposure: Option<Exposure>,
    /// Hides masked parts of photos, if they have masks.
    mask: Option<Mask>,
}

impl Objective {
    /// An objective for photos of at most `size`.
    pub fn new(device: &Device, photos: &[Photo], [width, height]: [u32; 2], options: &Options) -> Result<Self> {
        let pixels = width as usize * height as usize;
        let background = options.settings.background;
        let alpha_role = AlphaRole::of(photos);
        let masked = alpha_role == AlphaRole::Mask;
        Ok(Self {
            loss: Loss::new(device, width, height)?,
            weights: options.weights,
            alpha_role,
            background,
            exposure: options
                .exposure
                .as_ref()
                .map(|exposures| match exposures {
                    Exposures::Learnt(gains) => Exposure::new(device, gains, photos.len(), pixels),
                    Exposures::Known(maps) => Exposure::with(device, &[], maps, &vec![0.0; 2 * maps.len()], pixels),
                })
                .transpose()?,
            mask: masked.then(|| Mask::new(device, pixels, background)).transpose()?,
        })
    }

    /// Records the gradient by `rendered`, and the loss's sums if `with_value`; `step` updates the photo's exposure,
    /// which otherwise stays unchanged. Returns the picture that the loss saw.
    pub fn record<'a>(
        &'a self,
        recording: &mut Recording,
        rendered: &'a Buffer<[f32; 4]>,
        current: Current<'_>,
        with_value: bool,
        step: Option<Step<'_>>,
    ) -> &'a Buffer<[f32; 4]> {
        // The loss takes means over the pixels that it gets: this weights a part of a photo as within the whole.
        self.weighted(recording, rendered, current, (self.weights.times(current.share), with_value), step)
    }

    /// Records half the gradient of the sum of squared differences, that is, the picture minus the photo.
    pub fn record_squares(&self, recording: &mut Recording, rendered: &Buffer<[f32; 4]>, current: Current<'_>) {
        // The loss takes means over pixels and colours.
        let half_sum = 1.5 * current.size[0] as f32 * current.size[1] as f32;
        let weights = Weights { l1: 0.0, ssim: 0.0, l2: half_sum };
        self.weighted(recording, rendered, current, (weights, false), None);
    }

    fn weighted<'a>(
        &'a self,
        recording: &mut Recording,
        rendered: &'a Buffer<[f32; 4]>,
        current: Current<'_>,
        (weights, with_value): (Weights, bool),
        step: Option<Step<'_>>,
    ) -> &'a Buffer<[f32; 4]> {
        let Current { number, pixels: photo, size, .. } = current;
        let (gradient, pixels) = (&self.loss.gradient, size[0] * size[1]);
        let exposed = Rendered { photo: number, image: rendered, pixels };
        let mut seen = rendered;
        if let Some(exposure) = &self.exposure {
            exposure.apply(recording, exposed);
            seen = &exposure.image;
        }
        if let Some(mask) = &self.mask {
            mask.apply(recording, photo, seen, pixels);
            seen = &mask.image;
        }
        recording.scope(loss::STAGE, |r| {
            self.loss.record(r, seen, self.target(current), weights);
            if with_value {
                self.loss.record_value(r, size);
            }
        });
        if let Some(mask) = &self.mask {
            mask.backward(recording, photo, gradient, pixels);
        }
        if let Some(exposure) = &self.exposure {
            exposure.backward(recording, exposed, gradient, step);
        }
        seen
    }

    /// Records the residual of the picture that the loss saw into the gradient's fourth component, after
    /// [`Objective::record`].
    pub fn record_residual(&self, recording: &mut Recording, seen: &Buffer<[f32; 4]>, current: Current<'_>) {
        record_residual(recording, seen, self.target(current), &self.loss.gradient);
    }

    fn target<'a>(&self, Current { pixels: photo, size, .. }: Current<'a>) -> Target<'a> {
        Target { photo, size, alpha_role: self.alpha_role, background: self.background }
    }
}
