//! The mean of a run's last iterates. Learning rates do not fall to zero, so the last gradients leave each iterate
//! beside the optimum; the mean lies nearer (B. T. Polyak, A. B. Juditsky: Acceleration of stochastic approximation by
//! averaging, 1992). Parameters are averaged in their stored form: in this short time they hardly move.

use super::error::Result;
use super::schedule::Schedule;
use crate::gaussians::{Gaussians, resident::Resident};
use crate::gpu::Device;
use rayon::iter::{IndexedParallelIterator, IntoParallelRefMutIterator, ParallelIterator};

/// Largest number of iterates in a mean.
const ITERATES: u32 = 20;
/// Least number of values that a thread averages.
const PART: usize = 1 << 16;

/// The mean of iterates so far.
#[derive(Clone, Debug, PartialEq)]
pub struct Mean {
    /// The mean.
    pub model: Gaussians,
    /// Number of iterates in it.
    pub iterates: u32,
}

impl Mean {
    /// Adds a model of the same Gaussians to a mean, which begins with it if there is none.
    pub(super) fn with(mean: Option<Self>, device: &Device, model: &Resident) -> Result<Self> {
        let Some(Self { model: mut mean, iterates }) = mean else {
            return Ok(Self { model: model.download(device)?, iterates: 1 });
        };
        let iterates = iterates.saturating_add(1);
        model.parameters.each_ref().zip(mean.attributes_mut()).try_map(|(values, mean)| {
            values.read_parts(device, mean.len(), |first, values| take(&mut mean[first..], values, iterates))
        })?;
        Ok(Self { model: mean, iterates })
    }
}

/// Adds values to their means as iterate number `iterates`.
fn take(means: &mut [f32], values: &[f32], iterates: u32) {
    let pairs = means.par_iter_mut().zip(values).with_min_len(PART);
    pairs.for_each(|(mean, value)| *mean += (value - *mean) / iterates as f32);
}

impl Schedule {
    /// Returns true if the iterate after iteration `iteration` belongs to the mean that is the run's result.
    pub fn averages_iterates(&self, iteration: u32) -> bool {
        let (from, last) = (f64::from(self.iterations) * self.mean_from, self.iterations);
        let every = ((f64::from(last) - from) / f64::from(ITERATES)).ceil().max(1.0) as u32;
        iteration <= last && f64::from(iteration) > from && (last - iteration).is_multiple_of(every)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn the_mean_is_that_of_float64() {
        let mut r = Random(3);
        let iterates: Vec<Vec<f32>> = (0..20).map(|_| (0..500).map(|_| r.within(-9.0, 1.0) as f32).collect()).collect();
        let mut means = iterates[0].clone();
        (1..20).for_each(|k| take(&mut means, &iterates[k], k as u32 + 1));
        for (i, mean) in means.iter().enumerate() {
            let sum: f64 = iterates.iter().map(|values| f64::from(values[i])).sum();
            assert!((f64::from(*mean) - sum / 20.0).abs() < 1e-5, "{mean}, {}", sum / 20.0);
        }
        // The mean of equal iterates is that iterate, to the bit.
        let mut same = iterates[0].clone();
        take(&mut same, &iterates[0], 7);
        assert_eq!(same, iterates[0]);
    }

    #[test]
    fn twenty_iterates_of_the_last_twentieth() {
        let of = |iterations: u32| -> Vec<u32> {
            let schedule = Schedule { mean_from: 0.95, ..Schedule::of(iterations) };
            (0..=iterations + 100).filter(|i| schedule.averages_iterates(*i)).collect()
        };
        let long = of(30_000);
        assert_eq!((long.len(), long[0], long[19]), (20, 28_575, 30_000));
        assert_eq!((of(500).len(), of(2000).len()), (13, 20));
        assert_eq!((of(20), of(1)), (vec![20], vec![1]));
        let never = Schedule { mean_from: 1.0, ..Schedule::of(500) };
        assert!((0..=600).all(|i| !never.averages_iterates(i)));
        assert!((1..1000).all(|i| !Schedule::still().averages_iterates(i)));
    }
}
