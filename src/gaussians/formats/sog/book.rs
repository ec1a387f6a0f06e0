//! A codebook of 256 values in equal steps. At equal bytes after entropy coding no other loses less: a book of means of equally
//! many values makes every byte equally frequent, and leaves rare, large values without entries. Only where 256 steps do not reach
//! from the least to the greatest value do they grow with the distance from the median. Equal values, such as the scales of a poster, would
//! all be off by the same part of a step: an entry of many such values is their mean.

use crate::scene::median;
use serde_json::{Value, json};

/// Entries of a codebook.
const ENTRIES: usize = 256;
/// Significant decimals of a step, so that entries are short numbers.
const DIGITS: i32 = 3;
/// Decimals of an entry that is a mean, beyond the first of the step.
const MEAN_DIGITS: i32 = 3;
/// Squared error, in squared steps, that an entry must save to be written as a longer number. Two bytes of textures save as much: n values
/// have an error of n/12, of which a bit saves 2 ln 2 / n.
const WORTH: f64 = 2.0;
/// Unequal steps end on the 100,000th part of one.
const PER_UNIT: f64 = 1e5;

/// 256 values; the last ones may be alike.
pub(super) struct Book {
    /// The rising values by which bytes are chosen.
    grid: Vec<f64>,
    /// Those that are written.
    values: Vec<f64>,
}

impl Book {
    /// A book whose entries lie `step` apart, or as far as 256 entries need to reach from the least to the greatest finite value.
    pub fn equal(values: impl Iterator<Item = f32> + Clone, step: f64) -> Self {
        let [low, _, high] = limits(values.clone()).unwrap_or_default();
        let mut step = tidy(step.max((high - low) / ENTRIES as f64).max(1e-9));
        loop {
            let (first, last) = ((low / step).round(), (high / step).round());
            if last - first < ENTRIES as f64 {
                // Ten decimals drop the noise of the product, not the value: steps have three digits.
                let value = |entry: f64| (entry * step * 1e10).round() / 1e10;
                let mut grid: Vec<f64> = (0..=(last - first) as usize).map(|k| value(first + k as f64)).collect();
                // Entries that no value needs are short numbers, so that small files are not mostly codebooks.
                grid.resize(ENTRIES, value(last).ceil());
                return Self::centred(grid, values, step);
            }
            step = tidy(1.005 * step);
        }
    }

    /// A book whose entries lie `step` apart, or, where 256 entries cannot reach that far, near the median only.
    pub fn dense(values: impl Iterator<Item = f32> + Clone, step: f64) -> Self {
        match limits(values.clone()) {
            Some([low, median, high]) if (high - low) / step > (ENTRIES - 2) as f64 => {
                Self::centred(curved([low, median, high], step), values, step)
            }
            _ => Self::equal(values, step),
        }
    }

    /// A grid whose entries are replaced by the mean of the values nearest to them where that saves enough.
    fn centred(grid: Vec<f64>, values: impl Iterator<Item = f32>, step: f64) -> Self {
        let mut book = Self { values: grid.clone(), grid };
        let mut sums = vec![(0.0, 0.0); ENTRIES];
        for value in values.filter(|v| v.is_finite()) {
            let byte = usize::from(book.byte(value));
            let (count, off) = &mut sums[byte];
            *count += 1.0;
            *off += f64::from(value) - book.grid[byte];
        }
        let per_unit = 10_f64.powi(MEAN_DIGITS - step.log10().floor() as i32);
        for (value, (count, off)) in book.values.iter_mut().zip(sums) {
            if off * off > WORTH * step * step * count {
                *value = ((*value + off / count) * per_unit).round() / per_unit;
            }
        }
        book
    }

    /// The byte whose value is nearest.
    pub fn byte(&self, value: f32) -> u8 {
        let value = f64::from(value);
        let above = self.grid.partition_point(|v| *v < value).min(ENTRIES - 1);
        let nearer_below = above > 0 && value - self.grid[above - 1] <= self.grid[above] - value;
        (above - usize::from(nearer_below)) as u8
    }

    /// All 256 values, as short as they can be written.
    pub fn json(&self) -> Value {
        let whole = |v: f64| v.fract() == 0.0 && v.abs() < 2_f64.powi(53);
        let short = |v: &f64| if whole(*v) { json!(*v as i64) } else { json!(v) };
        self.values.iter().map(short).collect()
    }
}

/// Steps that grow with the distance from the median: equal ones of asinh((x - median) / width), where the width is such that
/// the step at the median is `step`, or as near to it as the least width allows.
fn curved([low, median, high]: [f64; 3], step: f64) -> Vec<f64> {
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
    (0..ENTRIES).map(|entry| (value(entry) * PER_UNIT).round() / PER_UNIT).collect()
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
        let values: Vec<f32> = (0..1000).map(|i| (i % 41) as f32 * 0.1 - 1.98).collect();
        let book = Book::equal(values.iter().copied(), 0.05);
        for v in &values {
            assert!((book.grid[usize::from(book.byte(*v))] - f64::from(*v)).abs() < 0.0251, "{v}");
        }
        assert!(book.grid.is_sorted() && book.grid.iter().all(|v| v.to_string().len() < 6));
        let off = |entries: &[f64]| {
            values.iter().map(|v| (entries[usize::from(book.byte(*v))] - f64::from(*v)).powi(2)).sum::<f64>()
        };
        assert!(off(&book.values) < off(&book.grid));
    }

    /// Only where they are many: short numbers make small files.
    #[test]
    fn equal_values_are_kept() {
        for count in [1, 1000] {
            let values = [vec![-3.4793; count], vec![-2.0, -1.0]].concat();
            let book = Book::equal(values.into_iter(), 0.25);
            let wanted = if count == 1 { -3.5 } else { -3.4793 };
            assert_eq!(book.values[usize::from(book.byte(-3.4793))], wanted);
            assert_eq!(book.values[usize::from(book.byte(-2.0))], -2.0);
        }
    }

    #[test]
    fn outliers_are_kept_and_cost_those_near_the_median_little() {
        let values = (0..1000).map(|i| (i as f32 * 0.37).sin()).chain([-500.0, 800.0]);
        let book = Book::dense(values.clone(), 0.02);
        for v in values {
            let off = (book.grid[usize::from(book.byte(v))] - f64::from(v)).abs();
            // Half a step, which is 0.02 at the median, 0, and grows with the distance; the width is 0.31 here.
            let allowed = if v.abs() > 1.0 { 0.01 * f64::from(v.abs()) } else { 0.01 * f64::from(v / 0.3).hypot(1.0) };
            assert!(off <= allowed, "{v}: {off}");
        }
        assert!(book.grid.is_sorted());
    }

    #[test]
    fn nothing_and_one_value_have_books() {
        assert_eq!(Book::dense([f32::NAN].into_iter(), 0.1).values, [0.0; 256]);
        let book = Book::equal([-1.25; 3].into_iter(), 0.001);
        assert_eq!(book.values[usize::from(book.byte(-1.25))], -1.25);
    }

    #[test]
    fn whole_numbers_of_any_size_are_written_as_they_are() {
        let values = Book { grid: Vec::new(), values: vec![-1e30, -3.0, 0.5, 1e30] }.json();
        assert_eq!(serde_json::from_value::<Vec<f64>>(values.clone()).unwrap(), [-1e30, -3.0, 0.5, 1e30]);
        assert!(values.to_string().contains(",-3,0.5,"), "{values}");
    }
}
