//! Intermediate arrays of one frame, and the launch parameters of its kernels.

use super::settings::{Settings, Style};
use super::slot_sums::SlotSums;
use crate::gpu::{Buffer, Device, Result, Tuning};
use crate::kernels::View;
use crate::kernels::constants::gradient_row::ROW;
use crate::primitives::{Count, Pairs, Scan, Sort};

/// Number of floats in a Gaussian's row of gradients.
const GRADIENT_ROW: usize = ROW as usize;

/// Launch parameters of a renderer's kernels.
pub(super) struct Launch {
    pub settings: Settings,
    pub subgroup: u32,
    pub tuning: Tuning,
    /// True if the red channel of a picture is to hold the number of Gaussians that each pixel blends.
    pub count_blended: bool,
    /// True if the green channel is to hold the red of the Gaussian with which half of the light is stopped.
    pub medians: bool,
}

impl Launch {
    pub fn new(device: &Device, settings: Settings) -> Self {
        let (subgroup, tuning) = (device.info().subgroup_size, device.tuning().clone());
        Self { settings, subgroup, tuning, count_blended: false, medians: false }
    }

    /// Invocations that walk a tile's list backward.
    pub fn backward_workgroup(&self) -> u32 {
        if self.tuning.backward_batch > 0 { self.tuning.backward_workgroup } else { self.subgroup }
    }
}

/// Purpose of a renderer; each includes those before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    /// Pictures.
    #[default]
    Pictures,
    /// Sums over the pixels of each (tile, Gaussian) slot.
    Scores,
    /// Gradients: the backward pass.
    Training,
}

/// The features that a renderer needs memory for.
#[derive(Clone, Copy, Debug, Default)]
pub struct Uses {
    /// The uses it was allocated for.
    pub purpose: Purpose,
    /// True if slots also have sums for responses and scores.
    pub responses: bool,
    /// Effects of the model.
    pub style: Style,
}

impl Uses {
    /// Floats in the rows of gradients: one in total without a backward pass.
    fn gradients(self, gaussians: usize) -> usize {
        if self.purpose == Purpose::Training { GRADIENT_ROW * gaussians } else { 1 }
    }

    /// Number of slots with sums: a single one without scores.
    fn slots(self, pairs: usize) -> usize {
        if self.purpose == Purpose::Pictures { 1 } else { pairs }
    }

    /// Bytes per Gaussian in the widest array.
    pub(super) fn row_bytes(self) -> usize {
        size_of::<[f32; 4]>().max(self.gradients(1) * size_of::<f32>())
    }
}

/// Intermediate arrays of one frame.
pub(super) struct Frame {
    pub view: Buffer<View>,
    pub geometry: Buffer<[f32; 4]>,
    pub shape: Buffer<[f32; 4]>,
    pub colour: Buffer<[f32; 2]>,
    pub depth: Buffer<u32>,
    pub tile_counts: Buffer<u32>,
    pub visible: Buffer<u32>,
    pub offsets: Buffer<u32>,
    pub first_slots: Buffer<u32>,
    pub gradient_rows: Buffer<f32>,
    pub visible_count: Count,
    pub by_depth: Pairs,
    pub scan: Scan,
    pub depth_sort: Sort,
    pub pairs: PairBuffers,
    pub starts: Buffer<u32>,
    pub image: Buffer<[f32; 4]>,
    /// Bound in place of a buffer that a kernel does not touch this time.
    pub unused: Buffer<[f32; 4]>,
}

/// Arrays whose size depends on the number of (tile, Gaussian) pairs.
pub(super) struct PairBuffers {
    pub count: Count,
    pub by_tile: Pairs,
    pub owners: Buffer<u32>,
    pub sort: Sort,
    /// Tile of each slot, if tiles have a depth order of their own.
    pub tiles: Option<Buffer<u32>>,
    pub sums: SlotSums,
}

impl PairBuffers {
    /// Buffers whose contents are undefined: the count must be reset before the first picture.
    pub fn new(device: &Device, capacity: u32, uses: Uses) -> Result<Self> {
        let n = capacity as usize;
        let sizes = [Sort::block(device, capacity)];
        Ok(Self {
            count: Count::unset(device, "pairs", capacity, &sizes)?,
            by_tile: Pairs::new(device, "pairs by tile", capacity)?,
            owners: device.buffer("pair owners", n)?,
            sort: Sort::new(device, capacity)?,
            tiles: uses.style.depth_order.then(|| device.buffer("pair tiles", n)).transpose()?,
            sums: SlotSums::new(device, uses.slots(n), uses.responses)?,
        })
    }
}

impl Frame {
    /// Capacity in tiles: the list of starts has one more entry.
    pub fn tiles(&self) -> usize {
        self.starts.len() - 1
    }

    /// Buffers whose contents are undefined, see [`PairBuffers::new`].
    pub fn new(device: &Device, gaussians: usize, pixels: usize, tiles: usize, pairs: u32, uses: Uses) -> Result<Self> {
        let n = gaussians.max(1);
        let sizes = [Scan::block(device), Sort::block(device, n as u32)];
        Ok(Self {
            view: device.buffer("view", 1)?,
            geometry: device.buffer("splat geometry", n)?,
            shape: device.buffer("splat shape", n)?,
            colour: device.buffer("splat colour", n)?,
            depth: device.buffer("depth keys", n)?,
            tile_counts: device.buffer("tile counts", n)?,
            visible: device.buffer("visible flags", n)?,
            offsets: device.buffer("offsets", n)?,
            first_slots: device.buffer("first slots", n)?,
            gradient_rows: device.buffer("gradient rows", uses.gradients(n))?,
            visible_count: Count::unset(device, "visible", n as u32, &sizes)?,
            by_depth: Pairs::new(device, "by depth", n as u32)?,
            scan: Scan::new(device, n as u32)?,
            depth_sort: Sort::new(device, n as u32)?,
            pairs: PairBuffers::new(device, pairs, uses)?,
            starts: device.buffer("tile starts", tiles + 1)?,
            image: device.buffer("image", pixels)?,
            unused: device.buffer("unused", 1)?,
        })
    }
}
