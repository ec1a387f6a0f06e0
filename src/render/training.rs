//! A renderer that also runs the backward pass, and sums over the pixels of each (tile, Gaussian) slot.

use super::backward::{Backward, BackwardCounts, Pass};
use super::frame::Purpose;
use super::settings::Settings;
use super::slots::{GradientRows, Slots};
use super::{Renderer, project_backward, rasterise_backward, rasterise_backward_atomic};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::scene::camera::Camera;
use std::ops::{Deref, DerefMut};

/// The stages of the backward pass, in order.
pub const BACKWARD_STAGES: [&str; 2] = ["rasterise backward", "project backward"];

/// Renders models for training and for scores: a [`Renderer`] with room for gradients and for sums per slot.
pub struct TrainingRenderer {
    renderer: Renderer,
    /// Counters of the backward passes, see [`BackwardCounts`].
    guards: Buffer<u32>,
}

impl Deref for TrainingRenderer {
    type Target = Renderer;

    fn deref(&self) -> &Renderer {
        &self.renderer
    }
}

impl DerefMut for TrainingRenderer {
    fn deref_mut(&mut self) -> &mut Renderer {
        &mut self.renderer
    }
}

impl AsMut<Renderer> for TrainingRenderer {
    fn as_mut(&mut self) -> &mut Renderer {
        &mut self.renderer
    }
}

impl TrainingRenderer {
    /// A renderer with room for `gaussians`, one picture of `size` (width and height), and initially `pairs` (tile, Gaussian) pairs.
    pub fn new(device: &Device, settings: Settings, gaussians: usize, size: [u32; 2], pairs: u32) -> Result<Self> {
        Self::with(device, settings, gaussians, size, pairs, Purpose::Training)
    }

    /// The same for scores alone, without room for gradients by the model: [`Self::record_backward`] must not be called.
    pub(crate) fn for_scores(
        device: &Device,
        settings: Settings,
        gaussians: usize,
        size: [u32; 2],
        pairs: u32,
    ) -> Result<Self> {
        Self::with(device, settings, gaussians, size, pairs, Purpose::Scores)
    }

    fn with(
        device: &Device,
        settings: Settings,
        gaussians: usize,
        size: [u32; 2],
        pairs: u32,
        purpose: Purpose,
    ) -> Result<Self> {
        let renderer = Renderer::with(device, settings, gaussians, size, pairs, purpose)?;
        Ok(Self { renderer, guards: device.upload("guards", &[0, 0])? })
    }

    /// Makes room for the sums from which responses and scores are gathered.
    pub fn make_room_for_responses(&mut self) -> Result<()> {
        let Renderer { device, frame, uses, .. } = &mut self.renderer;
        uses.responses = true;
        frame.pairs.sums.make_room_for_responses(device)
    }

    /// Frees the memory of [`Self::make_room_for_responses`], which no recording may use any more.
    pub fn free_responses(&mut self) {
        self.renderer.uses.responses = false;
        self.renderer.frame.pairs.sums.free_responses();
    }

    /// Records the backward pass of the picture recorded before it: from the gradients by its pixels to one row of
    /// gradients per Gaussian, see [`Self::gradient_rows`].
    pub fn record_backward(
        &self,
        recording: &mut Recording,
        model: &Resident,
        camera: &Camera,
        image_gradient: &Buffer<[f32; 4]>,
        backward: Backward<'_>,
    ) {
        let Renderer { launch, frame, .. } = &self.renderer;
        let tiles = self.tiles(camera) as u32;
        let pass = Pass { launch, frame, image_gradient, tiles, options: backward };
        let sums = recording.scope(BACKWARD_STAGES[0], |r| match backward.atomics {
            Some(atomics) => rasterise_backward_atomic::record(r, &pass, atomics),
            None => rasterise_backward::record(r, &pass, &frame.pairs.sums),
        });
        recording.scope(BACKWARD_STAGES[1], |r| project_backward::record(r, &pass, &sums, model, &self.guards));
    }

    /// Records the reset of [`Self::backward_counts`].
    pub fn reset_backward_counts(&self, recording: &mut Recording) {
        recording.update(&self.guards, &[0, 0]);
    }

    /// Counters of the backward passes since their last reset.
    pub fn backward_counts(&self) -> Result<BackwardCounts> {
        Ok(BackwardCounts::of(&self.guards.read(self.device())?))
    }

    /// Counters that the host reads between iterations, each with its number of words: of the backward passes
    /// ([`BackwardCounts::of`]), then of (tile, Gaussian) pairs; the last word is the largest number that a picture needed,
    /// even if they did not fit.
    pub fn counters(&self) -> [(&Buffer<u32>, usize); 2] {
        [(&self.guards, 2), (&self.frame.pairs.count.value, 2)]
    }

    /// The rows of gradients written by the backward pass.
    pub fn gradient_rows(&self) -> GradientRows<'_> {
        GradientRows::new(&self.frame)
    }

    /// Results per (tile, Gaussian) slot of the recorded passes, for kernels of higher floors.
    pub fn slots(&self, camera: &Camera) -> Slots<'_> {
        Slots::new(&self.launch, &self.frame, self.tiles(camera) as u32)
    }
}
