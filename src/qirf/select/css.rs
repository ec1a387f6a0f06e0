//! Greedy column subset (Q9): repeatedly keep the function that explains most of the weighted remainder, and subtract
//! its part.
//!
//! R := N; pick argmax_i g_i / R_ii over R_ii > 1e-4, g_i = sum_j w_j^2 R_ji^2; R -= R_i R_i^T / R_ii. R is never
//! formed: R = N - C C^T with one column of C a pick, and with c that column and t = w^2 c
//!   g_i -= 2 c_i (R t)_i - c_i^2 (t . c).

use super::Ranking;
use super::rounded;

/// Functions with a smaller remainder than this are explained by the picked ones.
const EXHAUSTED: f64 = 1e-4;
/// Entries of C below this count as zero: they change gains by far less than the rounding of ranks.
const NOTHING: f64 = 1e-7;

/// Order of a block by greedy column subset of `overlap` (m x m) with weights `w` (m); after `picks` picks, by the
/// remaining gains.
///
/// A gain is taken at the pick, limited to the previous one; explained functions follow in the order of their weights.
pub fn order(overlap: &[f32], w: &[f64], picks: usize) -> Ranking {
    let m = w.len();
    let finite = |n: f32| if n.is_finite() { f64::from(n) } else { 0.0 };
    let n: Vec<f64> = overlap.iter().map(|&x| finite(x)).collect();
    let row = |i: usize| &n[i * m..(i + 1) * m];
    let w2: Vec<f64> = w.iter().map(|w| w * w).collect();
    let mut g: Vec<f64> = (0..m).map(|i| row(i).iter().zip(&w2).map(|(n, w)| w * n * n).sum()).collect();
    let mut left: Vec<f64> = (0..m).map(|i| row(i)[i]).collect();
    let mut columns: Vec<Column> = Vec::new();
    let mut picked: Vec<(u32, f64)> = Vec::with_capacity(m);
    let mut open = vec![true; m];
    let mut last = f64::INFINITY;

    while picked.len() < picks.min(m) {
        let mut best: Option<(usize, f64)> = None;
        for i in (0..m).filter(|&i| open[i] && left[i] > EXHAUSTED) {
            let gain = rounded(g[i] / left[i]);
            if best.is_none_or(|(_, most)| gain > most) {
                best = Some((i, gain));
            }
        }
        let Some((i, _)) = best else { break };
        open[i] = false;
        last = last.min(g[i] / left[i]);
        picked.push((i as u32, last));

        let c = Column::new(row(i), &columns, i, left[i].sqrt().recip());
        let t: Vec<f64> = c.support.iter().map(|&j| w2[j as usize] * c.dense[j as usize]).collect();
        let rt = c.deflated(&n, &columns, &t);
        let tc: f64 = c.support.iter().zip(&t).map(|(&j, t)| t * c.dense[j as usize]).sum();
        for (&j, rt) in c.support.iter().zip(rt) {
            let (j, c) = (j as usize, c.dense[j as usize]);
            g[j] = (g[j] - c * (2.0 * rt - c * tc)).max(0.0);
            left[j] -= c * c;
        }
        columns.push(c);
    }
    finish(picked, &g, &left, w, &open, last)
}

/// Ranks of the picked functions, then of the others by their current gains, then of explained ones by weight.
fn finish(picked: Vec<(u32, f64)>, g: &[f64], left: &[f64], w: &[f64], open: &[bool], last: f64) -> Ranking {
    let m = w.len();
    let ceiling = if last.is_finite() { last } else { f64::MAX };
    let rest = |explained: bool| {
        let score = move |i: usize| if explained { w[i] } else { g[i] / left[i] };
        let worth = move |i: usize| if explained { w[i] * w[i] * left[i].max(0.0) } else { g[i] / left[i] };
        let mut rest: Vec<(u32, f64, f64)> = (0..m)
            .filter(|&i| open[i] && (left[i] <= EXHAUSTED) == explained)
            .map(|i| (i as u32, rounded(score(i)), worth(i).min(ceiling)))
            .collect();
        rest.sort_by(|a, b| b.1.total_cmp(&a.1));
        rest.into_iter().map(|(i, _, worth)| (i, worth))
    };
    let mut ranked = Ranking { rank: vec![0; m], gain: vec![0.0; m] };
    for ((i, gain), place) in picked.into_iter().chain(rest(false)).chain(rest(true)).zip(0..) {
        ranked.rank[i as usize] = place;
        ranked.gain[i as usize] = gain;
    }
    ranked
}

/// A column of C: the part of each function that a picked one explains. Most overlaps are zero, so only the support is
/// stored.
struct Column {
    dense: Vec<f64>,
    support: Vec<u32>,
}

impl Column {
    /// R_i, scaled, from row i of N and the columns so far.
    fn new(row: &[f64], columns: &[Self], i: usize, scale: f64) -> Self {
        let mut dense = row.to_vec();
        for column in columns.iter().filter(|column| column.dense[i] != 0.0) {
            let a = column.dense[i];
            column.support.iter().for_each(|&j| dense[j as usize] -= a * column.dense[j as usize]);
        }
        let mut support = Vec::new();
        for (j, x) in dense.iter_mut().enumerate() {
            *x *= scale;
            if x.abs() < NOTHING {
                *x = 0.0;
            } else {
                support.push(j as u32);
            }
        }
        Self { dense, support }
    }

    /// R t on the support of this column, outside of which t is zero.
    fn deflated(&self, n: &[f64], columns: &[Self], t: &[f64]) -> Vec<f64> {
        let m = self.dense.len();
        let along = |values: &[f64]| self.support.iter().zip(t).map(|(&j, t)| t * values[j as usize]).sum::<f64>();
        let mut rt: Vec<f64> = self.support.iter().map(|&i| along(&n[i as usize * m..][..m])).collect();
        for column in columns {
            let a = along(&column.dense);
            if a != 0.0 {
                rt.iter_mut().zip(&self.support).for_each(|(rt, &i)| *rt -= a * column.dense[i as usize]);
            }
        }
        rt
    }
}
