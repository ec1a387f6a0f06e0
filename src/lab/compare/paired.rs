//! Whether two arms differ: differences of PSNR between the same views with the same seeds.

use super::ArmRecord;
use super::records::deviation;
use crate::pipeline::evaluate::mean;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Student's t, two-sided at 95 %, for means of 2 to 10 values.
const T: [f64; 9] = [12.706205, 4.302653, 3.182446, 2.776445, 2.570582, 2.446912, 2.364624, 2.306004, 2.262157];

/// The difference of an arm from the first one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Mean difference of PSNR over views and seeds, in dB.
    pub difference: f64,
    /// Its standard error in dB: the larger of those over views (each the mean over seeds) and over seeds (each the mean over views);
    /// null for a single view and seed.
    pub error: Option<f64>,
    /// The spread over views; null for a single one.
    pub over_views: Option<Sample>,
    /// The spread over seeds; null for a single one: then nothing tells what another seed would give.
    pub over_seeds: Option<Sample>,
    /// False if the difference exceeds `t` standard errors both over views and over seeds, as far as there are several. True if there
    /// is a single view and seed.
    pub tie: bool,
}

/// The values that a mean difference is taken of: one for each view, or one for each seed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Their number, at least two.
    pub n: usize,
    /// Standard error of their mean, in dB.
    pub error: f64,
    /// Student's t for `n` values: a mean without a true difference exceeds `t` standard errors in 5 % of cases.
    pub t: f64,
}

impl Sample {
    /// The statistics of values in dB; none of fewer than two.
    fn of(values: &[f64]) -> Option<Self> {
        let n = values.len();
        Some(Self { n, error: deviation(values)? / (n as f64).sqrt(), t: student(n) })
    }
}

impl fmt::Display for Paired {
    /// Writes the difference as `+0.25±0.03`, in dB, and as `+0.05±0.19 (tie)` if it does not count.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let error = self.error.map_or_else(String::new, |error| format!("±{error:.2}"));
        write!(f, "{:+.2}{error}{}", self.difference, if self.tie { " (tie)" } else { "" })
    }
}

impl Paired {
    /// An arm's difference from `first`, over the views that both have scored with a seed; none without such views.
    pub fn of(arm: &ArmRecord, first: &ArmRecord) -> Option<Self> {
        let (a, b) = (scores(arm), scores(first));
        let difference = |(a, b): (&Option<f64>, &Option<f64>)| Some((*a)? - (*b)?).filter(|d| d.is_finite());
        let rows = a.iter().zip(&b).map(|(a, b)| a.iter().zip(b).map(difference).collect::<Vec<_>>());
        let rows: Vec<Vec<Option<f64>>> = rows.collect();
        let seeds: Vec<f64> = rows.iter().filter_map(|row| mean_of(row.iter())).collect();
        let count = rows.iter().map(Vec::len).max().unwrap_or(0);
        let of_view = |v: usize| mean_of(rows.iter().filter_map(|row| row.get(v)));
        let views: Vec<f64> = (0..count).filter_map(of_view).collect();
        let difference = mean(&seeds)?;
        let (over_views, over_seeds) = (Sample::of(&views), Sample::of(&seeds));
        let samples = || [over_views, over_seeds].into_iter().flatten();
        let error = samples().map(|sample| sample.error).reduce(f64::max);
        let tie = error.is_none() || samples().any(|sample| difference.abs() <= sample.t * sample.error);
        Some(Self { difference, error, over_views, over_seeds, tie })
    }
}

/// PSNR by seed and view.
fn scores(arm: &ArmRecord) -> Vec<Vec<Option<f64>>> {
    if arm.psnr_by_view.is_empty() {
        return vec![arm.views.iter().map(|view| view.scores.psnr).collect()];
    }
    arm.psnr_by_view.clone()
}

fn mean_of<'a>(values: impl Iterator<Item = &'a Option<f64>>) -> Option<f64> {
    mean(&values.copied().flatten().collect::<Vec<f64>>())
}

