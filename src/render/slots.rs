//! Results of a picture and its backward pass for kernels of higher floors: (tile, Gaussian) slots, and rows of
//! gradients.

use super::bin;
use super::frame::{Frame, Launch};
use crate::gpu::{Buffer, Device, Result};
use crate::kernels::View;

/// Arrays of the picture recorded last. Slots of one Gaussian are contiguous, in the order of its tiles.
pub struct Slots<'a> {
    /// The camera.
    pub view: &'a Buffer<View>,
    /// Word 1: the largest number of pairs needed so far; beyond `limit` the arrays are not valid.
    pub pairs: &'a Buffer<u32>,
    /// Capacity in pairs.
    pub limit: u32,
    /// By Gaussian: number of its slots; 0 if the picture does not show it.
    pub tile_counts: &'a Buffer<u32>,
    /// By Gaussian: its first slot.
    pub first_slots: &'a Buffer<u32>,
    /// By slot: its Gaussian.
    pub owners: &'a Buffer<u32>,
    /// By tile: the start of its range in `sorted`; one entry more than tiles.
    pub starts: &'a Buffer<u32>,
    /// Slots by tile, nearest first.
    pub sorted: &'a Buffer<u32>,
    /// By Gaussian: the bits of its depth along the camera's axis.
    pub depth: &'a Buffer<u32>,
    /// By Gaussian: see `lib/splat.glsl`.
    pub geometry: &'a Buffer<[f32; 4]>,
    /// By Gaussian: see `lib/splat.glsl`.
    pub shape: &'a Buffer<[f32; 4]>,
    /// By Gaussian: see `lib/splat.glsl`.
    pub colour: &'a Buffer<[f32; 2]>,
    /// By slot, after the backward pass.
    pub sums: &'a SlotSums,
    /// Tiles of the picture.
    pub tiles: u32,
    /// A tile's side in pixels.
    pub tile: u32,
    /// Distance between rows of tiles processed one after the other.
    pub stride: u32,
    /// Blending ends before transmittance would fall below this.
    pub stop: f32,
}

/// Rows of gradients of the backward pass recorded last.
pub struct GradientRows<'a> {
    /// Word 1: the largest number of (tile, Gaussian) pairs needed so far; beyond `limit` the rows are not valid.
    pub pairs: &'a Buffer<u32>,
    /// Capacity in pairs.
    pub limit: u32,
    /// By Gaussian: see `lib/gradient_row.glsl`.
    pub values: &'a Buffer<f32>,
}

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
    /// Bytes of [`SlotSums::new`].
    pub(super) const fn bytes(slots: usize, responses: bool) -> u64 {
        let vectors = if responses { 3 } else { 2 };
        vectors * Buffer::<[f32; 4]>::bytes_of(slots) + Buffer::<f32>::bytes_of(slots)
    }

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

impl<'a> GradientRows<'a> {
    pub(super) fn new(frame: &'a Frame) -> Self {
        Self { pairs: &frame.pairs.count.value, limit: frame.pairs.count.limit(), values: &frame.gradient_rows }
    }
}

impl<'a> Slots<'a> {
    pub(super) fn new(launch: &Launch, frame: &'a Frame, tiles: u32) -> Self {
        Self {
            view: &frame.view,
            pairs: &frame.pairs.count.value,
            limit: frame.pairs.count.limit(),
            tile_counts: &frame.tile_counts,
            first_slots: &frame.first_slots,
            owners: &frame.pairs.owners,
            starts: &frame.starts,
            sorted: &bin::sorted(frame, tiles).values,
            depth: &frame.depth,
            geometry: &frame.geometry,
            shape: &frame.shape,
            colour: &frame.colour,
            sums: &frame.pairs.sums,
            tiles,
            tile: launch.tuning.tile,
            stride: launch.tuning.row_stride,
            stop: launch.settings.stop,
        }
    }
}
