//! Density control on the device: clone, split, prune, and the opacity reset.

use super::adam::AdamState;
use super::schedule::Schedule;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::train::{
    Densify, DensifyPush, DensifySpec, GatherRows, GatherRowsSpec, ResetOpacity, ResetOpacityPush, ResetOpacitySpec,
    Sources, SourcesSpec, Split, SplitPush, SplitSpec,
};
use crate::primitives::{Count, Scan, WORKGROUP};

/// What one density step decides by.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The iteration it follows: key of its random numbers.
    pub iteration: u32,
    /// Seed of the run.
    pub seed: u32,
    /// The scene's extent in world units.
    pub extent: f64,
    /// Mean of the cameras' centres.
    pub cameras: [f32; 3],
    /// No more Gaussians than this.
    pub most: usize,
}

/// Bytes that [`densify`] takes beside a model of `n` Gaussians that it makes `after` of.
pub fn bytes(device: &Device, n: usize, after: usize, degree: usize) -> u64 {
    let words = Buffer::<u32>::bytes_of;
    let choice = 3 * words(n) + words(1) + Scan::bytes(device, n as u32) + 2 * words(after);
    choice + Resident::bytes(after, degree) + AdamState::bytes(after, degree) + Buffer::<[f32; 2]>::bytes_of(after)
}

/// Replaces model and moments by their grown and pruned successors. Returns how many Gaussians there are now.
///
/// # Errors
/// Device memory; device errors. Model and moments are then as they were.
pub fn densify(
    device: &Device,
    model: &mut Resident,
    state: &mut AdamState,
    growth: &mut Buffer<[f32; 2]>,
    schedule: &Schedule,
    step: Step,
) -> Result<usize> {
    let n = model.len;
    let (copies, splits) = (device.buffer("copies", n)?, device.buffer("splits", n)?);
    let offsets = device.buffer("offsets", n)?;
    let total = device.buffer::<u32>("new Gaussians", 1)?;
    let scan = Scan::new(device, n as u32)?;
    let mut threshold = if n < step.most { schedule.densify_gradient as f32 } else { f32::MAX };
    let after = loop {
        let mut recording = Recording::new();
        let [x, y, z] = step.cameras;
        let kernel = Densify {
            count: &model.count.value,
            growth,
            means: &model.means,
            log_scales: &model.log_scales,
            rotations: &model.rotations,
            logits: &model.opacity_logits,
            copies: &copies,
            splits: &splits,
            push: DensifyPush {
                threshold,
                cameras: [x, y, z, step.extent as f32],
                split_scale: schedule.clone_scale.ln() as f32,
                largest_scale: if schedule.prunes_large(step.iteration) {
                    schedule.prune_scale.ln() as f32
                } else {
                    f32::MAX
                },
                least_logit: (schedule.prune_opacity / (1.0 - schedule.prune_opacity)).ln() as f32,
            },
            spec: DensifySpec { workgroup: WORKGROUP },
        };
        recording.dispatch(&kernel, model.count.groups(WORKGROUP));
        scan.record(&mut recording, &model.count, &copies, &offsets, Some(&total));
        device.run(recording)?;
        let after = total.read(device)?[0] as usize;
        if after <= step.most.max(n) {
            break after;
        }
        // Fewer grow until they fit: those with the largest gradients stay. From 1e-12 that takes 516 rounds at most.
        threshold = threshold.max(1e-12) * 1.25;
    };
    let (sources, kinds) = (device.buffer("sources", after)?, device.buffer("kinds", after)?);
    let mut recording = Recording::new();
    let kernel = Sources {
        count: &model.count.value,
        copies: &copies,
        splits: &splits,
        offsets: &offsets,
        sources: &sources,
        kinds: &kinds,
        spec: SourcesSpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));

    let (successor, new_state) = gathered(device, &mut recording, (model, state), &sources, &kinds)?;
    let kernel = Split {
        count: &successor.count.value,
        kinds: &kinds,
        rotations: &successor.rotations,
        means: &successor.means,
        log_scales: &successor.log_scales,
        push: SplitPush { seed: step.seed, iteration: step.iteration },
        spec: SplitSpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, successor.count.groups(WORKGROUP));
    let fresh = device.buffer("growth", after)?;
    recording.fill(&fresh, 0);
    device.run(recording)?;
    *model = successor;
    *state = new_state;
    *growth = fresh;
    Ok(after)
}

