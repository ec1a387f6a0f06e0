//! Merging of dropped Gaussians into kept ones, block by block.

use super::{BATCH_BYTES, Merging, Study, self_overlaps};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE, opacity};
use crate::gpu::{self, Device, Timings};
use crate::qirf::assemble::{Assembly, Options, symmetric};
use crate::qirf::overlap::Metric;
use crate::qirf::partition::Blocks;
use crate::qirf::select::merge::{Functions, merge};
use rayon::prelude::*;

impl Study {
    /// Merges dropped Gaussians of `model` into kept ones: opacities and colours of kept ones change if that lowers the
    /// error of their block. `model` is the studied model, and `resident` its copy on the device.
    pub fn merge(
        &self,
        device: &Device,
        resident: &Resident,
        model: &mut Gaussians,
        keep: &[bool],
    ) -> gpu::Result<Merging> {
        // Merging represents the model's own functions, however they were widened to be ranked.
        let metric = Metric::default();
        let own = self_overlaps(model, metric);
        let blocks = &self.partitioned.blocks;
        let mut merging = Merging::default();
        self.overlaps(device, resident, metric, |batch| {
            let before: &Gaussians = model;
            let merged: Vec<_> = batch
                .par_iter()
                .with_max_len(1)
                .map(|(b, overlap)| {
                    let members = blocks.block(*b);
                    let mut functions = functions(before, members, &own);
                    let kept: Vec<bool> = members.iter().map(|i| keep[*i as usize]).collect();
                    merge(&symmetric(members.len(), overlap), &kept, &mut functions)
                        .map(|m| (m.accepted, kept, functions))
                })
                .collect();
            for ((b, _), merged) in batch.iter().zip(merged) {
                let Some((accepted, kept, functions)) = merged else { continue };
                merging.accepted += usize::from(accepted);
                merging.refused += usize::from(!accepted);
                if accepted {
                    store(model, blocks.block(*b), &kept, &functions);
                }
            }
        })?;
        Ok(merging)
    }

    /// Calls `body` with the packed lower triangles of N, batch by batch, while the device assembles the next batch.
    fn overlaps(
        &self,
        device: &Device,
        resident: &Resident,
        metric: Metric,
        mut body: impl FnMut(&[(usize, &[f32])]),
    ) -> gpu::Result<Timings> {
        let Blocks { members, starts } = &self.partitioned.blocks;
        let options = Options { metric, density: None, batch_bytes: BATCH_BYTES };
        let assembly = Assembly::new(device, resident, members, starts, &[], options)?;
        assembly.for_each(|assembled| {
            body(&assembled.iter().map(|(b, matrices)| (b, matrices.overlap)).collect::<Vec<_>>());
            Ok(())
        })
    }
}

/// Offsets of the bands in a row of all coefficients, and the width of the row.
fn layout(model: &Gaussians) -> (Vec<usize>, usize) {
    let mut width = 0;
    let mut starts = Vec::with_capacity(MAX_SH_DEGREE + 1);
    for l in 0..model.sh.len() {
        starts.push(width);
        width += Gaussians::band_width(l);
    }
    (starts, width)
}

fn functions(model: &Gaussians, members: &[u32], own: &[f64]) -> Functions {
    let (_, width) = layout(model);
    let mut sh = Vec::with_capacity(members.len() * width);
    for &i in members {
        for (l, band) in model.sh.iter().enumerate() {
            let w = Gaussians::band_width(l);
            sh.extend(band[i as usize * w..(i as usize + 1) * w].iter().map(|x| f64::from(*x)));
        }
    }
    let alpha = |i: &u32| opacity(model.opacity_logits[*i as usize]);
    Functions {
        alpha: members.iter().map(alpha).collect(),
        sh,
        width,
        self_overlaps: members.iter().map(|i| own[*i as usize]).collect(),
    }
}

fn store(model: &mut Gaussians, members: &[u32], kept: &[bool], functions: &Functions) {
    let (starts, width) = layout(model);
    for (row, &i) in members.iter().enumerate().filter(|(row, _)| kept[*row]) {
        let (i, alpha) = (i as usize, functions.alpha[row]);
        let logit = &mut model.opacity_logits[i];
        // An opacity that did not change keeps its logit: one that rounds to 0 or 1 would get an infinite logit.
        if alpha != opacity(*logit) {
            *logit = (alpha / (1.0 - alpha)).ln() as f32;
        }
        for (l, start) in starts.iter().enumerate() {
            let w = Gaussians::band_width(l);
            let from = &functions.sh[row * width + start..][..w];
            model.sh[l][i * w..(i + 1) * w].iter_mut().zip(from).for_each(|(to, x)| *to = *x as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opacities_that_do_not_change_keep_their_logits() {
        let mut model = Gaussians::zeroed(3, 0);
        model.opacity_logits = vec![-800.0, 40.0, 0.0];
        let members = [0, 1, 2];
        let mut merged = functions(&model, &members, &[1.0; 3]);
        assert_eq!(merged.alpha, [0.0, 1.0, 0.5]);
        merged.alpha[2] = 0.75;
        merged.sh[6] = 0.5;
        store(&mut model, &members, &[true; 3], &merged);
        assert_eq!(model.opacity_logits, [-800.0, 40.0, 3_f64.ln() as f32]);
        assert_eq!(model.sh[0][6], 0.5);
    }
}
