//! The study of a model: its blocks, and the order of its Gaussians by each selector. The device assembles one batch of
//! blocks while the host solves the previous batch on all cores.

mod merging;
mod solve;

use super::assemble::{Assembly, Options};
use super::batch::{Collected, Solver};
use super::overlap::Metric;
use super::participation::Eigensolver;
use super::partition::{Partition, Partitioned};
use super::rrdm::Density;
use super::select::budget::{self, Budget, Choice, Keep, Safeguard};
use super::select::detail;
use super::select::{Ranking, Selector, Statistics};
use super::{CHANNELS, normalise};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{self, Device};
use crate::response::{CHANNEL_NAMES, Responses, Wanted};
use crate::wording::named;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Reason why a model cannot be studied.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// The device floor.
    #[error(transparent)]
    Device(#[from] gpu::Error),
    /// A response that is not a finite number.
    #[error("Gaussian {gaussian} has a response of {value} in channel {channel} ({}): responses must be finite", CHANNEL_NAMES[*channel])]
    Response { gaussian: usize, channel: usize, value: f32 },
}

/// Result of a study.
pub type Result<T> = std::result::Result<T, Error>;

/// Bytes of overlaps per batch, of which two are in flight: enough to keep every core busy, little compared with a
/// model.
const BATCH_BYTES: usize = 16 << 20;

/// Blocks are counted as no smaller than this: what each has besides its matrices counts most for small ones.
const SMALL_BLOCK: usize = 32;

/// Peak device memory, in bytes, of a study of `n` Gaussians by the blocks and the solver of `basis`, and of the preceding pass for `wanted`.
pub fn bytes(n: usize, wanted: Wanted, basis: &Basis) -> u64 {
    let (Partition::Paper { cap: most, .. } | Partition::Adaptive { most, .. }) = basis.partition;
    let most = most.clamp(SMALL_BLOCK, n.max(SMALL_BLOCK));
    // Triangles of m (m + 1) / 2 floats: those of n Gaussians, or a batch; a batch holds one block at least.
    let triangles = |gaussians: usize| (size_of::<f32>() * gaussians.div_ceil(2)).saturating_mul(most + 1);
    let batch_bytes = triangles(n).min(BATCH_BYTES.max(triangles(most)));
    let density = Density { full: basis.solver == Eigensolver::Dsygvd, ..Density::default() };
    let batches = Options { batch_bytes, density: Some(density), ..Options::default() };
    Assembly::bytes(n, &batches).max(wanted.bytes(n))
}

named! {
    /// The overlaps used as the metric.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Overlap {
        /// N: overlaps of functions of unit norm.
        #[default]
        Normalised = "normalised",
        /// S, as in the literal text of the paper; epsilon dominates it.
        Raw = "raw",
    }
}

/// Options for making and solving blocks: the inputs of an order besides the model and its responses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Basis {
    /// Rule that makes blocks.
    pub partition: Partition,
    /// The overlaps used as the metric.
    pub overlap: Overlap,
    /// Standard deviation added to every axis for the overlaps, as a multiple of the median largest scale; 0 for none.
    pub dilate: f64,
    /// Solver of the eigenproblem.
    pub solver: Eigensolver,
    /// Added to the metric's diagonal, and to traces.
    pub epsilon: f64,
    /// Share of the energy that the leading eigenvalues reach.
    pub tau: f64,
    /// Weight of the rendering channels; those of optimisation get the rest.
    pub eta: f64,
}

impl Default for Basis {
    fn default() -> Self {
        let Solver { eigensolver, epsilon, tau, .. } = Solver::default();
        Self {
            partition: Partition::ADAPTIVE,
            overlap: Overlap::default(),
            dilate: 0.0,
            solver: eigensolver,
            epsilon,
            tau,
            eta: 0.75,
        }
    }
}

/// Seconds of a study.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Rows of H, and the partition.
    pub partition: f64,
    /// Device: N.
    #[serde(default)]
    pub overlap: f64,
    /// Device: W and P.
    #[serde(default)]
    pub rrdm: f64,
    /// Device: eigenproblems.
    #[serde(default)]
    pub participation: f64,
    /// Host: eigenproblems and column subsets.
    pub solve: f64,
    /// Elapsed time of all of these, which run concurrently.
    #[serde(rename = "assemble_and_solve")]
    pub wall: f64,
}

/// A model's blocks, and its order by each requested selector.
pub struct Study {
    /// Blocks, and statistics of the partition.
    pub partitioned: Partitioned,
    /// Each selector's order.
    pub rankings: Vec<(Selector, Ranking)>,
    /// The solver of the blocks; `None` if no selector needs them.
    pub solver: Option<Eigensolver>,
    /// Results of the solved blocks; their rankings have moved to `rankings`.
    pub collected: Collected,
    /// Detail scores, n.
    pub detail: Vec<f64>,
    /// Times of the parts.
    pub seconds: Seconds,
    metric: Metric,
}

/// Counts of blocks by the result of merging.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Merging {
    /// Blocks whose kept Gaussians now also represent the dropped ones.
    pub accepted: usize,
    /// Blocks left unchanged, because merging would not have lowered the error.
    pub refused: usize,
}

/// A model, on the device and on the host, and the responses of its Gaussians.
#[derive(Clone, Copy)]
pub struct Observed<'a> {
    /// The model on the device.
    pub resident: &'a Resident,
    /// The same model on the host.
    pub model: &'a Gaussians,
    /// Responses of its Gaussians, n.
    pub responses: &'a Responses,
}

