//! The host half of QIRF: blocks, eigenproblems, rankings and budgets.

mod hard_cases;
mod pairs;
mod participation;
mod partition;
mod real;
mod select;

use qirf_vk::qirf::assemble::{BlockMatrices, symmetric};
use qirf_vk::qirf::dense::Library;
use qirf_vk::qirf::participation::{Eigensolver, Gram, Participation, solve};
use qirf_vk::qirf::partition::Blocks;
use qirf_vk::qirf::{CHANNELS, Row};
use qirf_vk::reference::rrdm;

/// Blocks of these sizes over consecutive Gaussians.
fn blocks(sizes: &[usize]) -> Blocks {
    let mut starts = vec![0_u32];
    starts.extend(sizes.iter().scan(0, |sum, &size| {
        *sum += size as u32;
        Some(*sum)
    }));
    Blocks { members: (0..sizes.iter().sum::<usize>() as u32).collect(), starts }
}

/// A block's matrices in the device's format, computed by the twin.
pub struct Made {
    /// N's lower triangle, packed.
    overlap: Vec<f32>,
    /// W, column by column.
    factor: Vec<f32>,
    divisors: [f32; 2],
    /// P's lower triangle, packed.
    density: Vec<f32>,
}

impl Made {
    /// Matrices from N (m x m) and rows of H, which contain the weights of eta = 0.75, at epsilon 1e-4.
    pub fn new(overlap: &[f32], rows: &[[f32; CHANNELS]]) -> Self {
        let (m, eta, epsilon) = (rows.len(), 0.75_f64, 1e-4);
        let share = |c: usize| if c < 4 { eta } else { 1.0 - eta };
        let bare: Vec<Row> =
            rows.iter().map(|row| std::array::from_fn(|c| f64::from(row[c]) / share(c).sqrt())).collect();
        let w = rrdm::w(&bare, eta, epsilon);
        let p = rrdm::p(&w);
        let trace = |channels: std::ops::Range<usize>| -> f64 {
            bare.iter().flat_map(|row| &row[channels.clone()]).map(|x| x * x).sum()
        };
        let triangle = || (0..m).flat_map(|c| (c..m).map(move |r| r * m + c));
        Self {
            overlap: triangle().map(|k| overlap[k]).collect(),
            factor: (0..CHANNELS).flat_map(|c| w.iter().map(move |row| row[c] as f32)).collect(),
            divisors: [trace(0..4), trace(4..8)].map(|t| (t + epsilon) as f32),
            density: triangle().map(|k| p[k] as f32).collect(),
        }
    }

    pub fn matrices(&self) -> BlockMatrices<'_> {
        let Self { overlap, factor, divisors, density } = self;
        BlockMatrices { m: factor.len() / CHANNELS, overlap, factor, divisors: *divisors, density }
    }

    /// The solution by one of the host's solvers.
    pub fn solved(&self, solver: Eigensolver, library: &'static dyn Library) -> Participation {
        let matrices = self.matrices();
        let metric = Gram::new(matrices.m, &symmetric(matrices.m, matrices.overlap), None, 1e-4).by(library);
        solve(&metric, &matrices.rows().0, matrices.density, solver, 0.95).0
    }
}
