//! Tuning: every number that depends on the class of device, in one table.
//!
//! All of them are specialization constants, or sizes of dispatches and scratch memory. None changes what is computed;
//! most change the order of sums, and with it the last bits of results.

pub(in crate::gpu) mod choice;
pub(in crate::gpu) mod store;
pub(in crate::gpu) mod variants;

use crate::gpu::choose::properties::SHARED_BYTES;
use crate::gpu::info::{DeviceClass, DeviceInfo};
use serde::{Deserialize, Serialize};

/// Tuning of the kernels on one device; other code reads it through [`crate::gpu::Device::tuning`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tuning {
    /// The class whose row of the table this is; individual fields may differ.
    pub class: DeviceClass,
    /// Invocations per subgroup: the device's.
    pub subgroup: u32,
    /// Side of a tile in pixels.
    pub tile: u32,
    /// Distance between rows of tiles processed one after the other; up to 1: rows in order.
    #[serde(default)]
    pub row_stride: u32,
    /// Number of tiles from which a subgroup jointly writes a Gaussian's pairs and adds up their sums; 0: each
    /// invocation works alone.
    #[serde(default)]
    pub bin_many: u32,
    /// Invocations that walk a tile's list forward; they share its pixels.
    pub rasterise_workgroup: u32,
    /// Splats staged in shared memory at a time in the forward pass; 0 broadcasts them within a single subgroup.
    pub rasterise_batch: u32,
    /// Invocations that walk a tile's list backward; they share its pixels. One subgroup if the batch is 0.
    #[serde(default)]
    pub backward_workgroup: u32,
    /// Splats staged in shared memory at a time in the backward pass; 0 broadcasts them within a single subgroup.
    #[serde(default)]
    pub backward_batch: u32,
    /// Invocations of a workgroup of a prefix sum.
    pub scan_workgroup: u32,
    /// Words scanned per invocation.
    pub scan_rows: u32,
    /// Invocations of a workgroup of a sort.
    pub sort_workgroup: u32,
    /// Target number of workgroups of a sort; the limits on its rows take precedence.
    pub sort_workgroups: u32,
    /// Fewest keys per invocation of a sort.
    pub sort_rows_min: u32,
    /// Most keys per invocation of a sort.
    pub sort_rows_max: u32,
    /// Whether each invocation of a sort ranks a run of its own, without ballots.
    pub sort_serial: bool,
    /// Gaussians whose attributes a workgroup of Adam updates one after the other; 1: an invocation updates all attributes
    /// of one Gaussian.
    pub adam_block: u32,
    /// Side of a tile of the loss in pixels; 0: invocations walk runs of lines instead.
    #[serde(default)]
    pub loss_tile: u32,
    /// Rounds of a run of the loss, 11 steps each.
    pub loss_rounds: u32,
    /// Columns of a tile of overlaps, a multiple of the subgroup.
    pub overlap_columns: u32,
    /// Invocations of a workgroup that measures the rate of copies.
    pub copy_workgroup: u32,
    /// Words copied per invocation.
    pub copy_rows: u32,
    /// Workgroups that measure the rate of multiply-adds.
    pub multiply_workgroups: u32,
    /// Rounds per workgroup.
    pub multiply_rounds: u32,
}

impl Tuning {
    /// The row of a class, for a device of this subgroup size and largest workgroup.
    pub fn new(class: DeviceClass, subgroup: u32, max_workgroup: u32) -> Self {
        match class {
            DeviceClass::Cpu => Self::cpu(subgroup),
            // Its compilers do not finish the loss's runs, which are rings of registers in unrolled loops.
            DeviceClass::SwiftShader => Self { class, loss_tile: 16, ..Self::cpu(subgroup) },
            // One row for all GPUs: one by NVIDIA was measured, none by the others.
            DeviceClass::Gpu
            | DeviceClass::Nvidia
            | DeviceClass::Amd
            | DeviceClass::Intel
            | DeviceClass::Apple
            | DeviceClass::Qualcomm => Self::gpu(class, subgroup, max_workgroup),
        }
    }

