//! Hard cases with known results (`hard-cases.json`): 12 pairs of Gaussians with overlaps computed in 60-digit
//! arithmetic, and 10 blocks with the solutions of their eigenproblems.

use crate::qirf::{CHANNELS, Row};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Two Gaussians and their normalised overlap.
#[derive(Clone, Debug, Deserialize)]
pub struct Pair {
    /// Centres in world units.
    pub p1: [f64; 3],
    /// Standard deviations in world units.
    pub s1: [f64; 3],
    /// Quaternion (w, x, y, z).
    pub q1: [f64; 4],
    /// `p1` of the second Gaussian.
    pub p2: [f64; 3],
    /// `s1` of the second Gaussian.
    pub s2: [f64; 3],
    /// `q1` of the second Gaussian.
    pub q2: [f64; 4],
    /// N, without a floor under the scales.
    #[serde(rename = "N_ref")]
    pub expected: f64,
    /// Error allowed for float32, without a floor.
    pub abs_tol_f32: f64,
}

/// A block's matrices and the solution of P u = lambda (N + eps I) u.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct Block {
    /// Number of Gaussians.
    pub m: usize,
    /// Overlaps, m x m.
    #[serde(rename = "N")]
    pub n: Vec<Vec<f32>>,
    /// Normalised responses, m x up to 8.
    #[serde(rename = "W")]
    pub w: Vec<Vec<f64>>,
    /// Added to the diagonal of N.
    pub eps: f64,
    /// Eigenvalues, descending.
    pub lam: Vec<f64>,
    /// Number of leading eigenvalues at tau = 0.95.
    pub r: usize,
    /// Participations, m.
    pub q: Vec<f64>,
    /// Number of Gaussians that the paper's rule keeps.
    pub k: usize,
    /// Their indices, ascending.
    pub paper_topk: Vec<u32>,
    /// Indices of those that the column subset keeps, in its order.
    pub css_order: Vec<u32>,
}

impl Block {
    /// Rows of W, zero in channels that the case does not have.
    pub fn rows(&self) -> Vec<Row> {
        let row = |row: &Vec<f64>| -> Row { std::array::from_fn(|c| row.get(c).copied().unwrap_or(0.0)) };
        self.w.iter().map(row).collect()
    }

    /// Allowed error of eigenvalues and participations, relative to the largest, for float64 (or float32).
    pub fn tolerance(name: &str, float32: bool) -> f64 {
        match (name, float32) {
            // Rounding of N itself, 6e-8, is divided by epsilon = 1e-4 if functions are nearly linearly dependent.
            // Roots and quotients that are off by two roundings multiply the errors of copies by six, to 7e-3.
            ("B2_equal_duplicates" | "B3_noisy_duplicates_rank1" | "B4_32_copies" | "B9_dense_line_64", true) => 2e-2,
            ("B9_dense_line_64" | "B3_noisy_duplicates_rank1" | "B4_32_copies", _) | (_, true) => 2e-3,
            _ => 1e-6,
        }
    }

    /// Columns of W in the device's layout, m x 8, column by column.
    pub(super) fn columns(&self) -> Vec<f32> {
        let rows = self.rows();
        (0..CHANNELS).flat_map(|c| rows.iter().map(move |row| row[c] as f32)).collect()
    }
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum Case {
    Pair(Pair),
    Block(Block),
}

fn cases() -> BTreeMap<&'static str, Case> {
    // The file is part of the program, and a test reads all of it.
    serde_json::from_str(include_str!("hard-cases.json")).unwrap_or_default()
}

/// The pairs by name.
pub fn pairs() -> impl Iterator<Item = (&'static str, Pair)> {
    cases().into_iter().filter_map(|(name, case)| if let Case::Pair(pair) = case { Some((name, pair)) } else { None })
}

/// The blocks by name.
pub fn blocks() -> impl Iterator<Item = (&'static str, Block)> {
    cases()
        .into_iter()
        .filter_map(|(name, case)| if let Case::Block(block) = case { Some((name, block)) } else { None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_there() {
        assert_eq!((pairs().count(), blocks().count()), (12, 10));
        assert!(blocks().all(|(_, b)| b.n.len() == b.m && b.w.len() == b.m && b.q.len() == b.m));
    }
}
