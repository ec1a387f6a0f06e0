//! A codebook of 256 values, by Lloyd's algorithm in one dimension.

const ROUNDS: usize = 12;

/// A rising list of 256 values, each the mean of the inputs nearest to it.
pub(super) struct Codebook(pub [f32; 256]);

impl Codebook {
    /// Fits a codebook to finite values, beginning with quantiles; zeros if there are no values.
    pub fn fit(mut values: Vec<f32>) -> Self {
        if values.is_empty() {
            return Self([0.0; 256]);
        }
        values.sort_unstable_by(f32::total_cmp);
        let n = values.len();
        let mut book = Self(std::array::from_fn(|k| values[(2 * k + 1) * n / 512]));
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(values.iter().scan(0.0, |sum, v| {
                *sum += f64::from(*v);
                Some(*sum)
            }))
            .collect();
        for _ in 0..ROUNDS {
            let mut start = 0;
            for k in 0..256 {
                let end = match book.0.get(k + 1) {
                    Some(next) => {
                        let border = 0.5 * (f64::from(book.0[k]) + f64::from(*next));
                        start + values[start..].partition_point(|v| f64::from(*v) <= border)
                    }
                    None => n,
                };
                if end > start {
                    book.0[k] = ((sums[end] - sums[start]) / (end - start) as f64) as f32;
                }
                start = end;
            }
        }
        book
    }

    /// The byte whose value is nearest.
    pub fn byte(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|v| *v < value).min(255);
        let nearer_below = above > 0 && value - self.0[above - 1] <= self.0[above] - value;
        (above - usize::from(nearer_below)) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_kept() {
        let few: Vec<f32> = (0..1000).map(|i| (i % 100) as f32 - 50.0).collect();
        let book = Codebook::fit(few.clone());
        assert!(few.iter().all(|v| (book.0[usize::from(book.byte(*v))] - v).abs() < 1e-5));
        assert!(book.0.is_sorted());
    }

    #[test]
    fn bytes_are_the_nearest() {
        let values: Vec<f32> = (0..5000).map(|i| ((i * 7919 % 5000) as f32 / 500.0).powi(3)).collect();
        let book = Codebook::fit(values.clone());
        for v in values.iter().chain(&[-5.0, 2000.0]) {
            let least = book.0.iter().map(|b| (b - v).abs()).fold(f32::MAX, f32::min);
            assert_eq!((book.0[usize::from(book.byte(*v))] - v).abs(), least);
        }
    }
}
