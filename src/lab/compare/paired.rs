//! Whether two arms differ: differences of PSNR between the same views with the same seeds.

use super::ArmRecord;
use super::records::deviation;
use crate::pipeline::evaluate::mean;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Standard errors up to which a difference is a tie.
const TIED: f64 = 2.0;

/// The difference of an arm from the first one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Mean difference of PSNR over views and seeds, in dB.
    pub difference: f64,
    /// Its standard error in dB: the larger of those over views (each the mean over seeds) and over seeds (each the mean over views);
    /// null for a single view and seed.
    pub error: Option<f64>,
    /// True if the difference is at most two standard errors, or if there is no error to compare it with.
    pub tie: bool,
}

impl fmt::Display for Paired {
    /// Writes the difference as `+0.25±0.03`, in dB.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let error = self.error.map_or_else(String::new, |error| format!("±{error:.2}"));
        write!(f, "{:+.2}{error}", self.difference)
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
        let error = [error(&seeds), error(&views)].into_iter().flatten().reduce(f64::max);
        Some(Self { difference, error, tie: error.is_none_or(|error| difference.abs() <= TIED * error) })
    }
}

/// PSNR by seed and view.
fn scores(arm: &ArmRecord) -> Vec<Vec<Option<f64>>> {
    if arm.psnr_by_view.is_empty() {
        return vec![arm.views.iter().map(|view| view.scores.psnr).collect()];
    }
    arm.psnr_by_view.clone()
}

/// Mean of the values that there are.
fn mean_of<'a>(values: impl Iterator<Item = &'a Option<f64>>) -> Option<f64> {
    mean(&values.copied().flatten().collect::<Vec<f64>>())
}

/// Standard error of a mean; none of fewer than two values.
fn error(values: &[f64]) -> Option<f64> {
    Some(deviation(values)? / (values.len() as f64).sqrt())
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
        assert_eq!(one.to_string(), "+1.00");
        let infinite = arm(&[&[f64::INFINITY, 30.0, 31.0]]);
        assert_eq!(Paired::of(&infinite, &infinite).map(|p| p.difference), Some(0.0));
    }
}