    /// On a CPU a core executes every lane, a barrier costs more than lanes, and starting a workgroup as much as
    /// hundreds of words: few long runs, and one subgroup per workgroup. Numbers are those of docs/decisions.md.
    fn cpu(subgroup: u32) -> Self {
        Self {
            class: DeviceClass::Cpu,
            subgroup,
            // Decision 3: a smaller tile lists fewer splats that its pixels do not need.
            tile: 8,
            // Decision 74: each of up to four threads gets rows from all over the picture.
            row_stride: 4,
            // The lanes would take turns.
            bin_many: 0,
            // Decision 19: one subgroup walks a tile, its pixels in registers, a splat per lane: 1.6 to 2 times as fast
            // as batches.
            rasterise_workgroup: subgroup,
            rasterise_batch: 0,
            backward_workgroup: subgroup,
            backward_batch: 0,
            scan_workgroup: subgroup,
            scan_rows: 2048 / subgroup,
            // A block's counters are cleared and scanned once, whatever its length.
            sort_workgroup: subgroup,
            sort_workgroups: 16,
            sort_rows_min: 64,
            sort_rows_max: 512,
            sort_serial: true,
            // Decision 76: starting a kernel costs as much as hundreds of words, and data that attributes share is read
            // once.
            adam_block: 1,
            // Decision 53: registers; tiles in shared memory make a whole iteration half as long again.
            loss_tile: 0,
            // Decision 32: a load costs as much as five multiplications, and long runs read each value less often.
            loss_rounds: 4,
            // Long tiles read a Gaussian less often.
            overlap_columns: 64_u32.next_multiple_of(subgroup),
            copy_workgroup: subgroup,
            copy_rows: 1024,
            // Billions of operations, so that the cost of starting is negligible.
            multiply_workgroups: 64,
            multiply_rounds: 512,
        }
    }

    /// Splats per batch in the backward pass: two rounds of a subgroup, up to 64, so that subgroups that take few of
    /// them rarely wait for others; but few enough for their sums.
    fn backward_batch(subgroup: u32) -> u32 {
        if subgroup >= 64 { subgroup } else { 2 * subgroup }
    }

    /// Occupancy first. Values that cite decision 82 were measured, on an NVIDIA H200.
    fn gpu(class: DeviceClass, subgroup: u32, max_workgroup: u32) -> Self {
        let tile = 16;
        // Eight rank units per workgroup hold their counters in 8 KiB of shared memory, and finally a block's keys.
        // A power of two, as the number of keys of a block has to be.
        let most = 1 << max_workgroup.max(1).ilog2();
        let sort_workgroup = (8 * subgroup).min(most);
        let sort_rows_max = (2048 / sort_workgroup).clamp(1, 8);
        Self {
            class,
            subgroup,
            tile,
            row_stride: 1,
            // Decision 82: the pairs of one large Gaussian took longer than those of all others.
            bin_many: 32,
            // One pixel per invocation, one splat per invocation and batch.
            rasterise_workgroup: tile * tile,
            rasterise_batch: tile * tile,
            // Decision 60: two pixels per invocation; a subgroup skips splats that none of its 64 pixels shows.
            backward_workgroup: (tile * tile / 2).max(subgroup),
            backward_batch: Self::backward_batch(subgroup),
            scan_workgroup: 256.max(subgroup),
            // Decision 82: an invocation waits for each of its words.
            scan_rows: 4,
            sort_workgroup,
            // Decision 82: short runs, until the device is full.
            sort_workgroups: 128,
            sort_rows_min: sort_rows_max.min(4),
            sort_rows_max,
            sort_serial: false,
            // Decision 61: neighbouring lanes touch neighbouring words, rows of gradients are read once, and seven
            // dispatches are saved.
            adam_block: 64,
            // Neighbouring lanes load neighbouring pixels, and a workgroup loads each of them once: 15 KiB of shared
            // memory.
            loss_tile: 16,
            // Short runs occupy more lanes.
            loss_rounds: 2,
            // Short tiles spread over more workgroups.
            overlap_columns: subgroup,
            copy_workgroup: 256.max(subgroup),
            copy_rows: 4,
            multiply_workgroups: 4096,
            multiply_rounds: 1024,
        }
    }
}

impl Tuning {
    /// Bytes of shared memory of the backward pass: sums per splat and subgroup, splats, slots and takers.
    fn backward_bytes(&self) -> u32 {
        let subgroups = self.backward_workgroup / self.subgroup;
        self.backward_batch.saturating_mul(subgroups * 4 * 12 + 40 + 8).saturating_add(4 * subgroups)
    }

    /// Bytes of shared memory of a sort: a counter of each value of a digit for each unit that ranks keys, and two more for the block.
    fn sort_bytes(&self) -> u32 {
        let units = if self.sort_serial { self.sort_workgroup } else { self.sort_workgroup / self.subgroup };
        units.saturating_add(2).saturating_mul(4 << 8)
    }

