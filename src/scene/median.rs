//! The median, and weighted quantiles.

use num_traits::float::TotalOrder;
use rayon::prelude::*;

/// The median of values, which are reordered; the upper of two middle ones, and none without values.
pub(crate) fn median<T: Copy + TotalOrder>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::total_cmp).1)
}

/// The value below which this share of the weight lies, of (value, weight), which are sorted by value; none without values.
pub(crate) fn weighted_quantile<T: Copy + TotalOrder + Send>(values: &mut [(T, f64)], share: f64) -> Option<T> {
    values.par_sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|v| v.1).sum();
    let mut sum = 0.0;
    let found = values.iter().find(|v| {
        sum += v.1;
        sum >= share * total
    });
    found.or(values.last()).map(|v| v.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_count_weights() {
        let mut values = [(3.0_f32, 1.0), (1.0, 1.0), (2.0, 6.0)];
        let found = [0.0, 0.125, 0.2, 0.5, 0.9, 1.0].map(|share| weighted_quantile(&mut values, share));
        assert_eq!(found, [1.0, 1.0, 2.0, 2.0, 3.0, 3.0].map(Some));
        assert_eq!(weighted_quantile(&mut [(5.0, f64::NAN)], 0.5), Some(5.0));
        assert_eq!(weighted_quantile::<f64>(&mut [], 0.5), None);
    }
}
