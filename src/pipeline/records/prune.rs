//! What a prune measured: a part of `metrics.json`, of the compression's figures and of checkpoints.

use crate::qirf::CHANNELS;
use crate::qirf::select::Selector;
use crate::qirf::study::Merging;
use serde::{Deserialize, Serialize};

/// One prune: what was there, what was kept, and what the blocks told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PruneRecord {
    /// After this iteration.
    pub iteration: u32,
    /// What Gaussians were ranked by.
    pub selector: Selector,
    /// Gaussians before.
    pub before: usize,
    /// Gaussians kept.
    pub after: usize,
    /// Of these, by the detail safeguard.
    pub detail: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Edge of the finest voxels in world units.
    pub voxel: f64,
    /// Blocks of 1, 2 to 3, 4 to 7, ... members.
    pub occupancy: Vec<usize>,
    /// Blocks of which less than 1/10, 2/10, ... or up to all was kept.
    pub kept_shares: [usize; 10],
    /// Mean over blocks of the eight largest eigenvalues, each block's as shares of their sum; zeros where none was solved.
    pub spectrum: [f64; CHANNELS],
    /// Blocks by how many eigenvalues reach the threshold, 1 to 8; zeros where none was solved.
    pub modes: [usize; CHANNELS],
    /// What was repaired.
    pub guards: PruneGuards,
    /// Blocks in which the kept now stand for the dropped; null where merging was not asked for.
    pub merged: Option<Merging>,
    /// Pictures a second just before the prune; null where that was not measured.
    pub frames_per_second_before: Option<f64>,
    /// Seconds.
    pub seconds: PruneSeconds,
}

/// What a prune had to repair.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PruneGuards {
    /// Blocks whose metric was not positive definite: solved in its canonical form.
    pub canonical_blocks: usize,
    /// Blocks without any response: ranked by opacity.
    pub unseen_blocks: usize,
    /// Overlaps and responses that were not finite.
    pub repaired_values: usize,
}

/// Seconds of a prune.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PruneSeconds {
    /// The pass over the training views, where there was one.
    pub responses: f64,
    /// Normalisation and partition.
    pub partition: f64,
    /// Device: overlaps.
    pub assemble: f64,
    /// Host: blocks solved.
    pub solve: f64,
    /// Assembly and solution, side by side.
    pub assemble_and_solve: f64,
    /// From ranks to a mask.
    pub select: f64,
    /// Merging, and compaction of parameters and moments.
    pub merge: f64,
    /// All of it.
    pub total: f64,
}
