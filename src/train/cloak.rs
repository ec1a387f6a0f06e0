//! Learnt masks on the device: which Gaussians a picture shows, gradients by the masks, and a step of Adam for their scores.

use super::learnt_masks::{LearntMasks, Method};
use super::options::Options;
use super::trainee::Trainee;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use crate::kernels::train::{
    Cloak, CloakPush, CloakSlope, CloakSlopeSpec, CloakSpec, CloakStep, CloakStepPush, CloakStepSpec,
};
use crate::primitives::WORKGROUP;
use crate::render::Renderer;
use crate::scene::camera::Camera;

/// The profiler's scope.
pub const STAGE: &str = "cloak";

/// Masks of the Gaussians that are trained.
pub struct Masks {
    /// By Gaussian: its score.
    pub scores: Buffer<f32>,
    /// Their first and second moments.
    pub moments: Buffer<[f32; 2]>,
    /// The number of Gaussians that the picture recorded last does not mask.
    pub shown: Buffer<u32>,
}

impl Masks {
    /// Bytes of the masks of `n` Gaussians.
    pub fn bytes(n: usize) -> u64 {
        Buffer::<f32>::bytes_of(n) + Buffer::<[f32; 2]>::bytes_of(n) + Buffer::<u32>::bytes_of(1)
    }

    /// Masks of `n` Gaussians; their content is undefined.
    ///
    /// # Errors
    /// Device memory.
    pub fn room(device: &Device, n: usize) -> Result<Self> {
        Ok(Self {
            scores: device.buffer("mask scores", n)?,
            moments: device.buffer("mask scores.moments", n)?,
            shown: device.buffer("shown", 1)?,
        })
    }

    /// Given scores, and their moments, first and second interleaved.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn with(device: &Device, scores: &[f32], moments: &[f32]) -> Result<Self> {
        Ok(Self {
            scores: device.upload("mask scores", scores)?,
            moments: device.upload("mask scores.moments", moments)?.cast(),
            shown: device.upload("shown", &[0])?,
        })
    }

    /// Masks before the first iteration.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn new(device: &Device, n: usize, method: Method) -> Result<Self> {
        Self::with(device, &vec![method.first_score(); n], &vec![0.0; 2 * n])
    }
}

/// A picture whose Gaussians have masks.
#[derive(Clone, Copy)]
pub struct Cloaked<'a> {
    /// The renderer that draws it.
    pub renderer: &'a Renderer,
    /// Its camera.
    pub camera: &'a Camera,
    /// The model.
    pub trainee: &'a Trainee,
    /// Its masks.
    pub masks: &'a Masks,
    /// How they are learnt.
    pub settings: &'a LearntMasks,
    /// The run's seed and the iteration (the first is 1): the key of random masks, and the number of Adam's step.
    pub key: [u32; 2],
}

impl<'a> Cloaked<'a> {
    /// The picture of an iteration, if its model has masks.
    pub(super) fn of(
        renderer: &'a Renderer,
        trainee: &'a Trainee,
        options: &'a Options,
        camera: &'a Camera,
        iteration: u32,
    ) -> Option<Self> {
        let (masks, settings) = (trainee.masks.as_ref()?, options.schedule.learnt_masks.as_ref()?);
        Some(Self { renderer, camera, trainee, masks, settings, key: [options.seed, iteration] })
    }

    /// Records that masked Gaussians are hidden: between [`Renderer::record_lists`] and [`Renderer::record_blending`].
    pub fn hide(&self, recording: &mut Recording) {
        let (slots, [seed, iteration]) = (self.renderer.slots(self.camera), self.key);
        let kernel = Cloak {
            pairs: slots.pairs,
            count: &self.trainee.count().value,
            scores: &self.masks.scores,
            tile_counts: slots.tile_counts,
            shape: slots.shape,
            shown: &self.masks.shown,
            push: CloakPush { pair_limit: slots.limit, seed, iteration },
            spec: CloakSpec { workgroup: WORKGROUP, sampled: self.settings.method.samples() },
        };
        recording.scope(STAGE, |r| {
            r.fill(&self.masks.shown, 0);
            r.dispatch(&kernel, self.trainee.count().groups(WORKGROUP));
        });
    }

    /// Records the gradients by the masks into the slots' sums by blue, which the backward pass no longer needs then. `colours`
    /// says that the fourth component of the gradient by the picture is none.
    pub fn slopes(&self, recording: &mut Recording, by_image: &Buffer<[f32; 4]>, colours: bool) {
        let slots = self.renderer.slots(self.camera);
        let subgroup = self.renderer.device().info().subgroup_size;
        let kernel = CloakSlope {
            view: slots.view,
            starts: slots.starts,
            slots: slots.sorted,
            owners: slots.owners,
            geometry: slots.geometry,
            shape: slots.shape,
            colour: slots.colour,
            image: self.renderer.image(),
            image_gradient: by_image,
            sums: &slots.sums.blue,
            spec: CloakSlopeSpec {
                workgroup: subgroup,
                tile: slots.tile,
                stride: slots.stride,
                pixels: slots.tile * slots.tile / subgroup,
                stop: slots.stop,
                colours,
            },
        };
        recording.scope(STAGE, |r| r.dispatch(&kernel, Groups::Count(slots.tiles)));
    }

    /// Records the step of the masks, between the backward pass and the parameters' step of Adam; as for [`Cloaked::slopes`].
    pub(super) fn learn(&self, recording: &mut Recording, by_image: &Buffer<[f32; 4]>, colours: bool) {
        if self.settings.method.samples() {
            self.slopes(recording, by_image, colours);
        }
        self.step(recording);
    }

    /// Records a step of Adam for the scores, from the rows of gradients or from [`Cloaked::slopes`], while the parameters are those
    /// that the picture was drawn with. A Gaussian with a gradient that is not finite keeps its score.
    pub fn step(&self, recording: &mut Recording) {
        let (slots, [seed, iteration]) = (self.renderer.slots(self.camera), self.key);
        let left = |beta: f64| 1.0 - beta.powf(f64::from(iteration));
        let kernel = CloakStep {
            pairs: slots.pairs,
            count: &self.trainee.count().value,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            sums: &slots.sums.blue,
            rows: self.renderer.gradient_rows().values,
            logits: &self.trainee.model.parameters.opacity_logits,
            shown: &self.masks.shown,
            scores: &self.masks.scores,
            moments: &self.masks.moments,
            push: CloakStepPush {
                correction: [(1.0 / left(BETA1)) as f32, (1.0 / left(BETA2).sqrt()) as f32],
                rate: self.settings.step_rate() as f32,
                weight: self.settings.weight as f32,
                pair_limit: slots.limit,
                seed,
                iteration,
            },
            spec: CloakStepSpec { workgroup: WORKGROUP, sampled: self.settings.method.samples() },
        };
        recording.scope(STAGE, |r| r.dispatch(&kernel, self.trainee.count().groups(WORKGROUP)));
    }
}
