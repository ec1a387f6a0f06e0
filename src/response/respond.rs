//! The eight response channels of each Gaussian, on the device.

use super::CHANNELS;
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::response::{Respond, RespondPush, RespondSpec};
use crate::primitives::WORKGROUP;
use crate::render::TrainingRenderer;
use crate::scene::camera::Camera;

/// Share of the previous average that each iteration keeps.
pub const KEEP: f64 = 0.995;

/// Combination of the responses of several views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gather {
    /// r <- 0.995 r + 0.005 x at each iteration; x = 0 if the view does not show the Gaussian.
    Average {
        /// The current iteration, which rises from one call to the next.
        iteration: u32,
    },
    /// The mean over all views.
    Mean {
        /// Number of views of the pass.
        views: u32,
    },
}

/// Responses of all Gaussians, in device memory. The two arrays are the whole state.
pub struct ResidentResponses {
    /// n x 8: values at the iteration that last showed the Gaussian, since averages decay lazily.
    pub values: Buffer<f32>,
    /// The iteration that last showed each Gaussian, n.
    pub seen: Buffer<u32>,
}

impl ResidentResponses {
    /// Bytes of the responses of `gaussians` Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<f32>::bytes_of(CHANNELS * gaussians) + Buffer::<u32>::bytes_of(gaussians)
    }

    /// Responses of zero.
    pub fn zeros(device: &Device, gaussians: usize) -> Result<Self> {
        let (values, seen) = ("responses", "responses' iterations");
        Ok(Self { values: device.zeros(values, CHANNELS * gaussians)?, seen: device.zeros(seen, gaussians)? })
    }

    /// Responses with these values (n) of a mean.
    pub fn upload(device: &Device, values: &[[f32; CHANNELS]]) -> Result<Self> {
        let (name, seen) = ("responses", "responses' iterations");
        Ok(Self { values: device.upload(name, values.as_flattened())?, seen: device.zeros(seen, values.len())? })
    }

    /// Records the responses of a view, after its [`TrainingRenderer::record_backward`] with
    /// [`residual`](crate::render::Backward::residual).
    ///
    /// Nothing changes if the view's pairs did not fit, as in training.
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &TrainingRenderer,
        model: &Resident,
        camera: &Camera,
        gather: Gather,
    ) {
        let slots = renderer.slots(camera);
        let (iteration, keep, weight) = match gather {
            Gather::Average { iteration } => (iteration, KEEP, 1.0 - KEEP),
            Gather::Mean { views } => (0, 1.0, 1.0 / f64::from(views.max(1))),
        };
        let kernel = Respond {
            count: &model.count.value,
            pairs: slots.pairs,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            response_sums: slots.sums.responses(),
            log_scales: &model.parameters.log_scales,
            rotations: &model.quaternions(),
            rows: renderer.gradient_rows().values,
            responses: &self.values,
            seen: &self.seen,
            push: RespondPush {
                pair_limit: slots.limit,
                iteration,
                log2_keep: keep.log2() as f32,
                weight: weight as f32,
                share: 1.0 / (camera.width as f32 * camera.height as f32),
                basis_norm: (model.degree as f32 + 1.0) / (4.0 * std::f32::consts::PI).sqrt(),
            },
            spec: RespondSpec { workgroup: WORKGROUP },
        };
        recording.scope("respond", |r| r.dispatch(&kernel, model.count.groups(WORKGROUP)));
    }

    /// The responses, one row per Gaussian; averages are decayed to the given iteration.
    pub fn read(&self, device: &Device, gather: Gather) -> Result<Vec<[f32; CHANNELS]>> {
        let mut rows = self.values.cast::<[f32; CHANNELS]>().read(device)?;
        if let Gather::Average { iteration } = gather {
            for (row, seen) in rows.iter_mut().zip(self.seen.read(device)?) {
                let decay = KEEP.powf(f64::from(iteration.saturating_sub(seen))) as f32;
                *row = row.map(|v| v * decay);
            }
        }
        Ok(rows)
    }
}
