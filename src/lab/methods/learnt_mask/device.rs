//! Learnt masks on the device: hiding masked Gaussians, gradients by the masks, and a step of Adam for their scores.

use super::{LearntMasks, MaskMethod, NAME, greatest};
use crate::gpu::{Buffer, Device, Groups, Recording};
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use crate::kernels::lab::{
    LearntMask as Kernel, LearntMaskAdam as Adam, LearntMaskAdamPush as AdamPush, LearntMaskAdamSpec as AdamSpec,
    LearntMaskGradient as Gradient, LearntMaskGradientSpec as GradientSpec, LearntMaskPush as Push,
    LearntMaskSpec as Spec,
};
use crate::primitives::WORKGROUP;
use crate::train::density::compact;
use crate::train::method::{Changed, Cut, Iteration, Method, Pause};
use crate::train::schedule::Schedule;
use crate::train::{ArrayKind, Result};

/// Names of the masks' scores, by method, and of their first and second moments.
const SCORES: &str = "mask scores";
const MOMENTS: &str = "mask scores.moments";
const ARRAYS: [[ArrayKind; 2]; 2] = {
    const fn of(method: MaskMethod) -> [ArrayKind; 2] {
        [
            ArrayKind { name: SCORES, width: 1, first: method.first_score(), restarts: false },
            ArrayKind { name: MOMENTS, width: 2, first: 0.0, restarts: true },
        ]
    }
    [of(MaskMethod::Compact3dgs), of(MaskMethod::MaskGaussian)]
};

/// A run's learnt masks.
pub struct LearntMask {
    /// Their settings.
    pub settings: LearntMasks,
    /// Number of Gaussians that the picture recorded last does not mask.
    pub shown: Buffer<u32>,
}

impl LearntMask {
    /// The arrays of a kind of masks: scores, then their moments.
    pub fn arrays(method: MaskMethod) -> &'static [ArrayKind; 2] {
        &ARRAYS[usize::from(method.samples())]
    }

    /// Masks with these settings.
    pub fn new(device: &Device, settings: LearntMasks) -> Result<Self> {
        Ok(Self { settings, shown: device.upload("shown", &[0])? })
    }

    /// Records the hiding of masked Gaussians, between [`crate::render::Renderer::record_lists`] and
    /// [`crate::render::Renderer::record_blending`].
    pub fn hide(&self, recording: &mut Recording, now: &Iteration<'_>) {
        let Iteration { renderer, camera, model, key: [seed, iteration], .. } = *now;
        let Some(scores) = model.array(SCORES) else { return };
        let slots = renderer.slots(camera);
        let kernel = Kernel {
            pairs: slots.pairs,
            count: &model.count().value,
            scores,
            tile_counts: slots.tile_counts,
            shape: slots.shape,
            shown: &self.shown,
            push: Push { pair_limit: slots.limit, seed, iteration },
            spec: Spec { workgroup: WORKGROUP, sampled: self.settings.method.samples() },
        };
        recording.scope(NAME, |r| {
            r.fill(&self.shown, 0);
            r.dispatch(&kernel, model.count().groups(WORKGROUP));
        });
    }

    /// Records the gradients by the masks into the slots' sums by blue, which the backward pass no longer needs by then.
    pub fn gradients(recording: &mut Recording, now: &Iteration<'_>) {
        let Iteration { renderer, camera, image_gradient, colours, .. } = *now;
        let (slots, subgroup) = (renderer.slots(camera), renderer.device().info().subgroup_size);
        let kernel = Gradient {
            view: slots.view,
            starts: slots.starts,
            slots: slots.sorted,
            owners: slots.owners,
            geometry: slots.geometry,
            shape: slots.shape,
            colour: slots.colour,
            image: renderer.image(),
            image_gradient,
            sums: &slots.sums.blue,
            spec: GradientSpec {
                workgroup: subgroup,
                tile: slots.tile,
                stride: slots.stride,
                pixels: slots.tile * slots.tile / subgroup,
                stop: slots.stop,
                colours,
            },
        };
        recording.scope(NAME, |r| r.dispatch(&kernel, Groups::Count(slots.tiles)));
    }

    /// Records a step of Adam for the scores, from the rows of gradients or from [`Self::gradients`], while the
    /// parameters are still those of the drawn picture. A Gaussian with a non-finite gradient keeps its score.
    pub fn step(&self, recording: &mut Recording, now: &Iteration<'_>) {
        let Iteration { renderer, camera, model, key: [seed, iteration], .. } = *now;
        let (Some(scores), Some(moments)) = (model.array(SCORES), model.array(MOMENTS)) else { return };
        let slots = renderer.slots(camera);
        let left = |beta: f64| 1.0 - beta.powf(f64::from(iteration));
        let kernel = Adam {
            pairs: slots.pairs,
            count: &model.count().value,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            sums: &slots.sums.blue,
            rows: renderer.gradient_rows().values,
            logits: &model.model.parameters.opacity_logits,
            shown: &self.shown,
            scores,
            moments: &moments.cast(),
            push: AdamPush {
                correction: [(1.0 / left(BETA1)) as f32, (1.0 / left(BETA2).sqrt()) as f32],
                rate: self.settings.step_rate() as f32,
                weight: self.settings.weight as f32,
                pair_limit: slots.limit,
                seed,
                iteration,
            },
            spec: AdamSpec { workgroup: WORKGROUP, sampled: self.settings.method.samples() },
        };
        recording.scope(NAME, |r| r.dispatch(&kernel, model.count().groups(WORKGROUP)));
    }
}

impl Method for LearntMask {
    fn name(&self) -> &'static str {
        NAME
    }

    fn arrays(&self) -> &'static [ArrayKind] {
        Self::arrays(self.settings.method)
    }

    fn acts(&self, schedule: &Schedule, iteration: u32) -> bool {
        self.settings.thins(schedule, iteration)
    }

    fn before_blending(&self, recording: &mut Recording, now: &Iteration<'_>) {
        self.hide(recording, now);
    }

    /// Records the step of the masks, while the parameters are still those of the drawn picture.
    fn before_adam(&self, recording: &mut Recording, now: &Iteration<'_>) {
        if self.settings.method.samples() {
            Self::gradients(recording, now);
        }
        self.step(recording, now);
    }

    /// Removes masked Gaussians, or cuts the model to the survivors and ends the masks.
    fn between(&self, pause: &mut Pause<'_>) -> Result<Changed> {
        let Pause { device, model, schedule, key, .. } = pause;
        let Some(scores) = model.array(SCORES) else { return Ok(Changed::default()) };
        let (scores, over, iteration) = (scores.read(device)?, self.settings.last(schedule) == key[1], key[1]);
        let stay = if over { greatest(&scores, self.settings.survivors) } else { self.settings.judge(&scores, *key) };
        let (before, shown) = (scores.len(), self.settings.shown(&scores));
        tracing::debug!("after iteration {iteration}: masks show {shown} of {before} Gaussians");
        let rows = stay.len() < before;
        if rows {
            compact(device, model, &stay)?;
        }
        let cut = over.then_some(Cut { iteration, before, shown, after: stay.len() });
        Ok(Changed { rows, cut })
    }
}
