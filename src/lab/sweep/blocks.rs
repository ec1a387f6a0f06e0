//! Blocks of the subject's Gaussians, with the data of their eigenproblems.

use super::subject::Context;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::qirf::assemble::{Assembly, Options};
use crate::qirf::overlap::Metric;
use crate::qirf::partition::{Blocks, Partition};
use crate::qirf::rrdm::Density;
use crate::qirf::study::Basis;
use crate::qirf::{CHANNELS, Row, normalise};

/// Approximate number of Gaussians whose blocks are measured: in a larger model, blocks are skipped evenly.
const SAMPLE: usize = 1 << 15;

/// Blocks of a partition at even steps, with about [`SAMPLE`] Gaussians in total.
pub fn sampled(model: &Gaussians, partition: Partition) -> Blocks {
    let all = partition.of(&model.means).blocks;
    let step = model.len().div_ceil(SAMPLE).max(1);
    Blocks::of((0..all.len()).step_by(step).map(|b| all.block(b)))
}

/// `count` blocks of exactly `m` Gaussians: the `m` nearest to each of `count` Gaussians at even steps. Empty if there
/// are fewer.
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
    Blocks::of((0..if m <= n { count } else { 0 }).map(nearest))
}

/// Jaccard index of two sets: share of their union that both keep; 0 if neither keeps any.
pub fn jaccard(a: &[bool], b: &[bool]) -> f64 {
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let either = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    both as f64 / either.max(1) as f64
}

/// One block's eigenproblem.
pub struct Problem {
    /// N's lower triangle, packed.
    pub overlap: Vec<f32>,
    /// Rows of W, m.
    pub rows: Vec<Row>,
    /// P's lower triangle, packed.
    pub density: Vec<f32>,
}

impl Problem {
    /// Number of members.
    pub fn len(&self) -> usize {
        self.rows.len()
    }
}

/// Rows of H of the subject, n.
pub fn rows(context: &Context<'_>, eta: f64) -> Vec<[f32; CHANNELS]> {
    normalise::rows(&context.subject.responses.channels, eta)
}

/// The eigenproblems of blocks, as assembled by the device.
pub fn problems(
    context: &Context<'_>,
    resident: &Resident,
    blocks: &Blocks,
    metric: Metric,
    basis: &Basis,
) -> Result<Vec<Problem>, Error> {
    let density = Density { eta: basis.eta as f32, epsilon: basis.epsilon as f32, full: true };
    let options = Options { metric, density: Some(density), ..Options::default() };
    let h = rows(context, basis.eta);
    let assembly = Assembly::new(context.session.device, resident, &blocks.members, &blocks.starts, &h, options)?;
    let mut out = Vec::with_capacity(blocks.len());
    assembly.for_each(|batch| -> Result<(), Error> {
        for (_, matrices) in batch.iter() {
            let (overlap, density) = (matrices.overlap.to_vec(), matrices.density.to_vec());
            out.push(Problem { overlap, rows: matrices.rows().0, density });
        }
        Ok(())
    })?;
    Ok(out)
}
