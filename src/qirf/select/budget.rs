//! Budgets: from ranks and gains to a keep mask of exactly the wanted count.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Ranking, rounded};
use crate::qirf::partition::Blocks;
use crate::wording::named;

/// Shares are rounded to millionths, so that counts are computed from integers.
const MILLION: u128 = 1_000_000;
/// Largest share of the kept Gaussians, as one in this many, that the detail safeguard may choose.
pub const MOST_DETAIL: usize = 5;

named! {
    /// Distribution of the count over blocks.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Budget {
        /// Each block keeps its share.
        PerBlock = "per-block",
        /// Half of the count by the blocks' shares, half by gain over the scene.
        #[default]
        Hybrid = "hybrid",
        /// The whole count by gain over the scene.
        Global = "global",
    }
}

/// Number of Gaussians to keep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Keep {
    /// The paper's rule: each block keeps max(r, ceil(kappa m)), plus the detail safeguard.
    Paper {
        /// Smallest share of a block.
        kappa: f64,
    },
    /// This share of the scene, including the detail safeguard.
    Share(f64),
    /// Exactly this number, including the detail safeguard, or all if there are fewer.
    Count(usize),
}

impl Keep {
    /// The default share: the paper's mean.
    pub const SHARE: f64 = 0.28;

    /// The number kept of `n`: of few Gaussians, a share keeps at least one. The paper's rule depends on the blocks; it counts here as its
    /// smallest share.
    pub fn count(self, n: usize) -> usize {
        let of = |share: f64| ((millionths(share) * n as u128 + MILLION / 2) / MILLION) as usize;
        match self {
            Self::Share(share) | Self::Paper { kappa: share } => of(share).max(n.min(1)),
            Self::Count(count) => count.min(n),
        }
    }
}

/// A keep mask, and the number kept for each reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// Keep mask: one mark per Gaussian, n.
    pub keep: Vec<bool>,
    /// Number kept by rank or gain.
    pub main: usize,
    /// Number kept by the detail safeguard.
    pub detail: usize,
    /// Marks of the Gaussians kept by the detail safeguard; empty without it.
    pub saved: Vec<bool>,
}

impl Choice {
    /// Number of Gaussians kept.
    pub fn kept(&self) -> usize {
        self.main + self.detail
    }
}

/// The detail safeguard: a score for each Gaussian, and the share of the scene that it keeps.
#[derive(Clone, Copy, Debug)]
pub struct Safeguard<'a> {
    /// See [`super::detail::scores`], n.
    pub scores: &'a [f64],
    /// Share of all Gaussians: 0.05 in the paper.
    pub share: f64,
}

/// Chooses the Gaussians to keep. `r` holds each block's r, which only [`Keep::Paper`] reads; that rule always keeps by
/// block.
///
/// # Panics
/// If the lengths of the arrays disagree with `blocks`.
pub fn choose(
    blocks: &Blocks,
    ranking: &Ranking,
    r: &[u32],
    budget: Budget,
    keep: Keep,
    safeguard: Option<Safeguard<'_>>,
) -> Choice {
    let n = blocks.members.len();
    let detail = safeguard.map_or(0, |s| (millionths(s.share) * n as u128 / MILLION) as usize);
    let mut choice = Choice { keep: vec![false; n], main: 0, detail: 0, saved: Vec::new() };
    let detail = if let Keep::Paper { kappa } = keep {
        let kappa = millionths(kappa);
        let least = |m: usize| ((kappa * m as u128).div_ceil(MILLION)) as usize;
        let quotas: Vec<usize> =
            blocks.iter().zip(r).map(|(members, &r)| least(members.len()).max(r as usize).min(members.len())).collect();
        by_rank(blocks, ranking, &quotas, &mut choice.keep);
        choice.main = quotas.iter().sum();
        detail.min(n - choice.main)
    } else {
        let target = keep.count(n);
        let detail = detail.min(target / MOST_DETAIL);
        choice.main = target - detail;
        let shared = match budget {
            Budget::PerBlock => choice.main,
            Budget::Hybrid => choice.main.div_ceil(2),
            Budget::Global => 0,
        };
        by_rank(blocks, ranking, &quotas(blocks, shared), &mut choice.keep);
        by_gain(ranking, choice.main - shared, &mut choice.keep);
        detail
    };
    if let Some(safeguard) = safeguard {
        choice.detail = detail;
        let before = choice.keep.clone();
        by_score(safeguard.scores, detail, &mut choice.keep);
        choice.saved = choice.keep.iter().zip(before).map(|(now, before)| *now && !before).collect();
    }
    choice
}

/// Distributes `total` in proportion to the blocks' members by largest remainder, ties by index; the shares sum to
/// `total`.
///
/// No block gets more than its members, if `total` is at most the number of all members.
pub fn quotas(blocks: &Blocks, total: usize) -> Vec<usize> {
    let n = blocks.members.len().max(1) as u128;
    let exact = |members: &[u32]| total as u128 * members.len() as u128;
    let mut quotas: Vec<usize> = blocks.iter().map(|b| (exact(b) / n) as usize).collect();
    let mut remainders: Vec<(u128, usize)> = blocks.iter().map(|b| exact(b) % n).zip(0..).collect();
    remainders.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let short = total.saturating_sub(quotas.iter().sum());
    remainders.iter().take(short).for_each(|&(_, b)| quotas[b] += 1);
    quotas
}

fn millionths(share: f64) -> u128 {
    (share.clamp(0.0, 1.0) * MILLION as f64).round() as u128
}

fn by_rank(blocks: &Blocks, ranking: &Ranking, quotas: &[usize], keep: &mut [bool]) {
    for (members, &quota) in blocks.iter().zip(quotas) {
        for &i in members {
            keep[i as usize] |= (ranking.rank[i as usize] as usize) < quota;
        }
    }
}

/// Keeps the `count` Gaussians of greatest gain among those not kept yet; equal gains by rank in the block, then by
/// index.
fn by_gain(ranking: &Ranking, count: usize, keep: &mut [bool]) {
    best(count, keep, |i| rounded(ranking.gain[i]), |i| ranking.rank[i]);
}

/// Keeps the `count` Gaussians of greatest score among those not kept yet; equal scores by index.
fn by_score(scores: &[f64], count: usize, keep: &mut [bool]) {
    best(count, keep, |i| rounded(scores[i]), |_| 0);
}

fn best(count: usize, keep: &mut [bool], key: impl Fn(usize) -> f64, second: impl Fn(usize) -> u32) {
    if count == 0 {
        return;
    }
    let mut open: Vec<(f64, u32, u32)> =
        (0..keep.len()).filter(|&i| !keep[i]).map(|i| (key(i), second(i), i as u32)).collect();
    open.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    open.iter().take(count).for_each(|&(_, _, i)| keep[i as usize] = true);
}
