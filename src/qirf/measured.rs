//! The blocks' matrices as pictures show them: in place of the modelled overlaps S the products of weights w = T alpha over all
//! pixels, and in place of the modelled responses P the products of phi, the change of a pixel if a Gaussian is removed. Both
//! come from sketches ([`crate::response::Sketch`]), their diagonals from exact sums.

use super::lapack;
use super::partition::Blocks;
use super::select::{MeasuredSelector, Ranking, css, rank, rounded};
use crate::response::{Responses, Score, Sketch};
use rayon::prelude::*;

/// Added to the diagonal of the normalised weights' products: the noise of a sketch leaves them no better known.
const EPSILON: f64 = 0.05;
/// Share of the energy that the leading eigenvalues reach.
const TAU: f64 = 0.95;
/// The column subset stops after this share of a block.
const CSS_SHARE: f64 = 0.5;

/// What a block's Gaussians do in pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Sums of the products of phi, m x m.
    pub changes: Vec<f64>,
    /// Sums of the products of w, each divided by the roots of both diagonal entries: m x m with 1 on the diagonal.
    pub weights: Vec<f64>,
    /// Sums of phi . r over all pixels, r being the picture minus its photo; 0 without photos.
    pub along_residual: Vec<f64>,
}

impl Measured {
    /// Of these members. A Gaussian that no picture shows does nothing.
    ///
    /// # Panics
    /// If a member has no score or no sketch.
    pub fn new(members: &[u32], scores: &[Score], sketches: &[Sketch]) -> Self {
        let m = members.len();
        let of = |i: &u32| (&scores[*i as usize], &sketches[*i as usize]);
        let finite = |x: f32| if x.is_finite() { f64::from(x) } else { 0.0 };
        // Rows of a block's sketches, scaled so that their squares sum up to the exact diagonal.
        let scaled = |exact: f64, row: Vec<f64>| -> Vec<f64> {
            let own: f64 = row.iter().map(|x| x * x).sum();
            let scale = if own > 0.0 { (exact.max(0.0) / own).sqrt() } else { 0.0 };
            row.into_iter().map(|x| x * scale).collect()
        };
        let phi = |i: &u32| {
            let (score, sketch) = of(i);
            scaled(finite(score.change), sketch.iter().flat_map(|row| row[..3].iter().map(|x| finite(*x))).collect())
        };
        let w = |i: &u32| {
            let (score, sketch) = of(i);
            let seen = if finite(score.squares) > 0.0 { 1.0 } else { 0.0 };
            scaled(seen, sketch.iter().map(|row| finite(row[3])).collect())
        };
        let mut weights = products(&members.iter().map(w).collect::<Vec<_>>());
        (0..m).for_each(|i| weights[i * m + i] = 1.0);
        Self {
            changes: products(&members.iter().map(phi).collect::<Vec<_>>()),
            weights,
            along_residual: members.iter().map(|i| finite(of(i).0.along_residual)).collect(),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.along_residual.len()
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn change(&self, i: usize, j: usize) -> f64 {
        self.changes[i * self.len() + j]
    }

    /// The order of the block by a selector.
    pub fn ranking(&self, selector: MeasuredSelector) -> Ranking {
        match selector {
            MeasuredSelector::Gnso => self.participation(),
            MeasuredSelector::Css => self.column_subset(),
            MeasuredSelector::Elimination => self.elimination(),
        }
    }

    /// Participation in the eigenproblem of the changes, with the weights as the metric.
    fn participation(&self) -> Ranking {
        let m = self.len();
        let (mut changes, mut metric) = (self.changes.clone(), self.weights.clone());
        (0..m).for_each(|i| metric[i * m + i] += EPSILON);
        let own = || (0..m).map(|i| self.change(i, i)).collect::<Vec<_>>();
        let solved = if m > 0 { lapack::sygvd(m, &mut changes, &mut metric) } else { None };
        let q = solved.map_or_else(own, |ascending| {
            let whole: f64 = ascending.iter().map(|l| l.max(0.0)).sum();
            let (mut q, mut sum) = (vec![0.0; m], 0.0);
            for (k, lambda) in ascending.iter().enumerate().rev() {
                if sum >= TAU * whole {
                    break;
                }
                sum += lambda.max(0.0);
                // Column k of the vectors, which took the changes' place.
                q.iter_mut().zip(&changes[k * m..]).for_each(|(q, u)| *q += lambda.max(0.0) * u * u);
            }
            q
        });
        Ranking { rank: rank(&q), gain: q }
    }

    /// Greedy column subset of the changes.
    fn column_subset(&self) -> Ranking {
        let m = self.len();
        let norms: Vec<f64> = (0..m).map(|i| self.change(i, i).sqrt()).collect();
        let cosine = |i: usize, j: usize| {
            let product = norms[i] * norms[j];
            if i == j {
                1.0
            } else if product > 0.0 {
                (self.change(i, j) / product) as f32
            } else {
                0.0
            }
        };
        let cosines: Vec<f32> = (0..m * m).map(|k| cosine(k / m.max(1), k % m.max(1))).collect();
        css::order(&cosines, &norms, (CSS_SHARE * m as f64).ceil() as usize)
    }

    /// Backward elimination: drops at each step the Gaussian whose going adds least to the squared error, given those that went
    /// before it.
    fn elimination(&self) -> Ranking {
        let m = self.len();
        let mut cost: Vec<f64> = (0..m).map(|i| self.change(i, i) - 2.0 * self.along_residual[i]).collect();
        let mut ranking = Ranking { rank: vec![0; m], gain: vec![0.0; m] };
        let mut open: Vec<usize> = (0..m).collect();
        let mut most = f64::NEG_INFINITY;
        while let Some((at, i)) = open.iter().copied().enumerate().min_by(|a, b| {
            let by = |k: usize| rounded(cost[k]);
            // Of equal ones the last goes first.
            by(a.1).total_cmp(&by(b.1)).then(b.1.cmp(&a.1))
        }) {
            open.remove(at);
            most = most.max(cost[i]);
            ranking.rank[i] = open.len() as u32;
            ranking.gain[i] = most;
            for &k in &open {
                cost[k] += 2.0 * self.change(k, i);
            }
        }
        ranking
    }
}

/// Products of all pairs of rows, m x m.
fn products(rows: &[Vec<f64>]) -> Vec<f64> {
    let m = rows.len();
    let mut out = vec![0.0; m * m];
    for (i, a) in rows.iter().enumerate() {
        for (j, b) in rows.iter().enumerate().take(i + 1) {
            let product = a.iter().zip(b).map(|(x, y)| x * y).sum();
            (out[i * m + j], out[j * m + i]) = (product, product);
        }
    }
    out
}

/// The order of all blocks by a selector.
///
/// # Panics
/// If scores or sketches are missing.
pub fn ranking(selector: MeasuredSelector, blocks: &Blocks, responses: &Responses) -> Ranking {
    let n = blocks.members.len();
    let Responses { scores, sketches, .. } = responses;
    assert!(scores.len() == n && sketches.len() == n, "a score and a sketch for each Gaussian");
    let of = |b: usize| Measured::new(blocks.block(b), scores, sketches).ranking(selector);
    let by_block: Vec<Ranking> = (0..blocks.len()).into_par_iter().map(of).collect();
    let mut all = Ranking { rank: vec![0; n], gain: vec![0.0; n] };
    for (members, block) in blocks.iter().zip(by_block) {
        for (k, &i) in members.iter().enumerate() {
            all.rank[i as usize] = block.rank[k];
            all.gain[i as usize] = block.gain[k];
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(changes: &[f64], along_residual: &[f64]) -> Measured {
        let m = along_residual.len();
        let weights = (0..m * m).map(|k| if k % (m + 1) == 0 { 1.0 } else { 0.0 }).collect();
        Measured { changes: changes.to_vec(), weights, along_residual: along_residual.to_vec() }
    }

    /// Two equal ones in front of each other cost little alone but much together: one of them stays, before a lone one that
    /// costs somewhat more than either.
    #[test]
    fn elimination_counts_what_went_before() {
        let pair = measured(&[1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 2.0], &[0.0; 3]);
        let order = pair.elimination();
        assert_eq!(order.rank, [0, 2, 1]);
        assert_eq!(order.gain, [3.0, 1.0, 2.0]);
        // By removal alone the lone one is first.
        assert_eq!(rank(&[1.0, 1.0, 2.0]), [1, 2, 0]);
        let floater = measured(&[4.0, 0.0, 0.0, 1.0], &[3.0, 0.0]);
        assert_eq!(floater.elimination().rank, [1, 0], "without it the pictures are closer to the photos");
    }

    #[test]
    fn subsets_of_changes_leave_duplicates_out() {
        let pair = measured(&[1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5], &[0.0; 3]);
        assert_eq!(pair.column_subset().rank, [0, 2, 1]);
        assert!(measured(&[], &[]).column_subset().rank.is_empty());
    }

    /// With an orthonormal metric and independent changes q is the change, but for epsilon.
    #[test]
    fn participation_of_independent_ones_is_their_change() {
        let apart = measured(&[4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0], &[0.0; 3]);
        let ranked = apart.participation();
        assert_eq!(ranked.rank, [0, 2, 1]);
        assert!((ranked.gain[0] * (1.0 + EPSILON).powi(2) - 4.0).abs() < 1e-12, "{ranked:?}");
        assert!(measured(&[], &[]).participation().rank.is_empty());
    }

    /// Unseen Gaussians, values that are no numbers, and exact diagonals.
    #[test]
    fn diagonals_are_exact_and_nothing_is_nan() {
        let mut sketches = vec![[[0.0_f32; 4]; crate::response::ROWS]; 4];
        sketches[0][3] = [1.0, 2.0, 0.0, 1.0];
        sketches[1][3] = [2.0, 4.0, 0.0, -1.0];
        sketches[2][7] = [f32::NAN, 1.0, f32::INFINITY, f32::NAN];
        let score = |change: f32, squares: f32| Score { squares, change, ..Score::default() };
        let scores = [score(8.0, 1.0), score(18.0, 1.0), score(3.0, f32::NAN), score(0.0, 0.0)];
        let block = Measured::new(&[0, 1, 2, 3], &scores, &sketches);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12 * b.abs().max(1.0);
        assert!([8.0, 18.0, 3.0, 0.0].iter().enumerate().all(|(i, d)| near(block.change(i, i), *d)));
        assert!(near(block.change(0, 1), 12.0) && near(block.weights[1], -1.0));
        for selector in [MeasuredSelector::Gnso, MeasuredSelector::Css, MeasuredSelector::Elimination] {
            let ranked = block.ranking(selector);
            assert!(ranked.gain.iter().all(|g| g.is_finite()), "{selector:?} {ranked:?}");
            let mut ranks = ranked.rank.clone();
            ranks.sort_unstable();
            assert_eq!(ranks, [0, 1, 2, 3], "{selector:?}");
        }
    }
}
