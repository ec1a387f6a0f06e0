//! One prune of a model: responses, study of its blocks, selection, merge, and compaction of a model in training.

use super::config::{Compression, ResponseSource};
use super::records::{PruneGuards, PruneRecord, PruneSeconds};
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::qirf::CHANNELS;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Choice, Keep};
use crate::qirf::study::Study;
use crate::response::Responses;
use crate::train::Trainer;
use std::time::Instant;

/// Prunes a model in training by what it responds to, and says what that did.
///
/// # Errors
/// Device memory; device errors.
pub fn prune(
    device: &Device,
    trainer: &mut Trainer,
    compression: &Compression,
    keep: Keep,
    source: ResponseSource,
    seed: u32,
) -> Result<PruneRecord, Error> {
    let begun = Instant::now();
    let averages = if source == ResponseSource::Average { trainer.averages()? } else { None };
    // Only selectors of other methods read scores, which averages lack.
    let with_scores = compression.selector.reads_scores();
    let responses = match averages {
        Some(averages) if !with_scores => averages,
        _ => trainer.responses(with_scores)?,
    };
    let responses_s = begun.elapsed().as_secs_f64();
    let mut pruned = prune_by(device, trainer, compression, keep, &responses, seed)?;
    pruned.seconds.responses = responses_s;
    pruned.seconds.total += responses_s;
    Ok(pruned)
}

/// As [`prune`], by responses that are known already.
///
/// # Errors
/// Device memory; device errors.
pub fn prune_by(
    device: &Device,
    trainer: &mut Trainer,
    compression: &Compression,
    keep: Keep,
    responses: &Responses,
    seed: u32,
) -> Result<PruneRecord, Error> {
    let begun = Instant::now();
    let model = trainer.download()?;
    let Decision { mut pruned, keep, model } =
        decide(device, (trainer.model(), model), compression, keep, responses, seed)?;
    let compacting = Instant::now();
    trainer.keep(&keep, pruned.merged.map(|_| &model))?;
    pruned.iteration = trainer.iteration();
    pruned.seconds.merge += compacting.elapsed().as_secs_f64();
    pruned.seconds.total = begun.elapsed().as_secs_f64();
    Ok(pruned)
}

/// What to keep of a model.
pub struct Decision {
    /// What the study of it told, and how long that took.
    pub pruned: PruneRecord,
    /// Whether each Gaussian is kept, n.
    pub keep: Vec<bool>,
    /// The model, all n; where it was asked for, the kept stand for the dropped too.
    pub model: Gaussians,
}

/// Decides what to keep of `model`, which is what `resident` holds, and lets the kept stand for the dropped where asked to.
///
/// # Errors
/// Device memory; device errors.
pub fn decide(
    device: &Device,
    (resident, mut model): (&Resident, Gaussians),
    compression: &Compression,
    keep: Keep,
    responses: &Responses,
    seed: u32,
) -> Result<Decision, Error> {
    let begun = Instant::now();
    let selector = compression.selector;
    // Where blocks are solved anyway, the paper's eigenproblem comes with them: it tells how many modes they have.
    let asked = [selector, Selector::Gnso];
    let asked = if selector.of_blocks().is_some() && selector != Selector::Gnso { &asked[..] } else { &asked[..1] };
    let study = Study::new(device, (resident, &model), responses, &compression.basis, asked, seed)?;
    let choosing = Instant::now();
    let choice = study.choose(selector, compression.budget, keep, compression.detail);
    let select = choosing.elapsed().as_secs_f64();
    let mut pruned = record(0, selector, &study, &choice);
    let merging = Instant::now();
    if compression.merge {
        pruned.merged = Some(study.merge(device, resident, &mut model, &choice.keep)?);
        pruned.seconds.merge = merging.elapsed().as_secs_f64();
    }
    pruned.seconds.select = select;
    pruned.seconds.total = begun.elapsed().as_secs_f64();
    Ok(Decision { pruned, keep: choice.keep, model })
}

/// What a study and the choice made of it tell.
fn record(iteration: u32, selector: Selector, study: &Study, choice: &Choice) -> PruneRecord {
    let blocks = &study.partitioned.blocks;
    let (mut occupancy, mut kept_shares, mut modes) = (Vec::new(), [0; 10], [0; CHANNELS]);
    let solved = study.collected.spectrum.iter().any(|l| *l > 0.0);
    for (members, r) in blocks.iter().zip(&study.collected.r) {
        let bin = members.len().max(1).ilog2() as usize;
        occupancy.resize(occupancy.len().max(bin + 1), 0);
        occupancy[bin] += 1;
        let kept = members.iter().filter(|i| choice.keep[**i as usize]).count();
        kept_shares[(10 * kept / members.len().max(1)).min(9)] += 1;
        modes[(*r as usize).clamp(1, CHANNELS) - 1] += usize::from(solved);
    }
    let c = &study.collected;
    let whole: f64 = c.spectrum.iter().sum();
    PruneRecord {
        iteration,
        selector,
        before: choice.keep.len(),
        after: choice.kept(),
        detail: choice.detail,
        blocks: blocks.len(),
        voxel: study.partitioned.voxel,
        occupancy,
        kept_shares,
        spectrum: c.spectrum.map(|l| if whole > 0.0 { l / whole } else { 0.0 }),
        modes,
        guards: PruneGuards { canonical_blocks: c.canonical, unseen_blocks: c.unseen, repaired_values: c.repaired },
        merged: None,
        frames_per_second_before: None,
        seconds: PruneSeconds {
            partition: study.seconds.partition,
            assemble: study.seconds.assemble,
            solve: study.seconds.solve,
            assemble_and_solve: study.seconds.wall,
            ..PruneSeconds::default()
        },
    }
}
