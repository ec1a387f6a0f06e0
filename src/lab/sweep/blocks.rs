//! Blocks of the subject's Gaussians, with the data of their eigenproblems.

use super::Context;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::pipeline::Error;
use crate::qirf::assemble::{Assembly, Options, unpack_symmetric};
use crate::qirf::overlap::Metric;
use crate::qirf::partition::{Blocks, Partition};
use crate::qirf::study::Basis;
use crate::qirf::{CHANNELS, Row, normalise};

/// Approximate number of Gaussians whose blocks are measured: of a larger model, blocks are skipped evenly.
const SAMPLE: usize = 1 << 15;

/// Blocks of a partition at even steps, with about [`SAMPLE`] Gaussians in total.
pub fn sampled(model: &Gaussians, partition: Partition) -> Blocks {
    let all = partition.of(&model.means).blocks;
    let step = model.len().div_ceil(SAMPLE).max(1);
    of((0..all.len()).step_by(step).map(|b| all.block(b).to_vec()))
}

/// `count` blocks of exactly `m` Gaussians: the `m` nearest to each of `count` at even steps. None if there are fewer.
pub fn of_size(model: &Gaussians, m: usize, count: usize) -> Blocks {
    let n = model.len();
    let nearest = |k: usize| {
        let at = model.means[k * n / count];
        let far = |i: u32| (0..3).map(|c| f64::from(model.means[i as usize][c] - at[c]).powi(2)).sum::<f64>();
        let mut members: Vec<(f64, u32)> = (0..n as u32).map(|i| (far(i), i)).collect();
        members.select_nth_unstable_by(m - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut members: Vec<u32> = members[..m].iter().map(|(_, i)| *i).collect();
        members.sort_unstable();
        members
    };
    of((0..if m <= n { count } else { 0 }).map(nearest))
}

/// Blocks with the given members.
pub fn of(blocks: impl Iterator<Item = Vec<u32>>) -> Blocks {
    let mut out = Blocks { members: Vec::new(), starts: vec![0] };
    for block in blocks {
        out.members.extend(block);
        out.starts.push(out.members.len() as u32);
    }
    out
}

/// Jaccard index of two sets: share of their union that both keep; 0 if neither keeps any.
pub fn jaccard(a: &[bool], b: &[bool]) -> f64 {
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let either = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    both as f64 / either.max(1) as f64
}

/// One block's eigenproblem.
pub struct Problem {
    /// N, m x m, symmetric.
    pub overlap: Vec<f32>,
    /// Rows of W, m.
    pub rows: Vec<Row>,
}

impl Problem {
    /// Members.
    pub fn len(&self) -> usize {
        self.rows.len()
    }
}

/// Rows of H of the subject, n.
pub fn rows(context: &Context<'_>, eta: f64) -> Vec<[f32; CHANNELS]> {
    normalise::rows(&context.subject.responses.channels, eta)
}

/// The eigenproblems of blocks, from the engine's own assembly and normalisation.
///
/// # Errors
/// Device memory; device errors.
pub fn problems(
    context: &Context<'_>,
    resident: &Resident,
    blocks: &Blocks,
    metric: Metric,
    basis: &Basis,
) -> Result<Vec<Problem>, Error> {
    let Basis { eta, epsilon, .. } = *basis;
    let h = rows(context, eta);
    let options = Options { metric, ..Options::default() };
    let assembly = Assembly::new(context.session.device, resident, &blocks.members, &blocks.starts, &[], options)?;
    let mut out = Vec::with_capacity(blocks.len());
    assembly.for_each(|batch| -> Result<(), Error> {
        for (b, matrices) in batch.iter() {
            let mut overlap = vec![0.0; matrices.m * matrices.m];
            unpack_symmetric(matrices.m, matrices.overlap, &mut overlap);
            let own: Vec<Row> = blocks.block(b).iter().map(|i| h[*i as usize].map(f64::from)).collect();
            out.push(Problem { overlap, rows: normalise::within_block(&own, eta, epsilon) });
        }
        Ok(())
    })?;
    Ok(out)
}