impl Study {
    /// Studies a model. If one of the selectors reads blocks, the paper's eigenproblem is solved for every block.
    ///
    /// # Errors
    /// [`Error::Response`] for a response that is not finite; device memory; device errors.
    ///
    /// # Panics
    /// If there is not one response per Gaussian, or a selector needs scores that are missing.
    pub fn new(
        device: &Device,
        observed: Observed<'_>,
        basis: &Basis,
        selectors: &[Selector],
        seed: u32,
    ) -> Result<Self> {
        let Observed { model, responses, .. } = observed;
        assert_eq!(responses.channels.len(), model.len(), "one response a Gaussian");
        if let Some((gaussian, channel, value)) = normalise::not_finite(&responses.channels) {
            return Err(Error::Response { gaussian, channel, value });
        }
        let begun = Instant::now();
        let rows = normalise::rows(&responses.channels, basis.eta);
        let partitioned = basis.partition.of(&model.means);
        let dilation = dilation(model, basis.dilate);
        let seconds = Seconds { partition: begun.elapsed().as_secs_f64(), ..Seconds::default() };
        let of_blocks: Vec<Selector> = selectors.iter().copied().filter(|s| s.reads_blocks()).collect();
        let mut study = Self {
            detail: detail::scores(model, &responses.channels),
            metric: Metric { dilation, ..Metric::default() },
            rankings: Vec::new(),
            solver: (!of_blocks.is_empty()).then_some(basis.solver),
            collected: Collected::new(&partitioned.blocks, &of_blocks),
            partitioned,
            seconds,
        };
        if !of_blocks.is_empty() {
            study.solve(device, observed, basis, of_blocks, &rows)?;
        }
        study.rank(observed, selectors, &rows, seed);
        Ok(study)
    }

    /// Computes each selector's order, from the solved blocks or from a score of each Gaussian alone.
    fn rank(&mut self, observed: Observed<'_>, selectors: &[Selector], rows: &[[f32; CHANNELS]], seed: u32) {
        let Observed { model, responses, .. } = observed;
        let mut solved = std::mem::take(&mut self.collected.rankings);
        let statistics = Statistics {
            rows,
            opacity: &model.opacity_logits,
            scores: &responses.scores,
            log_scales: &model.log_scales,
        };
        for &selector in selectors {
            let alone = selector.ranking(&self.partitioned.blocks, &statistics, u64::from(seed));
            let of_blocks = || {
                let at = solved.iter().position(|(s, _)| *s == selector)?;
                Some(solved.swap_remove(at).1)
            };
            if let Some(ranking) = alone.or_else(of_blocks) {
                self.rankings.push((selector, ranking));
            }
        }
    }

    /// Chooses the Gaussians to keep by the order of `selector`; `detail` is the share of all Gaussians that the
    /// safeguard keeps.
    ///
    /// # Panics
    /// If the study was made without that selector.
    pub fn choose(&self, selector: Selector, budget: Budget, keep: Keep, detail: f64) -> Choice {
        let (_, ranking) = self.rankings.iter().find(|(s, _)| *s == selector).expect("a selector that was studied");
        let safeguard = (detail > 0.0).then_some(Safeguard { scores: &self.detail, share: detail });
        budget::choose(&self.partitioned.blocks, ranking, &self.collected.r, budget, keep, safeguard)
    }
}

/// S_ii of all Gaussians.
fn self_overlaps(model: &Gaussians, metric: Metric) -> Vec<f64> {
    model.log_scales.iter().map(|s| metric.self_overlap(*s)).collect()
}

/// `share` of the median over the Gaussians of the largest scale, in world units.
pub fn dilation(model: &Gaussians, share: f64) -> f32 {
    let mut largest: Vec<f32> =
        model.log_scales.iter().map(|s| s[0].max(s[1]).max(s[2])).filter(|s| s.is_finite()).collect();
    if share <= 0.0 || largest.is_empty() {
        return 0.0;
    }
    let middle = largest.len() / 2;
    let median = *largest.select_nth_unstable_by(middle, f32::total_cmp).1;
    (share * f64::from(median).exp()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::qirf::plan::triangle;

    #[test]
    fn small_models_need_little_and_no_batch_needs_more_than_estimated() {
        let one_block = Partition::Adaptive { mean: 1 << 13, least: 1, most: 1 << 13 };
        for partition in [Partition::ADAPTIVE, Partition::PAPER, one_block] {
            let basis = Basis { partition, ..Basis::default() };
            for n in [1_u16, 20, 600, 4_000] {
                let positions: Vec<[f32; 3]> = (0..n).map(|i| [1e-5 * f32::from(i), 0.0, 0.0]).collect();
                let blocks = partition.of(&positions).blocks;
                let entries = (0..blocks.len()).map(|b| triangle(blocks.block(b).len()));
                let largest = entries.clone().max().unwrap_or(0);
                let batch = 4 * entries.sum::<usize>().min(largest.max(BATCH_BYTES / 4));
                let bytes = bytes(usize::from(n), Wanted::CHANNELS, &basis);
                assert!(bytes >= 3 * batch as u64, "{partition:?}, {n}: {bytes}, {batch}");
                assert!(partition != Partition::ADAPTIVE || bytes < 2_000 * u64::from(n) + 100_000, "{n}: {bytes}");
            }
        }
    }
}
