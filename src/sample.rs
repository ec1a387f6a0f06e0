//! Samples of lists.

use std::iter::StepBy;
use std::slice::Iter;

/// At most `most` of the items, evenly spread from the first on.
///
/// # Panics
/// If `most` is 0.
pub fn evenly<T>(all: &[T], most: usize) -> StepBy<Iter<'_, T>> {
    all.iter().step_by(all.len().div_ceil(most).max(1))
}

/// At most `most` of the items, at even steps over all of them.
pub fn spread<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let count = all.len().min(most);
    (0..count).map(|k| all[k * all.len() / count].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_even() {
        let all = [0, 1, 2, 3, 4, 5, 6];
        assert!(evenly(&all, 7).eq(&all) && evenly(&all, 9).eq(&all));
        assert!(evenly(&all, 6).eq(&[0, 2, 4, 6]) && evenly(&all, 3).eq(&[0, 3, 6]) && evenly(&all, 1).eq(&[0]));
        assert_eq!(evenly(&all[..0], 3).count(), 0);
    }

    #[cfg(feature = "pipeline")]
    #[test]
    fn steps_are_even() {
        let all = [0, 1, 2, 3, 4, 5, 6];
        assert!(spread(&all, 9) == all && spread(&all, 6) == [0, 1, 2, 3, 4, 5] && spread(&all, 3) == [0, 2, 4]);
        assert!(spread(&all, 0).is_empty() && spread(&all[..0], 3).is_empty());
    }
}
