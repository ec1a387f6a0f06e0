//! A codebook of 256 values in equal steps. At equal bytes after entropy coding no other loses less: a book of means of equally
//! many values makes every byte equally frequent, and leaves rare, large values without entries. Only where 256 steps do not reach
//! from the least to the greatest value do they grow with the distance from the median.

use crate::scene::median;
use serde_json::{Value, json};

/// Entries of a codebook.
const ENTRIES: usize = 256;
/// Significant decimals of a step, so that entries are short numbers.
const DIGITS: i32 = 3;
/// Unequal steps end on the 100,000th part of one.
const PER_UNIT: f64 = 1e5;

/// A rising list of 256 values; the last ones may be alike.
pub(super) struct Book {
    values: Vec<f64>,
}

impl Book {
    /// A book whose entries lie `step` apart, or as far as 256 entries need to reach from the least to the greatest finite value.
    pub fn equal(values: impl Iterator<Item = f32>, step: f64) -> Self {
        let Some([low, _, high]) = limits(values) else { return Self { values: vec![0.0; ENTRIES] } };
        let mut step = tidy(step.max((high - low) / ENTRIES as f64).max(1e-9));
        loop {
            let (first, last) = ((low / step).round(), (high / step).round());
            if last - first < ENTRIES as f64 {
                // Ten decimals drop the noise of the product, not the value: steps have three digits.
                let value = |entry: f64| (entry * step * 1e10).round() / 1e10;
                let mut values: Vec<f64> = (0..=(last - first) as usize).map(|k| value(first + k as f64)).collect();
                // Entries that no value needs are short numbers, so that small files are not mostly codebooks.
                values.resize(ENTRIES, value(last).ceil());
                return Self { values };
            }
            step = tidy(1.005 * step);
        }
    }

    /// A book whose entries lie `step` apart, or, where 256 entries cannot reach that far, near the median only.
    pub fn dense(values: impl Iterator<Item = f32> + Clone, step: f64) -> Self {
        match limits(values.clone()) {
            Some([low, median, high]) if (high - low) / step > (ENTRIES - 2) as f64 => {
                Self::curved([low, median, high], step)
            }
            _ => Self::equal(values, step),
        }
    }

    /// Steps that grow with the distance from the median: equal ones of asinh((x - median) / width), where the width is such that
    /// the step at the median is `step`, or as near to it as the least width allows.
    fn curved([low, median, high]: [f64; 3], step: f64) -> Self {
        let last = (ENTRIES - 1) as f64;
        let curve = |x: f64, width: f64| ((x - median) / width).asinh();
        let at_median = |width: f64| width * (curve(high, width) - curve(low, width)) / last;
        let (mut narrow, mut wide) = ((high - low) * 1e-4, (high - low) * 1e4);
        for _ in 0..60 {
            let width = (narrow * wide).sqrt();
            if at_median(width) > step { wide = width } else { narrow = width }
        }
        let (start, end) = (curve(low, narrow), curve(high, narrow));
        let value = |entry: usize| median + narrow * (start + (end - start) * entry as f64 / last).sinh();
        Self { values: (0..ENTRIES).map(|entry| (value(entry) * PER_UNIT).round() / PER_UNIT).collect() }
    }

    /// The byte whose value is nearest.
    pub fn byte(&self, value: f32) -> u8 {
        let value = f64::from(value);
        let above = self.values.partition_point(|v| *v < value).min(ENTRIES - 1);
        let nearer_below = above > 0 && value - self.values[above - 1] <= self.values[above] - value;
        (above - usize::from(nearer_below)) as u8
    }

    /// All 256 values, as short as they can be written.
    pub fn json(&self) -> Value {
        let whole = |v: f64| v.fract() == 0.0 && v.abs() < 2_f64.powi(53);
        let short = |v: &f64| if whole(*v) { json!(*v as i64) } else { json!(v) };
        self.values.iter().map(short).collect()
    }
}

/// The least, median and greatest of the finite values.
fn limits(values: impl Iterator<Item = f32>) -> Option<[f64; 3]> {
    let mut finite: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    let median = median(&mut finite)?;
    let (low, high) = finite.iter().fold((f32::MAX, f32::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
    Some([low, median, high].map(f64::from))
}

/// The least number of three significant digits that is not below `step`.
fn tidy(step: f64) -> f64 {
    let unit = 10_f64.powi(step.log10().floor() as i32 + 1 - DIGITS);
    (step / unit - 1e-9).ceil() * unit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_steps_round_by_half_a_step_at_most() {
        let values: Vec<f32> = (0..1000).map(|i| (i as f32 * 0.37).sin() * 3.0).collect();
        let book = Book::equal(values.iter().copied(), 0.05);
        for v in &values {
            assert!((book.values[usize::from(book.byte(*v))] - f64::from(*v)).abs() < 0.0251, "{v}");
        }
        assert!(book.values.is_sorted() && book.values.iter().all(|v| v.to_string().len() < 6));
    }

    #[test]
    fn outliers_are_kept_and_cost_those_near_the_median_little() {
        let values = (0..1000).map(|i| (i as f32 * 0.37).sin()).chain([-500.0, 800.0]);
        let book = Book::dense(values.clone(), 0.02);
        for v in values {
            let off = (book.values[usize::from(book.byte(v))] - f64::from(v)).abs();
            // Half a step, which is 0.02 at the median, 0, and grows with the distance; the width is 0.31 here.
            let allowed = if v.abs() > 1.0 { 0.01 * f64::from(v.abs()) } else { 0.01 * f64::from(v / 0.3).hypot(1.0) };
            assert!(off <= allowed, "{v}: {off}");
        }
        assert!(book.values.is_sorted());
    }

    #[test]
    fn nothing_and_one_value_have_books() {
        assert_eq!(Book::dense([f32::NAN].into_iter(), 0.1).values, [0.0; 256]);
        let book = Book::equal([-1.25; 3].into_iter(), 0.001);
        assert_eq!(book.values[usize::from(book.byte(-1.25))], -1.25);
    }

    #[test]
    fn whole_numbers_of_any_size_are_written_as_they_are() {
        let values = Book { values: vec![-1e30, -3.0, 0.5, 1e30] }.json();
        assert_eq!(serde_json::from_value::<Vec<f64>>(values.clone()).unwrap(), [-1e30, -3.0, 0.5, 1e30]);
        assert!(values.to_string().contains(",-3,0.5,"), "{values}");
    }
}
