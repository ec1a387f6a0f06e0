//! Pruning of a model: rule and schedule.

use crate::qirf::participation::Eigensolver;
use crate::qirf::partition::Partition;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep, MOST_DETAIL};
use crate::qirf::study::Basis;
use crate::train::attrition::Attrition;
use serde::{Deserialize, Serialize};

/// Choice of Gaussians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PruneRule {
    /// Selector that ranks them.
    pub selector: Selector,
    /// Division of the count among blocks.
    pub budget: Budget,
    /// Number or share to keep.
    pub keep: Keep,
    /// Share of all Gaussians that the detail safeguard keeps; except by [`Keep::Paper`], at most a fifth of those kept.
    pub detail: f64,
    /// True if dropped Gaussians are merged into kept ones where that reduces a block's error.
    pub merge: bool,
    /// Blocks and their solution.
    pub basis: Basis,
}

impl Default for PruneRule {
    fn default() -> Self {
        Self {
            selector: Selector::Css,
            budget: Budget::Hybrid,
            keep: Keep::Share(Keep::SHARE),
            detail: 0.05,
            merge: true,
            basis: Basis::default(),
        }
    }
}

impl PruneRule {
    /// Every choice as in the paper.
    pub fn paper() -> Self {
        Self {
            selector: Selector::Gnso,
            budget: Budget::PerBlock,
            merge: false,
            keep: Keep::Paper { kappa: 0.22 },
            basis: Basis { partition: Partition::PAPER, solver: Eigensolver::Dsygvd, ..Basis::default() },
            ..Self::default()
        }
    }

    /// A note if a prune that keeps `keep` of `n` Gaussians reserves fewer for detail than this rule names, unless that is
    /// the default.
    pub fn detail_note(&self, keep: Keep, n: usize) -> Option<String> {
        let kept = keep.count(n);
        let (asked, most) = ((self.detail * n as f64) as usize, kept / MOST_DETAIL);
        let limited = self.selector != Selector::Pairs && !matches!(keep, Keep::Paper { .. });
        let told = limited && asked > most && self.detail != Self::default().detail;
        let share = self.detail;
        told.then(|| {
            format!("--detail {share} would reserve {asked} Gaussians; {most} are reserved, a fifth of the {kept} kept")
        })
    }
}

/// Source of the responses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResponseSource {
    /// One pass over all training views at the prune.
    #[default]
    FullPass,
    /// The paper's moving average over the iterations before the prune.
    Average,
}

/// When and how a run prunes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pruning {
    /// Shares of the run at which it prunes, ascending; the counts fall by equal factors from one prune to the next.
    pub at: Vec<f64>,
    /// Source of the responses.
    pub responses: ResponseSource,
    /// Share of the run from which responses are averaged.
    pub average_from: f64,
    /// Weight of the mean squared error in the loss of the fine-tuning.
    pub l2: f64,
    /// Share of the run from which that loss holds, where it does not begin with the first prune.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub l2_from: Option<f64>,
    /// Attrition to nearly the number kept, which begins at the first prune and ends with its choice of Gaussians;
    /// further prunes are then left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attrition: Option<Attrition>,
    /// True if rates are re-warmed after the last prune.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub rewarm: bool,
    /// Choice of Gaussians.
    pub compression: PruneRule,
}

impl Pruning {
    /// Weight of the mean squared error in the fine-tuning's loss, as in the paper.
    pub const L2: f64 = 2.0;
}

impl Default for Pruning {
    fn default() -> Self {
        Self {
            at: vec![0.5],
            responses: ResponseSource::default(),
            average_from: 13.0 / 30.0,
            l2: Self::L2,
            l2_from: None,
            attrition: Some(Attrition::default()),
            rewarm: true,
            compression: PruneRule::default(),
        }
    }
}

impl Pruning {
    /// Every choice as in the paper.
    pub fn paper() -> Self {
        Self { responses: ResponseSource::Average, compression: PruneRule::paper(), ..Self::at_once() }
    }

