//! Ranks and gains of a batch of blocks, computed in parallel over blocks while the device assembles the next batch.

use rayon::prelude::*;

use super::normalise::within_block;
use super::participation::{Eigensolver, Factor, Gram, Participation, lowdin, norm};
use super::partition::Blocks;
use super::select::{BlockSelector, Ranking, css, rank};
use super::{CHANNELS, Row};

/// Input of one block.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Normalised overlaps N, m x m, symmetric, 1 on the diagonal.
    pub overlap: &'a [f32],
    /// Its members' rows of H (see [`super::normalise::rows`]), m.
    pub rows: &'a [[f32; CHANNELS]],
    /// Its members' opacities or their logits, m, which rank a block without any response.
    pub opacity: &'a [f32],
    /// S_ii of its members, m (see [`self_overlap`]), for the raw overlap; else none.
    pub self_overlaps: Option<&'a [f64]>,
}

/// S_ii = pi^(3/2) s1 s2 s3 of a Gaussian with these logarithms of scales.
pub fn self_overlap(log_scales: [f32; 3]) -> f64 {
    let volume: f64 = log_scales.iter().map(|&s| f64::from(s)).sum();
    std::f64::consts::PI.powf(1.5) * volume.exp()
}

/// Options for solving blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Solver {
    /// Solver of the eigenproblem.
    pub eigensolver: Eigensolver,
    /// Added to the metric's diagonal, and to traces.
    pub epsilon: f64,
    /// Share of the energy that the leading eigenvalues reach.
    pub tau: f64,
    /// Weight of the rendering channels, as in the rows of H.
    pub eta: f64,
    /// The column subset stops after this share of a block; the others are ranked by the gain that they would have then.
    pub css_share: f64,
    /// Selectors to rank by.
    pub selectors: Vec<BlockSelector>,
}

impl Default for Solver {
    fn default() -> Self {
        Self {
            eigensolver: Eigensolver::default(),
            epsilon: 1e-4,
            tau: 0.95,
            eta: 0.75,
            css_share: 0.5,
            selectors: vec![BlockSelector::Gnso],
        }
    }
}

/// Results of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// One for each of the solver's selectors, in their order.
    pub ranked: Vec<Ranking>,
    /// The eight largest eigenvalues; zero if the paper's problem was not asked for.
    pub spectrum: [f64; CHANNELS],
    /// The fewest eigenvalues that reach tau; 1 if the paper's problem was not asked for.
    pub r: u32,
    /// True if the metric was not positive definite and its canonical form was used.
    pub canonical: bool,
    /// True if no member has any response, so that opacity decides.
    pub unseen: bool,
    /// Overlaps and responses that were not finite.
    pub repaired: usize,
}

