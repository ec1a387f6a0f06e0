//! The eigenproblem of the embedded blocks: the host's three solvers, and the device's own solver.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::hard::{self, Block};
use super::overlap::worse;
use crate::gpu::{Device, Groups, Recording, Result};
use crate::kernels::qirf::{Participation as Kernel, ParticipationPush, ParticipationSpec};
use crate::qirf::CHANNELS;
use crate::qirf::participation::{Eigensolver, Gram, Participation, solve};
use crate::qirf::select::rank;
use crate::reference::rrdm;

/// Share of the energy used for the embedded solutions.
const TAU: f64 = 0.95;

/// Eigenvalues, number of leading ones, participations, and true if the metric was not positive definite.
type Solution = (Vec<f64>, usize, Vec<f64>, bool);

/// One row per block: the worst error of eigenvalues and participations, relative to their largest; then rows that must
/// be exact.
fn against(solve: impl Fn(&Block) -> Result<Solution>, float32: bool) -> Result<Vec<Measure>> {
    let mut measures = Vec::new();
    let mut wrong = 0;
    for (name, block) in hard::blocks() {
        let (lambda, r, q, fell_back) = solve(&block)?;
        let relative = |got: &[f64], expected: &[f64]| {
            let most = expected.iter().copied().fold(1e-12, f64::max);
            got.iter().zip(expected).fold(0.0, |m, (g, e)| worse(m, (g - e).abs() / most))
        };
        let seen = worse(relative(&lambda, &block.lam), relative(&q, &block.q));
        measures.push((name, seen, Rounding(Block::tolerance(name, float32))));
        let places = rank(&q);
        let kept = |i: usize| (places[i] as usize) < block.k;
        let slack = if float32 { Block::tolerance(name, true) } else { 0.0 };
        wrong += usize::from(r != block.r || fell_back || !keeps_the_best(&block, kept, slack));
    }
    measures.push(("blocks missing", measures.len().abs_diff(10) as f64, Exact(0.0)));
    measures.push(("blocks whose kept set or r differs", wrong as f64, Exact(0.0)));
    Ok(measures)
}

/// Whether the paper's members are kept. A member as good as the last of them, within a share of the largest
/// participation, may replace it: copies differ only by rounding.
fn keeps_the_best(block: &Block, kept: impl Fn(usize) -> bool, slack: f64) -> bool {
    let best = |i: usize| block.paper_topk.contains(&(i as u32));
    let slack = slack * block.q.iter().copied().fold(0.0, f64::max);
    let last = (0..block.m).filter(|i| best(*i)).map(|i| block.q[i]).fold(f64::INFINITY, f64::min);
    let count = (0..block.m).filter(|i| kept(*i)).count();
    count == block.paper_topk.len() && (0..block.m).all(|i| kept(i) == best(i) || (block.q[i] - last).abs() < slack)
}

/// The block's solution by one of the host's solvers; P is the twin's.
fn solved(block: &Block, solver: Eigensolver) -> Participation {
    let (m, w) = (block.m, block.rows());
    let metric = Gram::new(m, &block.n.concat(), None, block.eps);
    let p = rrdm::p(&w);
    let density: Vec<f32> =
        (0..m).flat_map(|c| (c..m).map(move |r| (r, c))).map(|(r, c)| p[r * m + c] as f32).collect();
    solve(&metric, &w, &density, solver, TAU).0
}

pub(super) fn by_solver(solver: Eigensolver) -> Result<Vec<Measure>> {
    let solve = |block: &Block| {
        let Participation { spectrum, r, q, canonical } = solved(block, solver);
        Ok((spectrum.to_vec(), r, q, canonical))
    };
    // P reaches dsygvd in float32, as assembled by the device.
    against(solve, solver != Eigensolver::LowRank)
}

/// A block in the solver's input format.
pub struct Matrices {
    /// N's lower triangle, packed.
    pub triangle: Vec<f32>,
    /// W, column by column.
    pub factor: Vec<f32>,
}

