//! Density control on the device: clone, split, prune, and the opacity reset.

use super::growth::Growth;
use super::schedule::Schedule;
use super::training_model::{Array, TrainingModel};
use crate::gaussians::Attributes;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::constants::density::{CLONE, KEPT};
use crate::kernels::train::{
    Densify, DensifyPush, DensifySpec, GatherRows, GatherRowsSpec, ResetOpacity, ResetOpacityPush, ResetOpacitySpec,
    Sources, SourcesSpec, Split, SplitPush, SplitSpec,
};
use crate::primitives::{Count, Scan, WORKGROUP};
use std::mem;

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
/// replaced one by one, so the widest, moments of an attribute, exists twice.
pub fn bytes(device: &Device, n: usize, after: usize, degree: usize) -> u64 {
    let words = Buffer::<u32>::bytes_of;
    let scan = device.bytes_of(|counts| Scan::new(counts, n as u32));
    let choice = 3 * words(n) + Count::bytes() + scan + 2 * words(after);
    choice + words(2 * n.max(after) * Attributes::widest(degree))
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
    let planned = schedule.growth.and_then(|plan| plan.gaussians).unwrap_or(0).min(step.most).max(after);
    rows.gather(device, training, &Room::of(device, training, &rows, planned + training.tail())?)?;
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
    let rows = Rows::of(device, kept.to_vec(), training)?;
    rows.gather(device, training, &Room::new(device, training, rows.sources.len())?)
}

/// Like [`compact`], but the arrays keep their memory. It needs [`bytes_of_thinning`].
pub fn thin(device: &Device, training: &mut TrainingModel, kept: &[u32]) -> Result<()> {
    let rows = Rows::of(device, kept.to_vec(), training)?;
    rows.gather(device, training, &Room::through(device, training, &rows)?)
}

/// Bytes that [`thin`] needs besides the model to keep `kept` Gaussians.
pub fn bytes_of_thinning(training: &TrainingModel, kept: usize) -> u64 {
    let rows = kept + training.tail();
    2 * Buffer::<u32>::bytes_of(rows) + Buffer::<f32>::bytes_of(rows * training.widest_row())
}

/// Replaces every trained row by the one in `sources`, with its moments, or with zero moments if it is `fresh`. The
/// tail stays, and growth restarts at zero.
pub fn replace(device: &Device, training: &mut TrainingModel, sources: &[u32], fresh: &[bool]) -> Result<()> {
    let mut rows = Rows::of(device, sources.to_vec(), training)?;
    let mut kinds: Vec<u32> = fresh.iter().map(|fresh| if *fresh { CLONE } else { KEPT }).collect();
    kinds.resize(rows.sources.len(), KEPT);
    rows.kinds = device.upload("kinds", &kinds)?;
    rows.gather(device, training, &Room::of(device, training, &rows, rows.sources.len())?)
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
        scan.record(&mut recording, count, (&self.copies).into(), &self.offsets, &total);
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
    /// so is growth.
    fn gather(&self, device: &Device, training: &mut TrainingModel, room: &Room) -> Result<()> {
        let (degree, n, tail) = (training.model.degree, self.sources.len(), training.tail());
        let widths = Attributes::widths(degree);
        let mut recording = Recording::new();
        training.set_len(&mut recording, n);
        training.mean = None;
        training.growth = match room {
            Room::New(most) => device.buffer("growth", *most)?.of_len(n),
            Room::Through(_) => training.growth.of_len(n),
        };
        recording.fill(&training.growth, 0);
        let TrainingModel { model, moments, arrays, tail: end, .. } = training;
        let all = (&model.count, 0);
        let trained = end.as_ref().map_or(all, |end| (&end.before, tail));
        let mut gathered = |source: &Buffer<f32>, (count, less): (&Count, usize), width: usize, fresh: bool| {
            let len = (n - less) * width;
            let target = match room {
                Room::New(most) => device.buffer(source.name(), (most - less) * width)?.of_len(len),
                Room::Through(scratch) => scratch.of_len(len),
            };
            let kernel = GatherRows {
                count: &count.value,
                sources: &self.sources,
                kinds: &self.kinds,
                source,
                target: &target,
                spec: GatherRowsSpec { workgroup: WORKGROUP, width: width as u32, fresh },
            };
            recording.dispatch(&kernel, count.groups(WORKGROUP));
            if let Room::New(_) = room {
                device.run(mem::take(&mut recording))?;
                return Ok(target);
            }
            let old = source.of_len(len);
            recording.copy(&target, &old, len);
            Result::Ok(old)
        };
        for (width, moments) in widths.zip(moments.each_mut()).up_to(degree) {
            *moments = gathered(&moments.cast(), trained, 2 * width, true)?.cast();
        }
        for (width, parameters) in widths.zip(model.parameters.each_mut()).up_to(degree) {
            *parameters = gathered(parameters, all, width, false)?;
        }
        for Array { kind, values } in arrays {
            *values = gathered(values, trained, kind.width, kind.restarts)?;
        }
        device.run(recording)?;
        Ok(())
    }
}

/// Memory for the arrays of a model whose rows change.
enum Room {
    /// New buffers with room for this many rows; each replaces the old one before the next is made.
    New(usize),
    /// Memory of the old buffers, which the rows reach through this one.
    Through(Buffer<f32>),
}

impl Room {
    /// The old buffers' memory if it suffices for these rows, otherwise new buffers for `most` rows.
    fn of(device: &Device, training: &TrainingModel, rows: &Rows, most: usize) -> Result<Self> {
        if training.room() < rows.sources.len() {
            return Self::new(device, training, most);
        }
        Self::through(device, training, rows)
    }

    fn new(device: &Device, training: &TrainingModel, most: usize) -> Result<Self> {
        device.check_memory("Gaussians after density control", training.bytes_of_arrays(most))?;
        Ok(Self::New(most))
    }

    fn through(device: &Device, training: &TrainingModel, rows: &Rows) -> Result<Self> {
        Ok(Self::Through(device.buffer("gathered rows", rows.sources.len() * training.widest_row())?))
    }
}
