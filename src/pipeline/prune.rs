//! One prune of a model: responses, study of its blocks, selection, merge, and compaction of a model in training.

use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::job::config::{PruneRule, ResponseSource};
use crate::job::diagnostics::Diagnostics;
use crate::job::records::{PruneGuards, PruneRecord, PruneSeconds, RankRecord};
use crate::qirf::CHANNELS;
use crate::qirf::pairs::{self, Pairs};
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Choice, Keep};
use crate::qirf::study::{Observed, Study};
use crate::render::Source;
use crate::response::Responses;
use crate::train::Trainer;
use std::time::Instant;

/// Parameters of one prune.
#[derive(Clone, Copy, Debug)]
pub struct PruneRequest<'a> {
    /// Choice of Gaussians.
    pub compression: &'a PruneRule,
    /// Number or share to keep, in place of the compression's own.
    pub keep: Keep,
    /// Key of all random numbers.
    pub seed: u32,
}

/// Prunes a model in training, with responses from `source`; `follow` is called with the model before the prune and what became
/// of its Gaussians.
pub fn prune(
    device: &Device,
    trainer: &mut Trainer,
    source: ResponseSource,
    request: &PruneRequest<'_>,
    follow: impl FnOnce(&Gaussians, &Diagnostics) -> Result<(), Error>,
) -> Result<PruneRecord, Error> {
    let begun = Instant::now();
    let responses = respond(trainer, source, request.compression.selector)?;
    let responses_s = begun.elapsed().as_secs_f64();
    let mut record = prune_by(device, trainer, &responses, request, follow)?;
    record.seconds.add_responses(responses_s);
    Ok(record)
}

/// Responses of the training views to each Gaussian, and the scores that the selector reads.
fn respond(trainer: &mut Trainer, source: ResponseSource, selector: Selector) -> Result<Responses, Error> {
    let averages = if source == ResponseSource::Average { trainer.averages()? } else { None };
    // Averages lack scores.
    match averages {
        Some(averages) if !selector.reads().scores => Ok(averages),
        _ => Ok(trainer.responses(selector.reads())?),
    }
}

/// Prunes a model in training with given responses; `follow` is as in [`prune`], and is not called if only a part of the
/// model is chosen from.
pub fn prune_by(
    device: &Device,
    trainer: &mut Trainer,
    responses: &Responses,
    request: &PruneRequest<'_>,
    follow: impl FnOnce(&Gaussians, &Diagnostics) -> Result<(), Error>,
) -> Result<PruneRecord, Error> {
    let begun = Instant::now();
    let model = trainer.download()?;
    let PrunePlan { mut record, keep, merged, diagnostics } = if trainer.trained() == model.len() {
        plan(device, trainer.model().into(), &model, responses, request)?
    } else {
        beside_tail(device, trainer.trained(), &model, responses, request)?
    };
    if diagnostics.flags.len() == model.len() {
        follow(&model, &diagnostics)?;
    }
    let compacting = Instant::now();
    trainer.keep(&keep, merged.as_ref())?;
    record.iteration = trainer.iteration();
    record.seconds.merge += compacting.elapsed().as_secs_f64();
    record.seconds.total = begun.elapsed().as_secs_f64();
    Ok(record)
}

/// The plan for a model of which only the first `trained` Gaussians are chosen from: the rest is a tail that stays.
fn beside_tail(
    device: &Device,
    trained: usize,
    model: &Gaussians,
    responses: &Responses,
    request: &PruneRequest<'_>,
) -> Result<PrunePlan, Error> {
    let (head, tail): (Vec<usize>, Vec<usize>) = (0..model.len()).partition(|i| *i < trained);
    let (head, tail) = (model.select(&head), model.select(&tail));
    let mut plan = plan(device, Source::Host(&head), &head, &responses.of_first(trained), request)?;
    if let Some(merged) = &mut plan.merged {
        merged.append(&tail);
    }
    Ok(plan)
}

