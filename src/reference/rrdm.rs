//! The radiance-response density matrix of a block: W from the block's rows of H, and P = W W^T.

use crate::kernels::constants::responses;

/// Number of rendering channels in a row, which come before those of optimisation.
const RENDERING: usize = responses::RENDERING as usize;

/// Rows of W (m x 8) from unweighted, normalised responses (m x 8) at balance `eta`.
///
/// W = [sqrt(eta / (tr_r + epsilon)) Hr, sqrt((1 - eta) / (tr_o + epsilon)) Ho], tr the sum of squares of each group
/// (Q5). A group that is zero everywhere stays zero, whatever epsilon is.
pub fn w(responses: &[[f64; 8]], eta: f64, epsilon: f64) -> Vec<[f64; 8]> {
    let trace = |channels: std::ops::Range<usize>| -> f64 {
        responses.iter().flat_map(|row| &row[channels.clone()]).map(|x| x * x).sum()
    };
    let root = |share: f64, sum: f64| if sum > 0.0 { (share / sum).sqrt() } else { 0.0 };
    let rendering = root(eta, trace(0..RENDERING) + epsilon);
    let optimisation = root(1.0 - eta, trace(RENDERING..8) + epsilon);
    let row = |row: &[f64; 8]| std::array::from_fn(|c| row[c] * if c < RENDERING { rendering } else { optimisation });
    responses.iter().map(row).collect()
}

/// P = W W^T (Q6), m x m, row by row.
pub fn p(w: &[[f64; 8]]) -> Vec<f64> {
    let entry = |a: &[f64; 8], b: &[f64; 8]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    w.iter().flat_map(|a| w.iter().map(move |b| entry(a, b))).collect()
}
