//! Density control on the device: clone, split, prune, and the opacity reset.

use super::growth::Growth;
use super::schedule::Schedule;
use super::training_model::{Array, Tail, TrainingModel};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::constants::density::{CLONE, KEPT};
use crate::kernels::train::{
    Densify, DensifyPush, DensifySpec, GatherRows, GatherRowsSpec, ResetOpacity, ResetOpacityPush, ResetOpacitySpec,
    Sources, SourcesSpec, Split, SplitPush, SplitSpec,
};
use crate::primitives::{Count, Scan, WORKGROUP};

/// Inputs of a density step besides the model and the schedule.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The preceding iteration; also a key of its random numbers.
    pub iteration: u32,
    /// Seed of the run.
    pub seed: u32,
    /// The scene's extent in world units.
    pub extent: f64,
    /// Mean of the cameras' centres.
    pub cameras: [f32; 3],
    /// Largest number of Gaussians.
    pub most: usize,
}

/// Bytes that [`densify`] needs besides the resulting model of `after` Gaussians, made from one of `n`: arrays are
/// replaced one by one, so the widest, the moments of the last SH band, exists twice.
pub fn bytes(device: &Device, n: usize, after: usize, degree: usize) -> u64 {
    let words = Buffer::<u32>::bytes_of;
    let scan = device.bytes_of(|counts| Scan::new(counts, n as u32));
    let choice = 3 * words(n) + Count::bytes() + scan + 2 * words(after);
    choice + words(2 * n.max(after) * Gaussians::band_width(degree))
}

