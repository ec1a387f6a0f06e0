//! Greedy column subset: keep the function that explains most of the weighed rest, then look at what is left of it.
//!
//! R := N; pick argmax_i g_i / R_ii over R_ii > 1e-4, g_i = sum_j w_j^2 R_ji^2; R -= R_i R_i^T / R_ii. R is never
//! formed: R = N - C C^T with one column of C a pick, and with c that column and t = w^2 c
//!   g_i -= 2 c_i (R t)_i - c_i^2 (t . c).

use super::rounded;
use crate::qirf::batch::Ranked;

/// Functions of which less than this is left are explained by those picked.
const EXHAUSTED: f64 = 1e-4;

/// Order of a block by greedy column subset of `overlap` (m x m) with weights `w` (m), after `picks` by what is left.
///
/// Gains are those at the pick, never above an earlier one's; explained functions follow by their weights.
pub fn order(overlap: &[f32], w: &[f64], picks: usize) -> Ranked {
    let m = w.len();
    let finite = |n: f32| if n.is_finite() { f64::from(n) } else { 0.0 };
    let n: Vec<f64> = overlap.iter().map(|&x| finite(x)).collect();
    let row = |i: usize| &n[i * m..(i + 1) * m];
    let w2: Vec<f64> = w.iter().map(|w| w * w).collect();
    let mut g: Vec<f64> = (0..m).map(|i| row(i).iter().zip(&w2).map(|(n, w)| w * n * n).sum()).collect();
    let mut left: Vec<f64> = (0..m).map(|i| row(i)[i]).collect();
    let mut columns: Vec<f64> = Vec::new();
    let mut picked: Vec<(u32, f64)> = Vec::with_capacity(m);
    let mut open = vec![true; m];
    let mut last = f64::INFINITY;

    let (mut t, mut rt) = (vec![0.0; m], vec![0.0; m]);
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

        let mut c = row(i).to_vec();
        for column in columns.chunks_exact(m) {
            axpy(-column[i], column, &mut c);
        }
        let scale = left[i].sqrt().recip();
        for x in &mut c {
            *x *= scale;
        }
        t.iter_mut().zip(&c).zip(&w2).for_each(|((t, c), w)| *t = w * c);
        rt.fill(0.0);
        for (j, &t) in t.iter().enumerate().filter(|(_, t)| **t != 0.0) {
            axpy(t, row(j), &mut rt);
        }
        for column in columns.chunks_exact(m) {
            axpy(-dot(column, &t), column, &mut rt);
        }
        let tc = dot(&t, &c);
        for j in 0..m {
            g[j] = (g[j] - c[j] * (2.0 * rt[j] - c[j] * tc)).max(0.0);
            left[j] -= c[j] * c[j];
        }
        columns.extend(c);
    }
    finish(picked, &g, &left, w, &open, last)
}

/// Ranks of those picked, then of the rest: by what they would gain now, then, if explained, by weight.
fn finish(picked: Vec<(u32, f64)>, g: &[f64], left: &[f64], w: &[f64], open: &[bool], last: f64) -> Ranked {
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
    let mut ranked = Ranked { rank: vec![0; m], gain: vec![0.0; m] };
    for ((i, gain), place) in picked.into_iter().chain(rest(false)).chain(rest(true)).zip(0..) {
        ranked.rank[i as usize] = place;
        ranked.gain[i as usize] = gain;
    }
    ranked
}

fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    // Four sums, so that the additions need not wait for one another.
    let (xs, ys) = (x.chunks_exact(4), y.chunks_exact(4));
    let tail: f64 = xs.remainder().iter().zip(ys.remainder()).map(|(x, y)| x * y).sum();
    let mut sums = [0.0; 4];
    for (x, y) in xs.zip(ys) {
        (0..4).for_each(|k| sums[k] += x[k] * y[k]);
    }
    sums.iter().sum::<f64>() + tail
}
