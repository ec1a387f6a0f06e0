//! Masks learnt with the model (Compact3DGS, Lee et al. 2024; MaskGaussian, Liu et al. 2025): each Gaussian has a
//! score, and pictures leave out those whose mask is 0. The loss grows with the masks' mean, so that Gaussians which
//! pictures do not need are masked; these are removed at density steps and, afterwards, at intervals. Neither method
//! takes a target number: at the end of a window the model is cut to it by the scores.

mod device;

pub use device::LearntMask;

use crate::job::config::MethodConfig;
use crate::job::config::ranges::{MOST_GAUSSIANS, SHARE, WEIGHT, within};
use crate::kernels::constants::learnt_mask::LEAST_SCORE;
use crate::random;
use crate::train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Its name in `config.toml`, and the profiler's scope.
pub const NAME: &str = "learnt mask";

/// Length of the run that the published rate is meant for, the rate itself, and the exponent by which shorter runs have
/// a higher rate and weight.
const REFERENCE: (f64, f64, f64) = (30_000.0, 0.01, 0.7);
/// Share of the run between two removals after the last density step.
const BETWEEN: f64 = 1.0 / 30.0;
/// `MaskGaussian`: a Gaussian that is masked in this many draws is removed.
const DRAWS: i32 = 10;
/// Salt of the random numbers for these draws.
const SALT: u64 = 0x6d61_736b;

/// Method of learning masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskMethod {
    /// Compact3DGS: the sigmoid of the score, rounded: 0 up to 0.01.
    Compact3dgs,
    /// `MaskGaussian`: drawn anew in every iteration, 1 with the sigmoid of the score as its probability. The score is
    /// the difference of that method's two scores.
    MaskGaussian,
}

impl MaskMethod {
    /// Score before the first iteration.
    pub const fn first_score(self) -> f32 {
        match self {
            Self::Compact3dgs => 1.0,
            Self::MaskGaussian => 9.0,
        }
    }

    /// Returns true if masks are drawn at random.
    pub fn samples(self) -> bool {
        self == Self::MaskGaussian
    }

    /// The score above which a Gaussian is more likely shown than not.
    fn least(self) -> f32 {
        match self {
            Self::Compact3dgs => LEAST_SCORE,
            Self::MaskGaussian => 0.0,
        }
    }

    /// Weight of the masks in the loss of a run of the published length. The published weights, 5e-4 and 5e-4 to 1e-3,
    /// leave more Gaussians; with these about as many remain as are usually to be kept. docs/decisions.md (71) has the
    /// figures.
    fn weight(self) -> f64 {
        match self {
            Self::Compact3dgs => 1.85e-3,
            Self::MaskGaussian => 1.4e-3,
        }
    }
}

/// Learnt masks, as written to `config.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearntMasks {
    /// Method that learns them.
    pub method: MaskMethod,
    /// Number of Gaussians left at the end of the window; never fewer before.
    pub survivors: usize,
    /// Share of the run at which the window ends.
    pub until: f64,
    /// Learning rate of a score.
    pub rate: f64,
    /// Weight in the loss of the masks' mean (Compact3DGS) or of its square (`MaskGaussian`).
    pub weight: f64,
}

/// The `count` rows with the greatest scores, rising; among equal scores the first.
pub(super) fn greatest(scores: &[f32], count: usize) -> Vec<u32> {
    let mut rows: Vec<u32> = (0..scores.len() as u32).collect();
    // Stable sort; NaN is removed first.
    let rank = |i: &u32| Some(scores[*i as usize]).filter(|s| !s.is_nan()).unwrap_or(f32::NEG_INFINITY);
    rows.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
    rows.truncate(count);
    rows.sort_unstable();
    rows
}

impl LearntMasks {
    /// Masks of a run of this length that are to leave `survivors` Gaussians.
    pub fn of(method: MaskMethod, survivors: usize, iterations: u32) -> Self {
        let (length, rate, power) = REFERENCE;
        let shorter = (length / f64::from(iterations.max(1))).max(1.0).powf(power);
        Self { method, survivors, until: 0.75, rate: rate * shorter, weight: method.weight() * shorter }
    }

    /// Learning rate of the stored score: the difference of two scores that move against each other moves twice as
    /// fast.
    pub fn step_rate(&self) -> f64 {
        if self.method.samples() { 2.0 * self.rate } else { self.rate }
    }

    /// Number of Gaussians that are more likely shown than masked.
    pub fn shown(&self, scores: &[f32]) -> usize {
        scores.iter().filter(|s| **s > self.method.least()).count()
    }