/// The result of planning a prune.
pub struct PrunePlan {
    /// Statistics of the blocks, and times.
    pub record: PruneRecord,
    /// For each Gaussian, whether it is kept; n.
    pub keep: Vec<bool>,
    /// After merging, the model, all n: the kept Gaussians include the dropped ones' contributions.
    pub merged: Option<Gaussians>,
    /// Block, score and fate of each Gaussian.
    pub diagnostics: Diagnostics,
}

impl PrunePlan {
    /// The kept Gaussians of the model that the plan was made for.
    pub fn apply(self, model: Gaussians) -> (PruneRecord, Gaussians) {
        let kept: Vec<usize> = (0..self.keep.len()).filter(|i| self.keep[*i]).collect();
        (self.record, self.merged.unwrap_or(model).select(&kept))
    }
}

/// Decides which Gaussians of `model` to keep; `source` says where it is shown from. Studies its blocks (partition, overlap,
/// solution), selects, and merges if requested.
pub fn plan(
    device: &Device,
    source: Source<'_>,
    model: &Gaussians,
    responses: &Responses,
    request: &PruneRequest<'_>,
) -> Result<PrunePlan, Error> {
    let begun = Instant::now();
    let PruneRequest { compression, keep, seed } = *request;
    let selector = compression.selector;
    if selector == Selector::Pairs {
        return Ok(pairs(model, responses, keep, begun));
    }
    let uploaded;
    let resident = match source {
        Source::Device(resident) => resident,
        Source::Host(model) => {
            uploaded = Resident::upload_shapes(device, model)?;
            &uploaded
        }
    };
    let observed = Observed { resident, model, responses };
    let study = Study::new(device, observed, &compression.basis, &[selector], seed)?;
    let choosing = Instant::now();
    let choice = study.choose(selector, compression.budget, keep, compression.detail);
    let select = choosing.elapsed().as_secs_f64();
    let diagnostics = Diagnostics::of_blocks(selector, &study, &choice, responses);
    let mut record = record(selector, &study, &choice);
    let merging = Instant::now();
    let mut merged = compression.merge.then(|| model.clone());
    if let Some(merged) = &mut merged {
        record.merged = Some(study.merge(device, resident, merged, &choice.keep)?);
        record.seconds.merge = merging.elapsed().as_secs_f64();
    }
    record.seconds.select = select;
    record.seconds.total = begun.elapsed().as_secs_f64();
    Ok(PrunePlan { record, keep: choice.keep, merged, diagnostics })
}

/// The plan of merging pairs, which needs neither blocks nor a budget.
fn pairs(model: &Gaussians, responses: &Responses, keep: Keep, begun: Instant) -> PrunePlan {
    let Responses { scores, cameras, dilation, .. } = responses;
    of_pairs(pairs::merge(model, scores, cameras, *dilation, keep.count(model.len())), responses, begun)
}

/// The plan of pairs that were merged since `begun`.
pub fn of_pairs(merged: Pairs, responses: &Responses, begun: Instant) -> PrunePlan {
    let after = merged.keep.iter().filter(|k| **k).count();
    let seconds = begun.elapsed().as_secs_f64();
    let record = PruneRecord {
        selector: Selector::Pairs,
        before: merged.keep.len(),
        after,
        pairs: Some(merged.counts),
        seconds: PruneSeconds { merge: seconds, total: seconds, ..PruneSeconds::default() },
        ..PruneRecord::default()
    };
    let diagnostics = Diagnostics::of_pairs(&merged, responses);
    PrunePlan { record, keep: merged.keep, merged: Some(merged.model), diagnostics }
}

