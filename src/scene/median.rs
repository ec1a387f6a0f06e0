//! The median.

use num_traits::float::TotalOrder;

/// The median of values, which are reordered; the upper of two middle ones, and none without values.
pub(crate) fn median<T: Copy + TotalOrder>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::total_cmp).1)
}