/// Student's t for the mean of `n` values (at least two): the 97.5 % quantile with n - 1 degrees of freedom. Above ten values by the
/// first terms of its expansion in powers of 1 / (n - 1), too small by at most 1e-5.
fn student(n: usize) -> f64 {
    if let Some(t) = T.get(n.saturating_sub(2)) {
        return *t;
    }
    let x = 1.0 / (n as f64 - 1.0);
    1.959963985 + x * (2.372271230 + x * (2.822498616 + x * (2.555849680 + x * 1.589534053)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm(psnr: &[&[f64]]) -> ArmRecord {
        let psnr_by_view = psnr.iter().map(|views| views.iter().map(|v| Some(*v)).collect()).collect();
        ArmRecord { psnr_by_view, ..ArmRecord::default() }
    }

    #[test]
    fn views_far_apart_do_not_hide_a_difference_that_all_have() {
        let first = arm(&[&[20.0, 30.0, 40.0, 25.0]]);
        let better = Paired::of(&arm(&[&[20.3, 30.2, 40.3, 25.2]]), &first).unwrap();
        assert!(
            (better.difference - 0.25).abs() < 1e-9 && !better.tie && better.to_string() == "+0.25±0.03",
            "{better:?}"
        );
        let mixed = Paired::of(&arm(&[&[20.5, 29.6, 40.4, 24.7]]), &first).unwrap();
        assert!(mixed.tie && (mixed.difference - 0.05).abs() < 1e-9, "{mixed:?}");
    }

    #[test]
    fn students_t_is_that_of_published_tables() {
        let known = [(2, 12.7062), (3, 4.3027), (6, 2.5706), (10, 2.2622), (11, 2.2281), (30, 2.0452), (61, 2.0003)];
        for (n, t) in known.into_iter().chain([(1001, 1.9623), (1_000_000, 1.9600)]) {
            assert!((student(n) - t).abs() < 6e-5, "{n}: {}", student(n));
        }
        assert!((2..300).all(|n| student(n) > student(n + 1)));
    }

    #[test]
    fn few_seeds_have_to_agree_better_than_many() {
        let [flat, low, high]: [&[f64]; 3] = [&[30.0, 31.0], &[30.2, 31.2], &[30.3, 31.3]];
        let first = arm(&[flat; 4]);
        // Differences of 0.2 and 0.3 dB: five standard errors.
        let two = Paired::of(&arm(&[low, high]), &first).unwrap();
        assert!(two.tie && two.difference > 4.9 * two.error.unwrap(), "{two:?}");
        assert_eq!(two.over_seeds.map(|seeds| (seeds.n, seeds.t)), Some((2, T[0])));
        assert!(!Paired::of(&arm(&[low, high, low, high]), &first).unwrap().tie);
        // The same differences of two views, with one seed.
        let one = Paired::of(&arm(&[&[30.2, 31.3]]), &first).unwrap();
        assert!(one.tie && one.over_seeds.is_none() && one.over_views.is_some_and(|views| views.n == 2), "{one:?}");
    }

    #[test]
    fn seeds_that_disagree_make_a_tie() {
        let first = arm(&[&[30.0, 31.0, 32.0], &[30.0, 31.0, 32.0]]);
        let unsure = Paired::of(&arm(&[&[31.0, 32.0, 33.0], &[29.5, 30.5, 31.5]]), &first).unwrap();
        assert!(unsure.tie && (unsure.difference - 0.25).abs() < 1e-9 && unsure.error.unwrap() > 0.7, "{unsure:?}");
    }

    #[test]
    fn without_views_there_is_no_difference_and_a_single_one_tells_nothing() {
        assert_eq!(Paired::of(&arm(&[&[]]), &arm(&[&[]])), None);
        let one = Paired::of(&arm(&[&[31.0]]), &arm(&[&[30.0]])).unwrap();
        assert_eq!((one.difference, one.error, one.tie), (1.0, None, true));
        assert_eq!(one.to_string(), "+1.00 (tie)");
        let infinite = arm(&[&[f64::INFINITY, 30.0, 31.0]]);
        assert_eq!(Paired::of(&infinite, &infinite).map(|p| p.difference), Some(0.0));
    }
}
