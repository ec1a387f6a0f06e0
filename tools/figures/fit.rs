//! Least squares: how well a straight line or a plane explains times.

/// Fitted coefficients and the quality of the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The constant, then one per column.
    pub coefficients: Vec<f64>,
    /// Share of the values' variance that the fit explains.
    pub r2: f64,
    /// Largest deviation of a value, relative to the value.
    pub worst: f64,
}

impl Fit {
    /// Fits `values[i]` by a constant and `columns[..][i]`; none where the columns do not determine the coefficients.
    pub fn of(columns: &[&[f64]], values: &[f64]) -> Option<Self> {
        // Columns in units of their largest, so that the normal equations are well conditioned.
        let units: Vec<f64> = columns.iter().map(|c| c.iter().fold(0.0_f64, |m, v| m.max(v.abs()))).collect();
        let row = |i: usize| -> Vec<f64> {
            std::iter::once(1.0).chain(columns.iter().zip(&units).map(|(c, unit)| c[i] / unit)).collect()
        };
        let n = columns.len() + 1;
        let mut equations = vec![vec![0.0; n + 1]; n];
        for (i, value) in values.iter().enumerate() {
            let own = row(i);
            for a in 0..n {
                for b in 0..n {
                    equations[a][b] += own[a] * own[b];
                }
                equations[a][n] += own[a] * value;
            }
        }
        let scaled = solve(equations)?;
        let fitted: Vec<f64> =
            (0..values.len()).map(|i| row(i).iter().zip(&scaled).map(|(x, c)| x * c).sum()).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let left: f64 = values.iter().zip(&fitted).map(|(v, f)| (v - f).powi(2)).sum();
        let all: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let worst = values.iter().zip(&fitted).map(|(v, f)| (f / v - 1.0).abs()).fold(0.0, f64::max);
        let coefficients = std::iter::once(1.0).chain(units).zip(&scaled).map(|(unit, c)| c / unit).collect();
        Some(Self { coefficients, r2: 1.0 - left / all, worst })
    }

    /// The fitted value of a row.
    pub fn at(&self, row: &[f64]) -> f64 {
        self.coefficients[0] + row.iter().zip(&self.coefficients[1..]).map(|(x, c)| x * c).sum::<f64>()
    }
}

/// Gaussian elimination with pivots; the last element of a row is its right-hand side.
fn solve(mut rows: Vec<Vec<f64>>) -> Option<Vec<f64>> {
    let n = rows.len();
    for c in 0..n {
        let pivot = (c..n).max_by(|a, b| rows[*a][c].abs().total_cmp(&rows[*b][c].abs()))?;
        rows.swap(c, pivot);
        let size = rows[c][c].abs();
        if size.is_nan() || size <= 1e-12 {
            return None;
        }
        for r in 0..n {
            if r != c {
                let factor = rows[r][c] / rows[c][c];
                for k in c..=n {
                    rows[r][k] -= factor * rows[c][k];
                }
            }
        }
    }
    Some((0..n).map(|c| rows[c][n] / rows[c][c]).collect())
}
