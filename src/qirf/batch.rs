//! Ranks and gains of a batch of blocks, computed in parallel over blocks while the device assembles the next batch.

use super::assemble::{BlockMatrices, symmetric};
use super::participation::{Eigensolver, Factor, Gram, Participation, lowdin, norm, solve};
use super::partition::Blocks;
use super::select::{Ranking, Selector, css, rank};
use super::{CHANNELS, Row};
use rayon::prelude::*;

/// Share of a block after which the column subset stops; the others are ranked by their gain at that point.
const CSS_SHARE: f64 = 0.5;

/// Input of one block.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// N, W and, for [`Eigensolver::Dsygvd`], P.
    pub matrices: BlockMatrices<'a>,
    /// Its members' opacities or their logits, m, which rank a block without any response.
    pub opacity: &'a [f32],
    /// S_ii of its members, m (see [`Metric::self_overlap`](super::overlap::Metric::self_overlap)), for the raw overlap; otherwise `None`.
    pub self_overlaps: Option<&'a [f64]>,
}

/// Options for solving blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Solver {
    /// Solver of the paper's eigenproblem; with [`Eigensolver::Device`] the host does not solve it.
    pub eigensolver: Eigensolver,
    /// Added to the metric's diagonal.
    pub epsilon: f64,
    /// Share of the energy that the leading eigenvalues reach.
    pub tau: f64,
    /// Selectors to rank by: those that read blocks ([`Selector::reads_blocks`]).
    pub selectors: Vec<Selector>,
}

impl Default for Solver {
    fn default() -> Self {
        Self { eigensolver: Eigensolver::default(), epsilon: 1e-4, tau: 0.95, selectors: vec![Selector::Gnso] }
    }
}

/// Solution of a block's eigenproblem.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Modes {
    /// The eight largest eigenvalues, descending.
    pub spectrum: [f64; CHANNELS],
    /// The fewest eigenvalues that reach tau, at least 1.
    pub r: u32,
    /// Participation of each member, m.
    pub participation: Vec<f64>,
    /// True if the metric was not positive definite: its canonical form was used in place of the requested solver.
    pub canonical: bool,
    /// True if no member has any response, so that opacity decides.
    pub unseen: bool,
}

/// Results of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The ranking by each selector of the solver, in the same order; without [`Selector::Gnso`] if the paper's
    /// eigenproblem is solved elsewhere.
    pub ranked: Vec<(Selector, Ranking)>,
    /// Solution of the paper's eigenproblem; `None` if it is solved elsewhere.
    pub modes: Option<Modes>,
    /// Overlaps and responses that were not finite.
    pub repaired: usize,
}

/// The order of a block without any response: by opacity.
pub fn by_opacity(opacity: &[f32]) -> Ranking {
    let opacity: Vec<f64> = opacity.iter().map(|&o| f64::from(o)).collect();
    Ranking { rank: rank(&opacity), gain: vec![0.0; opacity.len()] }
}