/// The figures of a study and of its choice; the iteration is filled in later.
fn record(selector: Selector, study: &Study, choice: &Choice) -> PruneRecord {
    let blocks = &study.partitioned.blocks;
    let c = &study.collected;
    let (mut occupancy, mut kept_shares, mut modes) = (Vec::new(), [0; 10], [0; CHANNELS]);
    let mut ranks: [RankRecord; CHANNELS] =
        std::array::from_fn(|k| RankRecord { rank: k + 1, ..RankRecord::default() });
    for ((members, r), energies) in blocks.iter().zip(&c.r).zip(&c.energies) {
        let bin = members.len().max(1).ilog2() as usize;
        occupancy.resize(occupancy.len().max(bin + 1), 0);
        occupancy[bin] += 1;
        let kept = members.iter().filter(|i| choice.keep[**i as usize]).count();
        kept_shares[(10 * kept / members.len().max(1)).min(9)] += 1;
        if let Some(rank) = effective_rank(energies) {
            modes[(*r as usize).clamp(1, CHANNELS) - 1] += 1;
            let of_rank = &mut ranks[(rank.round() as usize).clamp(1, CHANNELS) - 1];
            of_rank.blocks += 1;
            of_rank.gaussians += members.len();
            of_rank.kept += kept;
        }
    }
    let (spectrum, spectrum_spread) = mean_and_spread(&c.energies);
    PruneRecord {
        selector,
        before: choice.keep.len(),
        after: choice.kept(),
        detail: choice.detail,
        blocks: blocks.len(),
        voxel: study.partitioned.voxel,
        occupancy,
        kept_shares,
        solver: study.solver,
        spectrum,
        spectrum_spread,
        modes,
        effective_ranks: ranks.into_iter().filter(|r| r.blocks > 0).collect(),
        guards: PruneGuards {
            fallback_blocks: c.fallbacks,
            canonical_blocks: c.canonical,
            unseen_blocks: c.unseen,
            repaired_values: c.repaired,
        },
        seconds: PruneSeconds { study: study.seconds, ..PruneSeconds::default() },
        ..PruneRecord::default()
    }
}

/// Effective rank of a block (Roy and Vetterli 2007): the exponential of the entropy of its eigenvalues' shares; none for a
/// block without any response.
fn effective_rank(energies: &[f64; CHANNELS]) -> Option<f64> {
    let seen = energies.iter().any(|p| *p > 0.0);
    let entropy: f64 = energies.iter().filter(|p| **p > 0.0).map(|p| -p * p.ln()).sum();
    seen.then(|| entropy.exp())
}

/// Mean and standard deviation over the blocks that have any response of each eigenvalue's share.
fn mean_and_spread(energies: &[[f64; CHANNELS]]) -> ([f64; CHANNELS], [f64; CHANNELS]) {
    let seen: Vec<_> = energies.iter().filter(|e| e.iter().any(|p| *p > 0.0)).collect();
    if seen.is_empty() {
        return Default::default(); // a sum of nothing is -0
    }
    let count = seen.len() as f64;
    let mean: [f64; CHANNELS] = std::array::from_fn(|k| seen.iter().map(|e| e[k]).sum::<f64>() / count);
    let variance = |k: usize| seen.iter().map(|e| (e[k] - mean[k]).powi(2)).sum::<f64>() / count;
    (mean, std::array::from_fn(|k| variance(k).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effective_ranks_count_equal_modes() {
        assert_eq!(effective_rank(&[0.0; CHANNELS]), None);
        assert!((effective_rank(&[1.0 / 8.0; CHANNELS]).unwrap() - 8.0).abs() < 1e-12);
        let two = [0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!((effective_rank(&two).unwrap() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn spread_leaves_unseen_blocks_out() {
        let mut one = [0.0; CHANNELS];
        one[0] = 1.0;
        let mut other = [0.0; CHANNELS];
        (other[0], other[1]) = (0.5, 0.5);
        let (mean, spread) = mean_and_spread(&[one, [0.0; CHANNELS], other]);
        assert_eq!((mean[0], mean[1]), (0.75, 0.25));
        assert!((spread[0] - 0.25).abs() < 1e-12 && (spread[1] - 0.25).abs() < 1e-12);
        assert_eq!(mean_and_spread(&[]), ([0.0; CHANNELS], [0.0; CHANNELS]));
    }
}