impl Solver {
    /// Solves each block on its own, in parallel; the result does not depend on the number of threads.
    pub fn solve(&self, batch: &[Block<'_>]) -> Vec<Solved> {
        batch.par_iter().with_max_len(1).map(|block| self.solve_one(block)).collect()
    }

    /// Solves one block.
    ///
    /// # Panics
    /// If the block's arrays disagree on its size.
    pub fn solve_one(&self, block: &Block<'_>) -> Solved {
        let m = block.rows.len();
        assert!(block.overlap.len() == m * m && block.opacity.len() == m, "a block's arrays have its size");
        let mut repaired = 0;
        let mut finite = |x: f32| {
            repaired += usize::from(!x.is_finite());
            if x.is_finite() { f64::from(x) } else { 0.0 }
        };
        let h: Vec<Row> = block.rows.iter().map(|row| row.map(&mut finite)).collect();
        let mut solved = Solved {
            ranked: Vec::with_capacity(self.selectors.len()),
            spectrum: [0.0; CHANNELS],
            r: 1,
            canonical: false,
            unseen: h.iter().flatten().all(|&x| x == 0.0),
            repaired,
        };
        if solved.unseen {
            let opacity: Vec<f64> = block.opacity.iter().map(|&o| f64::from(o)).collect();
            let ranked = Ranking { rank: rank(&opacity), gain: vec![0.0; m] };
            solved.ranked = vec![ranked; self.selectors.len()];
            return solved;
        }
        let w = within_block(&h, self.eta, self.epsilon);
        let metric = Gram::new(m, block.overlap, block.self_overlaps, self.epsilon);
        solved.repaired += metric.repaired;
        for selector in &self.selectors {
            let ranked = match selector {
                BlockSelector::Gnso => self.participation(&Factor::new(&metric, self.eigensolver), &w, &h, &mut solved),
                BlockSelector::Ordinary => self.participation(&Factor::Identity, &w, &h, &mut solved),
                BlockSelector::Lowdin => {
                    let [local, gain]: [Vec<f64>; 2] =
                        lowdin(&metric, &[&w, &h]).try_into().unwrap_or_else(|_| [vec![0.0; m], vec![0.0; m]]);
                    Ranking { rank: rank(&local), gain }
                }
                BlockSelector::Css => {
                    let weights: Vec<f64> = h.iter().map(norm).collect();
                    let picks = (self.css_share.clamp(0.0, 1.0) * m as f64).ceil() as usize;
                    css::order(block.overlap, &weights, picks)
                }
            };
            solved.ranked.push(ranked);
        }
        solved
    }

    /// Ranks by q of W, gains by q of H. The spectrum is the paper's if that was asked for, else the identity's.
    fn participation(&self, factor: &Factor, w: &[Row], h: &[Row], solved: &mut Solved) -> Ranking {
        let Participation { spectrum, r, q, canonical } = factor.participation(w, self.tau);
        let paper = !matches!(factor, Factor::Identity);
        if paper || solved.spectrum[0] == 0.0 {
            (solved.spectrum, solved.r) = (spectrum, r as u32);
        }
        solved.canonical |= canonical;
        Ranking { rank: rank(&q), gain: factor.participation(h, self.tau).q }
    }
}

/// Guards that a block called for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Guards {
    /// Its metric was not positive definite, and its canonical form was used.
    pub canonical: bool,
    /// It had overlaps or responses that were not finite.
    pub repaired: bool,
}

/// Results of all blocks, collected batch by batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Collected {
    /// One ranking for each of the solver's selectors, over all Gaussians.
    pub rankings: Vec<Ranking>,
    /// r of each block, blocks.
    pub r: Vec<u32>,
    /// Sum over blocks of the eight largest eigenvalues, each block's divided by its sum.
    pub spectrum: [f64; CHANNELS],
    /// Blocks solved by the canonical fallback.
    pub canonical: usize,
    /// Blocks without any response.
    pub unseen: usize,
    /// Overlaps and responses that were not finite.
    pub repaired: usize,
    /// Guards of each block, blocks.
    pub guards: Vec<Guards>,
}

impl Collected {
    /// Room for `blocks` under `selectors` rankings.
    pub fn new(blocks: &Blocks, selectors: usize) -> Self {
        let n = blocks.members.len();
        Self {
            rankings: vec![Ranking { rank: vec![0; n], gain: vec![0.0; n] }; selectors],
            r: vec![1; blocks.len()],
            guards: vec![Guards::default(); blocks.len()],
            ..Self::default()
        }
    }

    /// Adds the result of block `b`. The order of calls affects only the rounding of the spectrum.
    pub fn take(&mut self, blocks: &Blocks, b: usize, solved: &Solved) {
        for (ranking, ranked) in self.rankings.iter_mut().zip(&solved.ranked) {
            for ((&i, &rank), &gain) in blocks.block(b).iter().zip(&ranked.rank).zip(&ranked.gain) {
                ranking.rank[i as usize] = rank;
                ranking.gain[i as usize] = gain;
            }
        }
        self.r[b] = solved.r;
        self.guards[b] = Guards { canonical: solved.canonical, repaired: solved.repaired > 0 };
        let total: f64 = solved.spectrum.iter().sum();
        if total > 0.0 {
            self.spectrum.iter_mut().zip(solved.spectrum).for_each(|(sum, l)| *sum += l / total);
        }
        self.canonical += usize::from(solved.canonical);
        self.unseen += usize::from(solved.unseen);
        self.repaired += solved.repaired;
    }
}
