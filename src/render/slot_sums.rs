//! Sums of the (tile, Gaussian) slots.

use crate::gpu::{Buffer, Device, Result};

/// Sums that the rasteriser's backward pass writes to each slot: see `lib/slot_sums.glsl`.
pub struct SlotSums {
    /// Sums for the gradients by opacity and position; then the gradient by red.
    pub position: Buffer<[f32; 4]>,
    /// Sums for the gradient by the covariance; then the gradient by green.
    pub covariance: Buffer<[f32; 4]>,
    /// The gradient by blue.
    pub blue: Buffer<f32>,
    responses: Option<Buffer<[f32; 4]>>,
}

impl SlotSums {
    /// Sums of `slots` slots.
    pub(super) fn new(device: &Device, slots: usize, responses: bool) -> Result<Self> {
        let mut sums = Self {
            position: device.buffer("position sums", slots)?,
            covariance: device.buffer("covariance sums", slots)?,
            blue: device.buffer("blue sums", slots)?,
            responses: None,
        };
        if responses {
            sums.make_room_for_responses(device)?;
        }
        Ok(sums)
    }

    pub(super) fn make_room_for_responses(&mut self, device: &Device) -> Result<()> {
        if self.responses.is_none() {
            self.responses = Some(device.buffer("response sums", self.blue.len())?);
        }
        Ok(())
    }

    pub(super) fn free_responses(&mut self) {
        self.responses = None;
    }

    /// Sums of T alpha, alpha and T alpha times the residual, for responses; also holds the scores' sums.
    ///
    /// # Panics
    /// If there is no room, see [`super::TrainingRenderer::make_room_for_responses`].
    pub fn responses(&self) -> &Buffer<[f32; 4]> {
        self.responses.as_ref().expect("room for responses")
    }
}