/// Clones, splits and prunes the Gaussians of a model in training, without its tail. Returns their new number.
///
/// # Errors
/// Device memory: the model is then unchanged. Device errors: the model is then lost.
pub fn densify(device: &Device, training: &mut TrainingModel, schedule: &Schedule, step: Step) -> Result<usize> {
    let choice = Choice::new(device, training, schedule, step)?;
    let after = choice.after;
    let rows = Rows::room(device, after, training)?;
    let mut recording = Recording::new();
    let count = training.count();
    let kernel = Sources {
        count: &count.value,
        copies: &choice.copies,
        splits: &choice.splits,
        offsets: &choice.offsets,
        sources: &rows.sources,
        kinds: &rows.kinds,
        spec: SourcesSpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
    device.run(recording)?;
    rows.gather(device, training)?;
    let (count, parameters) = (training.count(), &training.model.parameters);
    let kernel = Split {
        count: &count.value,
        kinds: &rows.kinds,
        rotations: &training.model.quaternions(),
        means: &parameters.means,
        log_scales: &parameters.log_scales,
        logits: &parameters.opacity_logits,
        push: SplitPush { seed: step.seed, iteration: step.iteration },
        spec: SplitSpec { workgroup: WORKGROUP, lengthwise: schedule.growth.is_some() },
    };
    let mut recording = Recording::new();
    recording.dispatch(&kernel, count.groups(WORKGROUP));
    device.run(recording)?;
    Ok(after)
}

/// Keeps only the Gaussians `kept`, in that order, with their moments, and the tail; growth restarts at zero.
pub fn compact(device: &Device, training: &mut TrainingModel, kept: &[u32]) -> Result<()> {
    replace(device, training, kept, &vec![false; kept.len()])
}

/// Replaces every trained row by the one in `sources`, with its moments, or with zero moments if it is `fresh`. The
/// tail stays, and growth restarts at zero.
pub fn replace(device: &Device, training: &mut TrainingModel, sources: &[u32], fresh: &[bool]) -> Result<()> {
    let mut rows = Rows::of(device, sources.to_vec(), training)?;
    let mut kinds: Vec<u32> = fresh.iter().map(|fresh| if *fresh { CLONE } else { KEPT }).collect();
    kinds.resize(rows.sources.len(), KEPT);
    rows.kinds = device.upload("kinds", &kinds)?;
    rows.gather(device, training)
}

/// Records the opacity reset, which limits every Gaussian's opacity to `opacity`.
pub fn reset_opacity(recording: &mut Recording, training: &TrainingModel, opacity: f64) {
    let TrainingModel { model, moments, .. } = training;
    let count = training.count();
    let kernel = ResetOpacity {
        count: &count.value,
        logits: &model.parameters.opacity_logits,
        logits_adam: &moments.opacity_logits,
        push: ResetOpacityPush { limit: (opacity / (1.0 - opacity)).ln() as f32 },
        spec: ResetOpacitySpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, count.groups(WORKGROUP));
}

/// Decisions of a density step for each Gaussian.
struct Choice {
    /// By Gaussian: the number of its successors, 0 if it is pruned.
    copies: Buffer<u32>,
    /// By Gaussian: 1 if it is split.
    splits: Buffer<u32>,
    /// By Gaussian: the first row of its successors.
    offsets: Buffer<u32>,
    /// Number of Gaussians after the step.
    after: usize,
}

impl Choice {
    /// Grows every Gaussian whose gradient reaches the schedule's threshold, or, if that makes too many, those with the largest
    /// gradients.
    fn new(device: &Device, training: &TrainingModel, schedule: &Schedule, step: Step) -> Result<Self> {
        let n = training.trained();
        let choice = Self {
            copies: device.buffer("copies", n)?,
            splits: device.buffer("splits", n)?,
            offsets: device.buffer("offsets", n)?,
            after: 0,
        };
        match schedule.growth {
            Some(plan) => choice.planned(device, training, schedule, step, plan),
            None => choice.unplanned(device, training, schedule, step),
        }
    }

    /// Grows every Gaussian whose gradient reaches the threshold, or a higher threshold under which the successors fit.
    fn unplanned(mut self, device: &Device, training: &TrainingModel, schedule: &Schedule, step: Step) -> Result<Self> {
        let n = training.trained();
        let mut threshold = if n < step.most { schedule.densify_gradient as f32 } else { f32::MAX };
        loop {
            let mut recording = Recording::new();
            self.decide(&mut recording, training, step.limits(schedule, threshold));
            self.count(device, training, recording)?;
            if self.after <= step.most.max(n) {
                return Ok(self);
            }
            // The threshold rises until the successors fit: at most 516 rounds from 1e-12.
            threshold = threshold.max(1e-12) * 1.25;
        }
    }

    /// Halves the number of Gaussians that the plan sets.
    fn planned(
        mut self,
        device: &Device,
        training: &TrainingModel,
        schedule: &Schedule,
        step: Step,
        plan: Growth,
    ) -> Result<Self> {
        let mut recording = Recording::new();
        self.decide(&mut recording, training, step.limits(schedule, f32::MAX));
        device.run(recording)?;
        let mut copies = self.copies.read(device)?;
        let stay = copies.iter().filter(|c| **c > 0).count();
        let count = schedule.planned(step.iteration).min(step.most).saturating_sub(stay);
        let (mut growth, key) = (training.growth.read(device)?, [step.seed, step.iteration]);
        growth.truncate(copies.len());
        let halved = plan.choose(&growth, count, key, |i| copies[i] > 0);
        copies.iter_mut().zip(&halved).for_each(|(c, halved)| *c += u32::from(*halved));
        self.copies.write(device, &copies)?;
        self.splits.write(device, &halved.iter().map(|halved| u32::from(*halved)).collect::<Vec<_>>())?;
        self.count(device, training, Recording::new())?;
        Ok(self)
    }

    fn decide(&self, recording: &mut Recording, training: &TrainingModel, push: DensifyPush) {
        let TrainingModel { model, growth, .. } = training;
        let count = training.count();
        let kernel = Densify {
            count: &count.value,
            growth,
            means: &model.parameters.means,
            log_scales: &model.parameters.log_scales,
            rotations: &model.quaternions(),
            logits: &model.parameters.opacity_logits,
            copies: &self.copies,
            splits: &self.splits,
            push,
            spec: DensifySpec { workgroup: WORKGROUP },
        };
        recording.dispatch(&kernel, count.groups(WORKGROUP));
    }

    /// Finds each Gaussian's first successor, and the number of successors.
    fn count(&mut self, device: &Device, training: &TrainingModel, mut recording: Recording) -> Result<()> {
        let count = training.count();
        let total = Count::new(device, "new Gaussians", u32::MAX, &[])?;
        let scan = Scan::new(device, training.trained() as u32)?;
        scan.record(&mut recording, count, (&self.copies).into(), &self.offsets, Some(&total));
        device.run(recording)?;
        self.after = total.value.read(device)?[0] as usize;
        Ok(())
    }
}

impl Step {
    /// Limits that the kernel compares with; a Gaussian grows if its gradient reaches `threshold`.
    fn limits(&self, schedule: &Schedule, threshold: f32) -> DensifyPush {
        let [x, y, z] = self.cameras;
        let prunes_large = schedule.prunes_large(self.iteration);
        DensifyPush {
            threshold,
            cameras: [x, y, z, self.extent as f32],
            split_scale: schedule.clone_scale.ln() as f32,
            largest_scale: if prunes_large { schedule.prune_scale.ln() as f32 } else { f32::MAX },
            least_logit: (schedule.prune_opacity / (1.0 - schedule.prune_opacity)).ln() as f32,
        }
    }
}

/// Origin of the new model's rows: the row of the old model, and whether it is kept, a clone or half of a split.
struct Rows {
    sources: Buffer<u32>,
    kinds: Buffer<u32>,
}

impl Rows {
    /// Room for the rows of `after` Gaussians, still to be filled, and the tail's.
    fn room(device: &Device, after: usize, old: &TrainingModel) -> Result<Self> {
        if old.tail() > 0 {
            return Self::of(device, vec![0; after], old);
        }
        Ok(Self { sources: device.buffer("sources", after)?, kinds: device.buffer("kinds", after)? })
    }

    /// These rows of the old model, all kept, and the tail's.
    fn of(device: &Device, mut sources: Vec<u32>, old: &TrainingModel) -> Result<Self> {
        sources.extend(old.trained() as u32..old.model.len as u32);
        let kinds = device.buffer("kinds", sources.len())?;
        let mut recording = Recording::new();
        recording.fill(&kinds, 0);
        device.run(recording)?;
        Ok(Self { sources: device.upload("sources", &sources)?, kinds })
    }

    /// Gathers the new model's rows from the old one's, a method's arrays included. Moments of new Gaussians are zero, and
    /// so is growth. Each array replaces the old one before the next is made.
    fn gather(&self, device: &Device, training: &mut TrainingModel) -> Result<()> {
        let (degree, n) = (training.model.degree, self.sources.len());
        let trained = n - training.tail();
        let widths = Attributes::widths(degree);
        let moved = training.bytes_of_arrays(n, trained);
        device.check_memory("Gaussians after density control", moved)?;
        training.growth = device.buffer("growth", 0)?;
        training.mean = None;
        let all = Resident::count_of(device, n)?;
        let tail = Tail::new(device, n, training.tail())?;
        let trained_count = tail.as_ref().map_or(&all, |tail| &tail.before);
        let gathered = |count: &Count, source: &Buffer<f32>, [rows, width]: [usize; 2], fresh: bool| {
            let target = device.buffer(source.name(), rows * width)?;
            let kernel = GatherRows {
                count: &count.value,
                sources: &self.sources,
                kinds: &self.kinds,
                source,
                target: &target,
                spec: GatherRowsSpec { workgroup: WORKGROUP, width: width as u32, fresh },
            };
            let mut recording = Recording::new();
            recording.dispatch(&kernel, count.groups(WORKGROUP));
            device.run(recording)?;
            Result::Ok(target)
        };
        for (width, moments) in widths.zip(training.moments.each_mut()).up_to(degree) {
            *moments = gathered(trained_count, &moments.cast(), [trained, 2 * width], true)?.cast();
        }
        for (width, parameters) in widths.zip(training.model.parameters.each_mut()).up_to(degree) {
            *parameters = gathered(&all, parameters, [n, width], false)?;
        }
        for Array { kind, values } in &mut training.arrays {
            *values = gathered(trained_count, values, [trained, kind.width], kind.restarts)?;
        }
        training.growth = device.zeros("growth", n)?;
        (training.model.count, training.model.len, training.tail) = (all, n, tail);
        Ok(())
    }
}