    /// Reports the first field that does not fit a device, and why.
    pub(in crate::gpu) fn check(&self, info: &DeviceInfo) -> Result<(), String> {
        let subgroup = info.subgroup_size;
        if self.subgroup != subgroup {
            return Err(format!("subgroup = {}, but {} has subgroups of {subgroup}", self.subgroup, info.name));
        }
        let need = |holds: bool, field: &str, what: &str| {
            if holds { Ok(()) } else { Err(format!("{field} must be {what} on {}", info.name)) }
        };
        need([8, 16].contains(&self.tile), "tile", "8 or 16")?;
        let pixels = self.tile * self.tile;
        need(pixels.is_multiple_of(subgroup), "tile", "a square of whole subgroups")?;
        let workgroups = [
            ("rasterise_workgroup", self.rasterise_workgroup),
            ("scan_workgroup", self.scan_workgroup),
            ("sort_workgroup", self.sort_workgroup),
            ("copy_workgroup", self.copy_workgroup),
        ];
        for (field, workgroup) in workgroups {
            let fits = workgroup > 0 && workgroup.is_multiple_of(subgroup) && workgroup <= info.max_workgroup;
            need(fits, field, &format!("a multiple of {subgroup} up to {}", info.max_workgroup))?;
        }
        need(pixels.is_multiple_of(self.rasterise_workgroup), "rasterise_workgroup", "a divisor of a tile's pixels")?;
        let batches = self.rasterise_batch > 0;
        let whole = !batches || self.rasterise_batch == self.rasterise_workgroup;
        need(whole, "rasterise_batch", "0 or the workgroup")?;
        let alone = batches || self.rasterise_workgroup == subgroup;
        need(alone, "rasterise_workgroup", "one subgroup where the batch is 0")?;
        let eighth = !batches || pixels / self.rasterise_workgroup <= 8;
        need(eighth, "rasterise_workgroup", "at least an eighth of a tile's pixels where there are batches")?;
        if self.backward_batch > 0 {
            let workgroup = self.backward_workgroup;
            let shared = workgroup.is_multiple_of(subgroup) && workgroup <= info.max_workgroup.min(32 * subgroup);
            need(
                shared,
                "backward_workgroup",
                &format!("a multiple of {subgroup}, up to 32 subgroups, as many as a workgroup may have"),
            )?;
            let pixels = workgroup > 0 && pixels.is_multiple_of(workgroup) && pixels / workgroup <= 8;
            need(pixels, "backward_workgroup", "a divisor of a tile's pixels, at least an eighth of them")?;
            let batch = self.backward_batch.is_multiple_of(subgroup) && self.backward_bytes() <= SHARED_BYTES;
            need(batch, "backward_batch", &format!("a multiple of {subgroup} whose sums fit into 16 KiB"))?;
        }
        if self.sort_serial {
            need(self.sort_workgroup == subgroup, "sort_workgroup", "one subgroup where a sort is serial")?;
        }
        let (counters, shared) = (self.sort_bytes(), info.shared_bytes);
        let what = format!("so small that its counters ({counters} bytes) fit into {shared} bytes of shared memory");
        need(counters <= shared, "sort_workgroup", &what)?;
        need((1..=64).contains(&self.adam_block), "adam_block", "from 1 to 64")?;
        let loss = [0, 8, 16].contains(&self.loss_tile) && self.loss_tile * self.loss_tile <= info.max_workgroup;
        need(loss, "loss_tile", "0, 8 or 16, its square no more than a workgroup")?;
        let whole = (self.loss_tile * self.loss_tile).is_multiple_of(subgroup);
        need(whole, "loss_tile", "the side of a square of whole subgroups")?;
        let positive = [
            ("scan_rows", self.scan_rows),
            ("sort_workgroups", self.sort_workgroups),
            ("loss_rounds", self.loss_rounds),
            ("row_stride", self.row_stride.max(1)),
            ("copy_rows", self.copy_rows),
            ("multiply_workgroups", self.multiply_workgroups),
            ("multiply_rounds", self.multiply_rounds),
        ];
        for (field, value) in positive {
            need((1..=1 << 20).contains(&value), field, "from 1 to 1048576")?;
        }
        let (least, most) = (self.sort_rows_min, self.sort_rows_max);
        need(most.is_power_of_two() && most <= 512, "sort_rows_max", "a power of two up to 512")?;
        need(least.is_power_of_two() && least <= most, "sort_rows_min", "a power of two up to sort_rows_max")?;
        let columns = self.overlap_columns > 0 && self.overlap_columns.is_multiple_of(subgroup);
        need(columns, "overlap_columns", &format!("a multiple of {subgroup}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_fit_every_subgroup() {
        for subgroup in [4, 8, 16, 32, 64, 128] {
            for row in [1024, 768, 384].map(|most| Tuning::gpu(DeviceClass::Gpu, subgroup, most)) {
                assert!(row.sort_workgroup.is_power_of_two() && row.sort_rows_max.is_power_of_two(), "{row:?}");
                assert!(row.sort_bytes().max(row.backward_bytes()) <= SHARED_BYTES, "{row:?}");
            }
            for row in [Tuning::cpu(subgroup), Tuning::gpu(DeviceClass::Gpu, subgroup, 1024)] {
                // No CPU device has subgroups wider than the 64 pixels of a tile.
                assert!(subgroup > 64 || (row.tile * row.tile).is_multiple_of(row.rasterise_workgroup), "{row:?}");
                assert!(row.overlap_columns.is_multiple_of(subgroup), "{row:?}");
                for workgroup in [row.scan_workgroup, row.sort_workgroup, row.copy_workgroup] {
                    assert!(workgroup.is_multiple_of(subgroup) && workgroup <= 1024, "{row:?}");
                }
            }
        }
    }
}
