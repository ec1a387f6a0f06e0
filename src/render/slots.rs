//! Results of a picture and its backward pass for kernels of higher floors: (tile, Gaussian) slots, and rows of
//! gradients.

use super::bin;
use super::frame::{Frame, Launch};
use super::slot_sums::SlotSums;
use crate::gpu::Buffer;
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