impl Solver {
    /// Solves each block on its own, in parallel; the result does not depend on the number of threads.
    pub fn solve(&self, batch: &[Block<'_>]) -> Vec<Solved> {
        batch.par_iter().with_max_len(1).map(|block| self.solve_one(block)).collect()
    }

    /// Solves one block.
    ///
    /// # Panics
    /// If the block's arrays disagree on its size, or lack W, or a selector does not read blocks.
    pub fn solve_one(&self, block: &Block<'_>) -> Solved {
        let m = block.matrices.m;
        assert!(
            block.matrices.factor.len() == CHANNELS * m && block.opacity.len() == m,
            "a block's arrays have its size"
        );
        let (w, repaired) = block.matrices.rows();
        let on_host = self.eigensolver != Eigensolver::Device;
        if w.iter().flatten().all(|&x| x == 0.0) {
            let unseen = Modes { r: 1, participation: vec![0.0; m], unseen: true, ..Modes::default() };
            let ranked = self.selectors.iter().map(|selector| (*selector, by_opacity(block.opacity))).collect();
            return Solved { ranked, modes: on_host.then_some(unseen), repaired };
        }
        let scales = block.matrices.scales();
        let h: Vec<Row> = w.iter().map(|row| std::array::from_fn(|c| row[c] * scales[c])).collect();
        let overlap = symmetric(m, block.matrices.overlap);
        let metric = Gram::new(m, &overlap, block.self_overlaps, self.epsilon);
        let mut solved = Solved { ranked: Vec::new(), modes: None, repaired: repaired + metric.repaired };
        let paper = on_host.then(|| solve(&metric, &w, block.matrices.density, self.eigensolver, self.tau));
        for &selector in &self.selectors {
            let ranking = match selector {
                Selector::Gnso => {
                    let Some((participation, factor)) = &paper else { continue };
                    Ranking { rank: rank(&participation.q), gain: factor.participation(&h, self.tau).q }
                }
                Selector::Ordinary => {
                    let q = |rows: &[Row]| Factor::identity().participation(rows, self.tau).q;
                    Ranking { rank: rank(&q(&w)), gain: q(&h) }
                }
                Selector::Lowdin => {
                    let [local, gain]: [Vec<f64>; 2] =
                        lowdin(&metric, &[&w, &h]).try_into().unwrap_or_else(|_| [vec![0.0; m], vec![0.0; m]]);
                    Ranking { rank: rank(&local), gain }
                }
                Selector::Css => {
                    let weights: Vec<f64> = h.iter().map(norm).collect();
                    let picks = (CSS_SHARE * m as f64).ceil() as usize;
                    css::order(&overlap, &weights, picks)
                }
                other => panic!("{other} does not read blocks"),
            };
            solved.ranked.push((selector, ranking));
        }
        solved.modes = paper.map(|(Participation { spectrum, r, q, canonical }, _)| Modes {
            spectrum,
            r: r as u32,
            participation: q,
            canonical,
            unseen: false,
        });
        solved
    }
}

/// Numerical safeguards that a block triggered.
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
    /// The order of all Gaussians by each selector.
    pub rankings: Vec<(Selector, Ranking)>,
    /// Participation of each Gaussian in its block's leading modes, n.
    pub participation: Vec<f32>,
    /// r of each block.
    pub r: Vec<u32>,
    /// The eight largest eigenvalues of each block as shares of their sum; zeros for a block without any response.
    pub energies: Vec<[f64; CHANNELS]>,
    /// Blocks that the requested solver could not factorise: those in canonical form, and those that the device left to the
    /// host.
    pub fallbacks: usize,
    /// Blocks solved in their metric's canonical form.
    pub canonical: usize,
    /// Blocks without any response.
    pub unseen: usize,
    /// Overlaps and responses that were not finite.
    pub repaired: usize,
    /// Safeguards of each block.
    pub guards: Vec<Guards>,
}

impl Collected {
    /// Room for the rankings of `blocks` by these selectors.
    pub fn new(blocks: &Blocks, selectors: &[Selector]) -> Self {
        let n = blocks.members.len();
        let ranking = |s: &Selector| (*s, Ranking { rank: vec![0; n], gain: vec![0.0; n] });
        Self {
            rankings: selectors.iter().map(ranking).collect(),
            participation: vec![0.0; n],
            r: vec![1; blocks.len()],
            energies: vec![[0.0; CHANNELS]; blocks.len()],
            guards: vec![Guards::default(); blocks.len()],
            ..Self::default()
        }
    }

    /// Adds the result of block `b`; the order of calls does not matter.
    pub fn take(&mut self, blocks: &Blocks, b: usize, solved: &Solved) {
        let members = blocks.block(b);
        for (selector, ranked) in &solved.ranked {
            let Some((_, ranking)) = self.rankings.iter_mut().find(|(s, _)| s == selector) else { continue };
            for ((&i, &rank), &gain) in members.iter().zip(&ranked.rank).zip(&ranked.gain) {
                ranking.rank[i as usize] = rank;
                ranking.gain[i as usize] = gain;
            }
        }
        self.guards[b].repaired |= solved.repaired > 0;
        self.repaired += solved.repaired;
        let Some(modes) = &solved.modes else { return };
        members.iter().zip(&modes.participation).for_each(|(&i, q)| self.participation[i as usize] = *q as f32);
        self.r[b] = modes.r;
        let total: f64 = modes.spectrum.iter().sum();
        self.energies[b] = modes.spectrum.map(|lambda| if total > 0.0 { lambda / total } else { 0.0 });
        self.guards[b].canonical = modes.canonical;
        self.fallbacks += usize::from(modes.canonical);
        self.canonical += usize::from(modes.canonical);
        self.unseen += usize::from(modes.unseen);
    }
}