/// Keeps only the Gaussians `kept`, in that order, with their moments; sums of growth begin anew.
///
/// # Errors
/// Device memory; device errors. Model and moments are then as they were.
pub fn compact(
    device: &Device,
    model: &mut Resident,
    state: &mut AdamState,
    growth: &mut Buffer<[f32; 2]>,
    kept: &[u32],
) -> Result<()> {
    let sources = device.upload("sources", kept)?;
    let (kinds, fresh) = (device.buffer("kinds", kept.len())?, device.buffer("growth", kept.len())?);
    let mut recording = Recording::new();
    recording.fill(&kinds, 0);
    recording.fill(&fresh, 0);
    let (successor, new_state) = gathered(device, &mut recording, (model, state), &sources, &kinds)?;
    device.run(recording)?;
    *model = successor;
    *state = new_state;
    *growth = fresh;
    Ok(())
}

/// Records how model and moments come from the rows `sources` of the old ones, as many as there are.
fn gathered(
    device: &Device,
    recording: &mut Recording,
    (model, state): (&Resident, &AdamState),
    sources: &Buffer<u32>,
    kinds: &Buffer<u32>,
) -> Result<(Resident, AdamState)> {
    let after = sources.len();
    let count = Count::known(device, "Gaussians", after as u32, &[Scan::block(device)])?;
    let mut rows = Rows { device, recording, count: &count, sources, kinds, after };
    let ([means, log_scales, rotations, opacity_logits], sh) = rows.parameters(model)?;
    let state = rows.moments(model.degree, state)?;
    let rotations = rotations.cast();
    let degree = model.degree;
    Ok((Resident { count, means, log_scales, rotations, opacity_logits, sh, degree, half: false, len: after }, state))
}

/// Records the opacity reset: no Gaussian keeps more than `opacity`.
pub fn reset_opacity(recording: &mut Recording, model: &Resident, state: &AdamState, opacity: f64) {
    let kernel = ResetOpacity {
        count: &model.count.value,
        logits: &model.opacity_logits,
        logits_adam: &state.opacity_logits,
        push: ResetOpacityPush { limit: (opacity / (1.0 - opacity)).ln() as f32 },
        spec: ResetOpacitySpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}

type Bands<T> = [Buffer<T>; MAX_SH_DEGREE + 1];

/// Gathers attribute rows of the old model into arrays of the new one.
struct Rows<'a> {
    device: &'a Device,
    recording: &'a mut Recording,
    count: &'a Count,
    sources: &'a Buffer<u32>,
    kinds: &'a Buffer<u32>,
    after: usize,
}

impl Rows<'_> {
    fn gather(&mut self, name: &str, source: &Buffer<f32>, width: usize, fresh: bool) -> Result<Buffer<f32>> {
        let target = self.device.buffer(name, self.after * width)?;
        let kernel = GatherRows {
            count: &self.count.value,
            sources: self.sources,
            kinds: self.kinds,
            source,
            target: &target,
            spec: GatherRowsSpec { workgroup: WORKGROUP, width: width as u32, fresh },
        };
        self.recording.dispatch(&kernel, self.count.groups(WORKGROUP));
        Ok(target)
    }

    fn parameters(&mut self, model: &Resident) -> Result<([Buffer<f32>; 4], Bands<f32>)> {
        let main = [
            self.gather("means", &model.means, 3, false)?,
            self.gather("log scales", &model.log_scales, 3, false)?,
            self.gather("rotations", &model.rotations.cast(), 4, false)?,
            self.gather("opacity logits", &model.opacity_logits, 1, false)?,
        ];
        let mut band = |l: usize| -> Result<Buffer<f32>> {
            if l > model.degree {
                return Ok(model.sh[l].clone());
            }
            self.gather(["sh0", "sh1", "sh2", "sh3"][l], &model.sh[l], Gaussians::band_width(l), false)
        };
        Ok((main, [band(0)?, band(1)?, band(2)?, band(3)?]))
    }

    fn moments(&mut self, degree: usize, state: &AdamState) -> Result<AdamState> {
        let mut pairs = |name: &str, source: &Buffer<[f32; 2]>, width: usize| -> Result<Buffer<[f32; 2]>> {
            Ok(self.gather(name, &source.cast(), 2 * width, true)?.cast())
        };
        let mut band = |l: usize| -> Result<Buffer<[f32; 2]>> {
            if l > degree {
                return Ok(state.sh[l].clone());
            }
            let name = ["sh0's moments", "sh1's moments", "sh2's moments", "sh3's moments"][l];
            pairs(name, &state.sh[l], Gaussians::band_width(l))
        };
        let sh = [band(0)?, band(1)?, band(2)?, band(3)?];
        Ok(AdamState {
            means: pairs("means' moments", &state.means, 3)?,
            log_scales: pairs("log scales' moments", &state.log_scales, 3)?,
            rotations: pairs("rotations' moments", &state.rotations, 4)?,
            opacity_logits: pairs("opacity logits' moments", &state.opacity_logits, 1)?,
            sh,
        })
    }
}