    /// One prune at half the run, without attrition.
    pub fn at_once() -> Self {
        Self { attrition: None, rewarm: false, ..Self::default() }
    }

    /// Four prunes, without attrition.
    pub fn gradual() -> Self {
        Self { at: Self::GRADUAL.to_vec(), ..Self::at_once() }
    }

    /// Shares of the run at which the gradual schedule prunes.
    pub const GRADUAL: [f64; 4] = [13.0 / 30.0, 15.0 / 30.0, 17.0 / 30.0, 20.0 / 30.0];

    /// The iterations after which a run of this length prunes; with attrition, the one after which that begins.
    pub fn iterations(&self, length: u32) -> Vec<u32> {
        let mut at: Vec<u32> = self.at.iter().map(|share| after(*share, length)).collect();
        at.dedup();
        if self.attrition.is_some() {
            at.truncate(1);
        }
        at
    }

    /// The iteration of a run of this length after which the fine-tuning's loss holds without a prune, if there is one.
    pub fn fine_tuned_from(&self, length: u32) -> Option<u32> {
        self.l2_from.map(|share| after(share, length))
    }

    /// Number of `now` Gaussians that attrition leaves.
    pub fn survivors(&self, now: usize) -> usize {
        self.compression.keep.count(now)
    }

    /// Number or share that prune number `step` (from 0) of `steps` keeps of the current `now` Gaussians.
    pub fn keep(&self, step: usize, steps: usize, now: usize) -> Keep {
        let left = steps.saturating_sub(step).max(1) as f64;
        let target = match self.compression.keep {
            paper @ Keep::Paper { .. } if left == 1.0 => return paper,
            Keep::Paper { kappa } => return Keep::Paper { kappa: kappa.powf(1.0 / left) },
            // The share is of the Gaussians before the first prune: of `now`, what is left of it.
            Keep::Share(share) => return Keep::Share(share.powf(1.0 / steps.max(1) as f64)),
            Keep::Count(count) => count.min(now) as f64,
        };
        let ratio = (target / now.max(1) as f64).powf(1.0 / left);
        Keep::Count((now as f64 * ratio).round() as usize)
    }
}

/// The iteration at this share of a run.
fn after(share: f64, length: u32) -> u32 {
    (f64::from(length) * share).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradual_prunes_end_at_the_share_asked_for() {
        let pruning = Pruning::gradual();
        assert_eq!(pruning.iterations(30_000), [13_000, 15_000, 17_000, 20_000]);
        let share: f64 = (0..4)
            .map(|k| match pruning.keep(k, 4, 1000) {
                Keep::Share(share) => share,
                other => panic!("{other:?}"),
            })
            .product();
        assert!((share - 0.28).abs() < 1e-12);
    }

    #[test]
    fn reduced_detail_is_told_unless_it_is_the_default() {
        let rule = |detail, selector| PruneRule { selector, detail, ..PruneRule::default() };
        let note = |detail, keep| rule(detail, Selector::Css).detail_note(keep, 5000);
        let told = note(0.9, Keep::Share(0.28)).unwrap();
        assert!(told.contains("4500 Gaussians; 280 are reserved, a fifth of the 1400 kept"), "{told}");
        for (detail, keep) in [(0.056, Keep::Share(0.28)), (0.05, Keep::Count(50)), (0.9, Keep::Paper { kappa: 0.2 })] {
            assert_eq!(note(detail, keep), None);
        }
        assert_eq!(rule(0.9, Selector::Pairs).detail_note(Keep::Share(0.28), 5000), None);
    }

    #[test]
    fn an_exact_count_is_reached_by_the_last_prune() {
        let mut pruning = Pruning { at: vec![0.4, 0.5, 0.6], ..Pruning::at_once() };
        pruning.compression.keep = Keep::Count(123);
        let mut now = 1000;
        for k in 0..3 {
            let Keep::Count(n) = pruning.keep(k, 3, now) else { panic!("a count") };
            assert!(n < now);
            now = n;
        }
        assert_eq!(now, 123);
        assert_eq!(pruning.keep(0, 1, 50), Keep::Count(50), "never more than there are");
    }
}
