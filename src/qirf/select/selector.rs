//! The selectors by name, and the scores of those that rank each Gaussian alone.

use std::str::FromStr;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Ranking;
use crate::qirf::CHANNELS;
use crate::qirf::partition::Blocks;
use crate::random;
use crate::response::{Score, Wanted};
use crate::wording::{named, unknown};

/// Salt of the random selector's numbers.
const SALT: u64 = 0x5e1e_c702;
/// `LightGaussian`: exponent of the volume, and the quantile of volumes that normalises it.
const LIGHT: (f64, f64) = (0.1, 0.9);

named! {
    /// A rule that orders Gaussians, the first to keep first.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Selector {
        /// The paper's generalized, non-orthogonal participation.
        Gnso = "gnso",
        /// Participation with the identity as the metric: the paper's ablation.
        Ordinary = "ordinary",
        /// Norm of a row of (N + eps I)^(-1/2) W.
        Lowdin = "lowdin",
        /// Norm of a row of H.
        Importance = "importance",
        /// Sum over pixels of T alpha.
        Contribution = "contribution",
        /// Opacity.
        Opacity = "opacity",
        /// A seeded random number.
        Random = "random",
        /// Greedy column subset of N, weighted by response.
        #[default]
        Css = "css",
        /// Largest T alpha over pixels (`RadSplat`, by rank).
        Radsplat = "radsplat",
        /// Global significance (`LightGaussian`).
        Lightgaussian = "lightgaussian",
        /// Change of the squared error if only this Gaussian is removed.
        Removal = "removal",
        /// Squared change of the pictures if only this Gaussian is removed, whatever the photos show (`GaussianPOP`).
        Change = "change",
        /// Merging of pairs of neighbours wherever the pictures show it least ([`crate::qirf::pairs`]).
        Pairs = "pairs",
    }
}

impl Selector {
    /// Returns true if it ranks by the overlaps of a block. Of the others, `pairs` merges over the whole model, and the
    /// rest score each Gaussian alone.
    pub fn reads_blocks(self) -> bool {
        matches!(self, Self::Gnso | Self::Ordinary | Self::Lowdin | Self::Css)
    }

    /// The results that it needs of a pass over the training views. With every selector but `pairs`, the detail
    /// safeguard needs channels.
    pub fn reads(self) -> Wanted {
        match self {
            Self::Contribution | Self::Radsplat | Self::Lightgaussian | Self::Change => Wanted::BOTH,
            Self::Removal => Wanted { residual: true, ..Wanted::BOTH },
            Self::Pairs => Wanted::SCORES,
            _ => Wanted::CHANNELS,
        }
    }

    /// Score of each Gaussian (n), the highest kept first; `None` for selectors of blocks and for `pairs`.
    ///
    /// # Panics
    /// If the array that the selector reads is shorter than `statistics.opacity`.
    pub fn score(self, statistics: &Statistics<'_>, seed: u64) -> Option<Vec<f64>> {
        let by = |score: fn(&Score) -> f64| Some(statistics.scores.iter().map(score).collect());
        match self {
            Self::Gnso | Self::Ordinary | Self::Lowdin | Self::Css | Self::Pairs => None,
            Self::Importance => Some(statistics.rows.par_iter().map(importance).collect()),
            Self::Contribution => by(|s| s.contribution.into()),
            Self::Opacity => Some(statistics.opacity.iter().map(|&x| x.into()).collect()),
            Self::Radsplat => by(|s| s.peak.into()),
            Self::Removal => by(Score::removal),
            Self::Change => by(|s| s.change.into()),
            Self::Random => {
                let draw = |i: usize| random::uniform(&[SALT, seed, i as u64]);
                Some((0..statistics.opacity.len()).into_par_iter().map(draw).collect())
            }
            Self::Lightgaussian => Some(lightgaussian(statistics)),
        }
    }

    /// The ranking by [`Selector::score`]; `None` for selectors of blocks and for `pairs`.
    pub fn ranking(self, blocks: &Blocks, statistics: &Statistics<'_>, seed: u64) -> Option<Ranking> {
        self.score(statistics, seed).map(|score| Ranking::by_score(blocks, &score))
    }
}

impl FromStr for Selector {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|selector| selector.name() == name);
        known.ok_or_else(|| unknown(name, "a selector", Self::ALL.map(Self::name)))
    }
}

/// Statistics of each Gaussian, n each; arrays that no requested selector reads may be empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct Statistics<'a> {
    /// Rows of H.
    pub rows: &'a [[f32; CHANNELS]],
    /// Opacity or its logit.
    pub opacity: &'a [f32],
    /// Scores over all views.
    pub scores: &'a [Score],
    /// Natural logarithms of the axes' standard deviations.
    pub log_scales: &'a [[f32; 3]],
}

fn importance(row: &[f32; CHANNELS]) -> f64 {
    row.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt()
}

/// Significance times (volume / its 90th percentile)^0.1, the ratio at most 1.
fn lightgaussian(statistics: &Statistics<'_>) -> Vec<f64> {
    let volumes: Vec<f64> =
        statistics.log_scales.iter().map(|s| s.iter().map(|&x| f64::from(x)).sum::<f64>()).collect();
    let mut sorted: Vec<f64> = volumes.iter().copied().filter(|v| !v.is_nan()).collect();
    let at = ((sorted.len() as f64 * LIGHT.1) as usize).min(sorted.len().saturating_sub(1));
    let reference = if sorted.is_empty() { 0.0 } else { *sorted.select_nth_unstable_by(at, f64::total_cmp).1 };
    let worth = |(s, v): (&Score, &f64)| f64::from(s.significance) * (LIGHT.0 * (v - reference).min(0.0)).exp();
    statistics.scores.iter().zip(&volumes).map(worth).collect()
}
