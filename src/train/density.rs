//! Density control on the device: clone, split, prune, and the opacity reset.

use super::growth::Growth;
use super::schedule::Schedule;
use super::training_model::{Array, TrainingModel};
use crate::gaussians::Attributes;
use crate::gpu::{Buffer, Device, Feed, Recording, Result};
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
    // Copies, splits and offsets; sources and kinds; and what the host sends a second time: copies and splits, and sources
    // where there is a tail.
    let choice = 5 * words(n) + Count::bytes() + scan + 3 * words(after);
    choice + words(2 * n.max(after) * Attributes::widest(degree))
}

/// Clones, splits and prunes the Gaussians of a model in training, without its tail. Returns their new number.
///
/// The host waits twice: for what the choice depends on, and for the step. An unplanned step waits for each threshold
/// that it tries; new arrays may need further waits.
///
/// # Errors
/// Device memory: the model is then unchanged. Device errors: the model is then lost.
pub fn densify(device: &Device, training: &mut TrainingModel, schedule: &Schedule, step: Step) -> Result<usize> {
    let (choice, mut recording) = Choice::new(device, training, schedule, step)?;
    let after = choice.after;
    let rows = Rows::room(device, &mut recording, after, training)?;
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
    let planned = schedule.growth.and_then(|plan| plan.gaussians).unwrap_or(0).min(step.most).max(after);
    let room = Room::of(device, training, &rows, planned + training.tail())?;
    rows.gather(device, &mut recording, training, &room)?;
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
    recording.dispatch(&kernel, count.groups(WORKGROUP));
    device.run(recording)?;
    Ok(after)
}

/// Keeps only the Gaussians `kept`, in that order, with their moments, and the tail; growth restarts at zero.
pub fn compact(device: &Device, training: &mut TrainingModel, kept: &[u32]) -> Result<()> {
    let mut recording = Recording::new();
    let rows = Rows::of(device, &mut recording, kept.to_vec(), training)?;
    let room = Room::new(device, training, rows.sources.len())?;
    rows.gather(device, &mut recording, training, &room)?;
    device.run(recording)?;
    Ok(())
}

/// Like [`compact`], but the arrays keep their memory, and the host waits once. It needs [`bytes_of_thinning`].
pub fn thin(device: &Device, training: &mut TrainingModel, kept: &[u32]) -> Result<()> {
    let mut recording = Recording::new();
    let rows = Rows::of(device, &mut recording, kept.to_vec(), training)?;
    let room = Room::through(device, training, &rows)?;
    rows.gather(device, &mut recording, training, &room)?;
    device.run(recording)?;
    Ok(())
}

/// Bytes that [`thin`] needs besides the model to keep `kept` Gaussians: kinds, sources, which exist a second time on
/// their way to the device, and the gathered rows.
pub fn bytes_of_thinning(training: &TrainingModel, kept: usize) -> u64 {
    let rows = kept + training.tail();
    3 * Buffer::<u32>::bytes_of(rows) + Buffer::<f32>::bytes_of(rows * training.widest_row())
}

/// Replaces every trained row by the one in `sources`, with its moments, or with zero moments if it is `fresh`. The
/// tail stays, and growth restarts at zero.
pub fn replace(device: &Device, training: &mut TrainingModel, sources: &[u32], fresh: &[bool]) -> Result<()> {
    let mut recording = Recording::new();
    let rows = Rows::of(device, &mut recording, sources.to_vec(), training)?;
    let mut kinds: Vec<u32> = fresh.iter().map(|fresh| if *fresh { CLONE } else { KEPT }).collect();
    kinds.resize(rows.sources.len(), KEPT);
    send(device, &mut recording, &kinds, &rows.kinds)?;
    let room = Room::of(device, training, &rows, rows.sources.len())?;
    rows.gather(device, &mut recording, training, &room)?;
    device.run(recording)?;
    Ok(())
}

/// Records the sending of words to a buffer, from host memory that is freed with the recording.
fn send(device: &Device, recording: &mut Recording, words: &[u32], to: &Buffer<u32>) -> Result<()> {
    Feed::new(device, to.name(), words.len(), 1)?.record(recording, words, to)
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
    scan: Scan,
    /// Number of Gaussians after the step, on the device.
    total: Count,
    /// The same number.
    after: usize,
}

impl Choice {
    /// Grows every Gaussian whose gradient reaches the schedule's threshold, or, if that makes too many, those with the
    /// largest gradients. The recording holds what remains to be done for it, and is to be continued.
    fn new(device: &Device, training: &TrainingModel, schedule: &Schedule, step: Step) -> Result<(Self, Recording)> {
        let n = training.trained();
        let choice = Self {
            copies: device.buffer("copies", n)?,
            splits: device.buffer("splits", n)?,
            offsets: device.buffer("offsets", n)?,
            scan: Scan::new(device, n as u32)?,
            total: Count::unset(device, "new Gaussians", u32::MAX, &[])?,
            after: 0,
        };
        match schedule.growth {
            Some(plan) => choice.planned(device, training, schedule, step, plan),
            None => Ok((choice.unplanned(device, training, schedule, step)?, Recording::new())),
        }
    }