/// The device's solutions of blocks of one size, whose matrices the host uploads: q and gain of each member, eigenvalues, r and
/// failure.
///
/// # Panics
/// If there is no block.
pub fn solutions(device: &Device, all: &[Matrices], epsilon: f32) -> Result<Vec<Vec<f32>>> {
    let (m, triangle) = (all[0].factor.len() / CHANNELS, all[0].triangle.len());
    let (count, floats) = (all.len() as u32, 2 * m + CHANNELS + 2);
    let rows: Vec<[u32; 4]> = (0..all.len()).map(|b| [b * m, m, b * triangle, 0].map(|n| n as u32)).collect();
    let of = |part: fn(&Matrices) -> &[f32]| all.iter().flat_map(part).copied().collect::<Vec<f32>>();
    let blocks = device.upload("blocks", &rows)?;
    let overlaps = device.upload("overlaps", &of(|b| &b.triangle))?;
    let factors = device.upload("response factors", &of(|b| &b.factor))?;
    let divisors = device.upload("divisors of responses", &vec![1.0; 2 * all.len()])?;
    let modes = device.buffer::<f32>("modes of blocks", factors.len())?;
    let solutions = device.buffer::<f32>("solutions", floats * all.len())?;
    let mut recording = Recording::new();
    let kernel = Kernel {
        blocks: &blocks,
        overlaps: &overlaps,
        factors: &factors,
        divisors: &divisors,
        modes: &modes,
        solutions: &solutions,
        push: ParticipationPush { first_block: 0, count, first_member: 0, epsilon, tau: TAU as f32 },
        spec: ParticipationSpec { workgroup: device.info().subgroup_size },
    };
    recording.dispatch(&kernel, Groups::Count(count));
    device.run(recording)?;
    Ok(solutions.read(device)?.chunks_exact(floats).map(<[f32]>::to_vec).collect())
}

/// The device's solution of a block.
fn on_device_alone(device: &Device, block: &Block) -> Result<Solution> {
    let m = block.m;
    let triangle = (0..m).flat_map(|c| (c..m).map(move |r| (r, c))).map(|(r, c)| block.n[r][c]).collect();
    let solved = solutions(device, &[Matrices { triangle, factor: block.columns() }], block.eps as f32)?;
    let all: Vec<f64> = solved[0].iter().copied().map(f64::from).collect();
    let (q, rest) = (&all[..m], &all[2 * m..]);
    Ok((rest[..CHANNELS].to_vec(), rest[CHANNELS] as usize, q.to_vec(), rest[CHANNELS + 1] != 0.0))
}

pub(super) fn on_device(device: &Device) -> Result<Vec<Measure>> {
    against(|block| on_device_alone(device, block), true)
}

/// Overlaps that are not a Gram matrix, as rounding might produce: eigenvalues 2.2, -0.2 and 1. The host's solvers must
/// solve the canonical form and the device must report failure; none may return the result of a broken factor.
pub(super) fn indefinite(device: &Device) -> Result<Vec<Measure>> {
    let block = Block {
        m: 3,
        n: vec![vec![1.0, 1.2, 0.0], vec![1.2, 1.0, 0.0], vec![0.0, 0.0, 1.0]],
        w: vec![vec![1.0; CHANNELS], vec![1.0; CHANNELS], vec![0.5; CHANNELS]],
        eps: 1e-4,
        ..Block::default()
    };
    // Along (1, 1) / sqrt 2 the eight equal columns have energy 16 over 2.2001; along the third axis 2 over 1.0001.
    let expected = 16.0 / 2.2001 + 2.0 / 1.0001;
    let (mut silent, mut seen) = (0, 0.0);
    for solver in Eigensolver::HOST {
        let solved = solved(&block, solver);
        silent += usize::from(!solved.canonical);
        seen = worse(seen, (solved.spectrum[0] / expected - 1.0).abs());
    }
    let (.., q, failed) = on_device_alone(device, &block)?;
    silent += usize::from(!failed || q.iter().any(|q| *q != 0.0));
    // 1.2 is stored as float32, 2e-8 off.
    Ok(vec![
        ("solvers that do not say so", silent as f64, Exact(0.0)),
        ("eigenvalue of the rest", seen, Rounding(1e-7)),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_members_as_good_may_take_a_place() {
        let mut block = hard::blocks().find(|(name, _)| *name == "B2_equal_duplicates").unwrap().1;
        let (first, second) = (|i: usize| i == 0, |i: usize| i == 1);
        assert_eq!(block.paper_topk, [0]);
        assert!(keeps_the_best(&block, first, 0.0) && !keeps_the_best(&block, second, 0.0));
        assert!(keeps_the_best(&block, second, 2e-2), "two copies");
        assert!(!keeps_the_best(&block, |_| true, 2e-2) && !keeps_the_best(&block, |_| false, 2e-2));
        block.q[1] *= 0.9;
        assert!(!keeps_the_best(&block, second, 2e-2));
    }
}
