//! Least squares: how well a straight line or a plane explains times.

use glam::{DMat3, DVec3};

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
    /// Fits `values[i]` by a constant and one or two `columns[..][i]`; none where they do not determine the coefficients.
    pub fn of(columns: &[&[f64]], values: &[f64]) -> Option<Self> {
        // Columns in units of their largest, so that the normal equations are well conditioned.
        let units: Vec<f64> = columns.iter().map(|c| c.iter().fold(0.0_f64, |m, v| m.max(v.abs()))).collect();
        let row = |i: usize| {
            let mut row = DVec3::X;
            for (k, (c, unit)) in columns.iter().zip(&units).enumerate() {
                row[k + 1] = c[i] / unit;
            }
            row
        };
        // A column that is not given has the coefficient 0.
        let absent = if columns.len() < 2 { 1.0 } else { 0.0 };
        let (mut equations, mut right) = (DMat3::from_diagonal(DVec3::Z * absent), DVec3::ZERO);
        for (i, value) in values.iter().enumerate() {
            let own = row(i);
            equations += DMat3::from_cols(own * own.x, own * own.y, own * own.z);
            right += own * *value;
        }
        let size = equations.determinant().abs();
        if size.is_nan() || size <= 1e-12 {
            return None;
        }
        let scaled = equations.inverse() * right;
        let fitted: Vec<f64> = (0..values.len()).map(|i| row(i).dot(scaled)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let left: f64 = values.iter().zip(&fitted).map(|(v, f)| (v - f).powi(2)).sum();
        let all: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let worst = values.iter().zip(&fitted).map(|(v, f)| (f / v - 1.0).abs()).fold(0.0, f64::max);
        let coefficients = std::iter::once(1.0).chain(units).zip(scaled.to_array()).map(|(unit, c)| c / unit).collect();
        Some(Self { coefficients, r2: 1.0 - left / all, worst })
    }

    /// The fitted value of a row.
    pub fn at(&self, row: &[f64]) -> f64 {
        self.coefficients[0] + row.iter().zip(&self.coefficients[1..]).map(|(x, c)| x * c).sum::<f64>()
    }
}
