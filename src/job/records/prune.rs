//! Record of a prune: a part of `metrics.json`, of the compression's figures and of checkpoints.

use crate::qirf::CHANNELS;
use crate::qirf::pairs::PairCounts;
use crate::qirf::participation::Eigensolver;
use crate::qirf::select::Selector;
use crate::qirf::study::{Merging, Seconds};
use serde::{Deserialize, Serialize};

/// One prune: counts before and after, and statistics of its blocks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PruneRecord {
    /// Number of iterations done before it.
    pub iteration: u32,
    /// Selector that ranked the Gaussians.
    pub selector: Selector,
    /// Gaussians before.
    pub before: usize,
    /// Gaussians kept.
    pub after: usize,
    /// The attrition that went before; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attrition: Option<AttritionRecord>,
    /// Gaussians kept by the detail safeguard, included in `after`.
    pub detail: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Edge of the finest voxels in world units.
    pub voxel: f64,
    /// Number of blocks with 1, 2 to 3, 4 to 7, ... members.
    pub occupancy: Vec<usize>,
    /// Number of blocks of which less than 1/10, less than 2/10, ..., up to all was kept.
    pub kept_shares: [usize; 10],
    /// Solver of the blocks' eigenproblems; null if none was solved.
    #[serde(default)]
    pub solver: Option<Eigensolver>,
    /// Mean over blocks of the eight largest eigenvalues, as shares of their sum in each block; zeros if none was
    /// solved.
    pub spectrum: [f64; CHANNELS],
    /// Standard deviation of these shares over the blocks.
    #[serde(default)]
    pub spectrum_spread: [f64; CHANNELS],
    /// Number of blocks with 1 to 8 eigenvalues that reach the threshold; zeros if none was solved.
    pub modes: [usize; CHANNELS],
    /// Blocks by their effective rank, rounded to 1 to 8; empty if none was solved.
    #[serde(default)]
    pub effective_ranks: Vec<RankRecord>,
    /// Repairs.
    pub guards: PruneGuards,
    /// Blocks in which dropped Gaussians were merged into kept ones; null without merging.
    pub merged: Option<Merging>,
    /// Numbers of merging by pairs; null for other selectors.
    pub pairs: Option<PairCounts>,
    /// Pictures per second just before the prune; null if not measured.
    pub frames_per_second_before: Option<f64>,
    /// Seconds.
    pub seconds: PruneSeconds,
}

/// Blocks of one effective rank: exp(-sum p ln p) over the shares p of a block's eigenvalues, rounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RankRecord {
    /// The rank, 1 to 8.
    pub rank: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Gaussians of these blocks.
    pub gaussians: usize,
    /// Gaussians of these blocks that were kept.
    pub kept: usize,
}

/// Attrition before a prune.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttritionRecord {
    /// Number of iterations done at its start.
    pub from: u32,
    /// Gaussians at its start.
    pub before: usize,
}

impl PruneRecord {
    /// Gaussians before the prune, or before the attrition that went before it.
    pub fn dense(&self) -> usize {
        self.attrition.map_or(self.before, |a| a.before)
    }

    /// The record without the figures that differ from process to process.
    #[must_use]
    pub fn timeless(self) -> Self {
        Self { seconds: PruneSeconds::default(), frames_per_second_before: None, ..self }
    }
}

/// Repairs of a prune.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PruneGuards {
    /// Blocks that the solver asked for could not factorise: solved by the next one that can.
    #[serde(default)]
    pub fallback_blocks: usize,
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
    /// The pass over the training views, if there was one.
    pub responses: f64,
    /// The study of the blocks.
    #[serde(flatten)]
    pub study: Seconds,
    /// Selection, from ranks to a keep mask.
    pub select: f64,
    /// Merging, and compaction of parameters and moments.
    pub merge: f64,
    /// Total.
    pub total: f64,
}

impl PruneSeconds {
    /// Adds the pass over the views, which came before.
    pub fn add_responses(&mut self, seconds: f64) {
        self.responses += seconds;
        self.total += seconds;
    }
}
