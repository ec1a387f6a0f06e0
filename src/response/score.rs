//! Scores that other pruning methods rank by: contribution, peak contribution, hits, and opacity times transmittance.

use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::response::{Score, ScoreSpec, Tally, TallyPush, TallySpec};
use crate::primitives::WORKGROUP;
use crate::render::Renderer;
use crate::scene::camera::Camera;

/// Scores of all Gaussians over the recorded views, in device memory.
pub struct ResidentScores {
    /// n x (sum of T alpha, largest T alpha of a pixel, pixels that blended it, sum of opacity x T).
    pub values: Buffer<[f32; 4]>,
    subgroup: u32,
}

impl ResidentScores {
    /// Bytes of the scores of `gaussians` Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<[f32; 4]>::bytes_of(gaussians)
    }

    /// Scores of no view: zero.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn zeros(device: &Device, gaussians: usize) -> Result<Self> {
        let values = device.buffer("scores", gaussians)?;
        let mut recording = Recording::new();
        recording.fill(&values, 0);
        device.run(recording)?;
        Ok(Self { values, subgroup: device.info().subgroup_size })
    }

    /// Records the scores of the picture recorded before, which the backward pass need not have seen; the position
    /// sums that it left are overwritten.
    ///
    /// # Panics
    /// If the renderer was not made by [`Renderer::for_training`].
    pub fn record(&self, recording: &mut Recording, renderer: &Renderer, model: &Resident, camera: &Camera) {
        let slots = renderer.slots(camera);
        let score = Score {
            view: slots.view,
            starts: slots.starts,
            slots: slots.sorted,
            owners: slots.owners,
            geometry: slots.geometry,
            shape: slots.shape,
            tallies: &slots.sums.position,
            spec: ScoreSpec {
                workgroup: self.subgroup,
                tile: slots.tile,
                pixels: slots.tile * slots.tile / self.subgroup,
                stop: slots.stop,
            },
        };
        let tally = Tally {
            count: &model.count.value,
            pairs: slots.pairs,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            tallies: &slots.sums.position.cast(),
            scores: &self.values,
            push: TallyPush { pair_limit: slots.limit },
            spec: TallySpec { workgroup: WORKGROUP },
        };
        recording.scope("score", |r| {
            r.dispatch(&score, Groups::Count(slots.tiles));
            r.dispatch(&tally, model.count.groups(WORKGROUP));
        });
    }
}
