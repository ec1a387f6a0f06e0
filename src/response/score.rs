//! Scores of each Gaussian over a set of views: its contribution to the pictures, and their change if it is removed.

use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::response::{Score as ScoreKernel, ScoreSpec, Tally, TallyPush, TallySpec};
use crate::primitives::WORKGROUP;
use crate::render::TrainingRenderer;
use crate::scene::camera::Camera;
use bytemuck::{Pod, Zeroable};

/// Scores of a Gaussian: sums over all pixels of all views, with w = T alpha and with phi = w (c - b), the change of a
/// pixel if the Gaussian is removed; b is the colour behind it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Score {
    /// Sum of w.
    pub contribution: f32,
    /// Largest w.
    pub peak: f32,
    /// Number of pixels that blend it.
    pub hits: f32,
    /// Sum of opacity times T.
    pub significance: f32,
    /// Sum of w^2.
    pub squares: f32,
    /// Sum of |phi|^2, over three colours: the squared error of removing it, with the pictures as their own ground
    /// truth.
    pub change: f32,
    /// Sum of phi . r, where r is the picture minus its photo; 0 without photos.
    pub along_residual: f32,
    #[doc(hidden)]
    pub unused: f32,
    /// Sum of w b.
    pub behind: [f32; 3],
    #[doc(hidden)]
    pub unused_too: f32,
}

impl Score {
    /// Change of the squared error over all views if the Gaussian is removed; negative if they improve.
    pub fn removal(&self) -> f64 {
        f64::from(self.change) - 2.0 * f64::from(self.along_residual)
    }
}

/// Scores of all Gaussians over the recorded views, in device memory.
pub struct ResidentScores {
    /// A score for each Gaussian, n.
    pub values: Buffer<Score>,
    subgroup: u32,
}

impl ResidentScores {
    /// Bytes of the scores of `gaussians` Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<Score>::bytes_of(gaussians)
    }

    /// Zero scores, before any view.
    pub fn zeros(device: &Device, gaussians: usize) -> Result<Self> {
        let values = device.zeros("scores", gaussians)?;
        Ok(Self { values, subgroup: device.info().subgroup_size })
    }

    /// Scores with these values, n.
    pub fn upload(device: &Device, scores: &[Score]) -> Result<Self> {
        Ok(Self { values: device.upload("scores", scores)?, subgroup: device.info().subgroup_size })
    }

    /// Records the scores of the picture recorded before, with or without a backward pass; overwrites the slots' sums
    /// of the backward pass. `residual` is the picture minus its photo, if there is one.
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &TrainingRenderer,
        model: &Resident,
        camera: &Camera,
        residual: Option<&Buffer<[f32; 4]>>,
    ) {
        let slots = renderer.slots(camera);
        let sums = [&slots.sums.position, &slots.sums.covariance, slots.sums.responses()].map(Clone::clone);
        let score = ScoreKernel {
            view: slots.view,
            starts: slots.starts,
            slots: slots.sorted,
            owners: slots.owners,
            geometry: slots.geometry,
            shape: slots.shape,
            colour: slots.colour,
            image: renderer.image(),
            residual: residual.unwrap_or(renderer.image()),
            weights: &sums[0],
            changes: &sums[1],
            behinds: &sums[2],
            spec: ScoreSpec {
                workgroup: self.subgroup,
                tile: slots.tile,
                stride: slots.stride,
                pixels: slots.tile * slots.tile / self.subgroup,
                stop: slots.stop,
                residual: residual.is_some(),
            },
        };
        let tally = Tally {
            count: &model.count.value,
            pairs: slots.pairs,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            weights: &sums[0],
            changes: &sums[1],
            behinds: &sums[2],
            scores: &self.values.cast(),
            push: TallyPush { pair_limit: slots.limit },
            spec: TallySpec { workgroup: WORKGROUP },
        };
        recording.scope("score", |r| {
            r.dispatch(&score, Groups::Count(slots.tiles));
            r.dispatch(&tally, model.count.groups(WORKGROUP));
        });
    }
}