    /// Grows every Gaussian whose gradient reaches the threshold, or a higher threshold under which the successors fit.
    fn unplanned(mut self, device: &Device, training: &TrainingModel, schedule: &Schedule, step: Step) -> Result<Self> {
        let n = training.trained();
        let mut threshold = if n < step.most { schedule.densify_gradient as f32 } else { f32::MAX };
        let mut answer = device.readback("new Gaussians", 1)?;
        loop {
            let mut recording = Recording::new();
            self.decide(&mut recording, training, step.limits(schedule, threshold));
            self.count(&mut recording, training);
            answer.submit(device, recording, &[(&self.total.value, 1)])?;
            self.after = answer.wait()?.0[0] as usize;
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
    ) -> Result<(Self, Recording)> {
        let n = training.trained();
        let mut recording = Recording::new();
        self.decide(&mut recording, training, step.limits(schedule, f32::MAX));
        let mut answer = device.readback("copies and growth", 3 * n)?;
        answer.submit(device, recording, &[(&self.copies, n), (&training.growth.cast(), 2 * n)])?;
        let (copies, growth) = answer.wait()?.0.split_at(n);
        let mut copies: Vec<u32> = copies.to_vec();
        let stay = copies.iter().filter(|c| **c > 0).count();
        let count = schedule.planned(step.iteration).min(step.most).saturating_sub(stay);
        let key = [step.seed, step.iteration];
        let halved = plan.choose(bytemuck::cast_slice(growth), count, key, |i| copies[i] > 0);
        drop(answer); // the rows need its memory
        copies.iter_mut().zip(&halved).for_each(|(c, halved)| *c += u32::from(*halved));
        let splits: Vec<u32> = halved.iter().map(|halved| u32::from(*halved)).collect();
        self.after = copies.iter().map(|c| *c as usize).sum();
        let mut recording = Recording::new();
        send(device, &mut recording, &copies, &self.copies)?;
        send(device, &mut recording, &splits, &self.splits)?;
        self.count(&mut recording, training);
        Ok((self, recording))
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

    /// Records the search for each Gaussian's first successor, and the number of successors.
    fn count(&self, recording: &mut Recording, training: &TrainingModel) {
        self.total.reset(recording);
        self.scan.record(recording, training.count(), (&self.copies).into(), &self.offsets, &self.total);
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
    /// Room for the rows of `after` Gaussians, still to be filled, and the tail's, which are recorded.
    fn room(device: &Device, recording: &mut Recording, after: usize, old: &TrainingModel) -> Result<Self> {
        if old.tail() > 0 {
            return Self::of(device, recording, vec![0; after], old);
        }
        Ok(Self { sources: device.buffer("sources", after)?, kinds: device.buffer("kinds", after)? })
    }

    /// Records these rows of the old model, all kept, and the tail's.
    fn of(device: &Device, recording: &mut Recording, mut sources: Vec<u32>, old: &TrainingModel) -> Result<Self> {
        sources.extend(old.trained() as u32..old.model.len as u32);
        let len = sources.len();
        let rows = Self { sources: device.buffer("sources", len)?, kinds: device.buffer("kinds", len)? };
        send(device, recording, &sources, &rows.sources)?;
        recording.fill(&rows.kinds, 0);
        Ok(rows)
    }

    /// Records the gathering of the new model's rows from the old one's, a method's arrays included. Where new arrays need
    /// the memory of old ones, what is recorded runs first. Moments of new Gaussians are zero, and so is growth.
    fn gather(
        &self,
        device: &Device,
        recording: &mut Recording,
        training: &mut TrainingModel,
        room: &Room,
    ) -> Result<()> {
        let (degree, n, tail) = (training.model.degree, self.sources.len(), training.tail());
        let widths = Attributes::widths(degree);
        training.set_len(recording, n);
        training.mean = None;
        training.growth = match room {
            Room::New(most) => device.buffer("growth", *most)?.of_len(n),
            Room::Through(_) => training.growth.of_len(n),
        };
        recording.fill(&training.growth, 0);
        let most_used = match room {
            Room::New(most) => device.memory_used().0 + training.bytes_of_arrays(*most),
            Room::Through(_) => u64::MAX,
        };
        let TrainingModel { model, moments, arrays, tail: end, .. } = training;
        let all = (&model.count, 0);
        let trained = end.as_ref().map_or(all, |end| (&end.before, tail));
        let mut gathered = |source: &Buffer<f32>, (count, less): (&Count, usize), width: usize, fresh: bool| {
            let len = (n - less) * width;
            let target = match room {
                Room::New(most) => {
                    let floats = (most - less) * width;
                    if device.memory_used().0 + Buffer::<f32>::bytes_of(floats) > most_used {
                        device.run(mem::take(recording))?;
                    }
                    device.buffer(source.name(), floats)?.of_len(len)
                }
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
        Ok(())
    }
}

/// Memory for the arrays of a model whose rows change.
enum Room {
    /// New buffers with room for this many rows. They take no more memory than if each replaced the old one before the
    /// next is made, but the host waits, and old ones go, only where they would.
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