    /// The rows that stay, rising: those that are not masked, but never fewer than the survivors.
    pub fn judge(&self, scores: &[f32], [seed, iteration]: [u32; 2]) -> Vec<u32> {
        let stays = |i: &u32| {
            let score = scores[*i as usize];
            if !self.method.samples() {
                return score > LEAST_SCORE;
            }
            // The probability that all draws are 0.
            let goes = (1.0 / (1.0 + f64::from(score).exp())).powi(DRAWS);
            random::uniform(&[u64::from(seed), u64::from(iteration), u64::from(*i), SALT]) >= goes
        };
        let stay: Vec<u32> = (0..scores.len() as u32).filter(stays).collect();
        if stay.len() < self.survivors { greatest(scores, self.survivors) } else { stay }
    }

    /// The iteration after which masks end: at least the first, at most the last.
    pub fn last(&self, schedule: &Schedule) -> u32 {
        let last = (f64::from(schedule.iterations) * self.until).round() as u32;
        last.clamp(1, schedule.iterations.max(1))
    }

    /// Returns true if masked Gaussians are removed after iteration `iteration`.
    pub fn thins(&self, schedule: &Schedule, iteration: u32) -> bool {
        let every = ((f64::from(schedule.iterations) * BETWEEN).round() as u32).max(1);
        let later = iteration >= schedule.growing().1 && iteration.is_multiple_of(every);
        let last = self.last(schedule);
        iteration == last || iteration < last && (later || schedule.densifies(iteration))
    }

    /// Reads the masks' settings from a configuration.
    pub fn read(config: &MethodConfig) -> Result<Self, String> {
        let read: Self = config.read()?;
        within("method.survivors", read.survivors, &(1..=MOST_GAUSSIANS))?;
        within("method.until", read.until, &SHARE)?;
        within("method.rate", read.rate, &WEIGHT)?;
        within("method.weight", read.weight, &WEIGHT)?;
        Ok(read)
    }

    /// Their configuration.
    pub fn config(&self) -> MethodConfig {
        MethodConfig::new(NAME, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_masked_go_but_never_too_many() {
        let compact = |survivors| LearntMasks::of(MaskMethod::Compact3dgs, survivors, 1000);
        let scores = [1.0, -4.6, -4.59, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -5.0];
        assert_eq!(compact(2).judge(&scores, [1, 2]), [0, 2, 4]);
        assert_eq!(compact(4).judge(&scores, [1, 2]), [0, 1, 2, 4], "topped up by the score");
        assert_eq!(compact(9).judge(&scores, [1, 2]).len(), 7);
        assert_eq!(compact(2).judge(&[-9.0; 5], [1, 2]), [0, 1], "of equal ones the first");
        assert_eq!((compact(2).shown(&scores), compact(2).judge(&[], [1, 2]).len()), (3, 0));
    }

    /// A share of (1 - P)^10 is removed at once; draws depend on seed and iteration.
    #[test]
    fn those_that_ten_draws_mask_go() {
        let masks = LearntMasks::of(MaskMethod::MaskGaussian, 1, 1000);
        let chance = 0.1_f64;
        let scores = vec![(chance / (1.0 - chance)).ln() as f32; 10_000];
        let stay = masks.judge(&scores, [1, 2]);
        let expected = 1e4 * (1.0 - (1.0 - chance).powi(10));
        // Five standard deviations.
        assert!((stay.len() as f64 - expected).abs() < 5.0 * (1e4 * 0.35_f64 * 0.65).sqrt(), "{}", stay.len());
        assert_eq!(stay, masks.judge(&scores, [1, 2]));
        assert_ne!(stay, masks.judge(&scores, [1, 3]));
        let sure = [50.0, 1e30, f32::INFINITY, -1e30, f32::NEG_INFINITY, f32::NAN];
        assert_eq!(masks.judge(&sure, [1, 2]), [0, 1, 2], "what is not a number goes");
        assert_eq!(masks.shown(&[0.1, -0.1, f32::NAN]), 1);
    }

    #[test]
    fn masks_of_short_runs_move_faster() {
        let rate = |iterations| LearntMasks::of(MaskMethod::Compact3dgs, 1, iterations).rate;
        assert!(rate(30_000) == 0.01 && rate(60_000) == 0.01 && (rate(1000) / 0.1081 - 1.0).abs() < 1e-3);
        assert!(LearntMasks::of(MaskMethod::MaskGaussian, 1, 0).step_rate().is_finite());
        assert_eq!(LearntMasks::of(MaskMethod::MaskGaussian, 1, 30_000).step_rate(), 0.02);
    }

    /// Every density step, and each thirtieth of the run after these, up to the end of the window.
    #[test]
    fn when_the_masked_go() {
        let masks = LearntMasks::of(MaskMethod::Compact3dgs, 1, 3000);
        let schedule = Schedule::of(3000);
        let at: Vec<u32> = (1..=3000).filter(|i| masks.thins(&schedule, *i)).collect();
        assert_eq!((at[0], at.len(), masks.last(&schedule)), (100, 23, 2250));
        assert_eq!(at[14..], [1500, 1600, 1700, 1800, 1900, 2000, 2100, 2200, 2250]);
        assert_eq!(LearntMasks { until: 0.0, ..masks }.last(&Schedule::of(0)), 1);
    }
}
