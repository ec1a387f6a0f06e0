//! Responses: how strongly pictures and losses depend on each Gaussian, eight channels of it (docs/method.md).
//!
//! | channel | |
//! |---|---|
//! | 0 | 1 where a pixel blended it |
//! | 1 | sum of T alpha, over the pixels |
//! | 2 | sum of T alpha times the residual, over the pixels |
//! | 3 | sum of alpha, over the pixels |
//! | 4 | norm of dL/dmean in units of its own axes |
//! | 5 | norm of dL/dlog-scale |
//! | 6 | abs dL/dlogit |
//! | 7 | norm of dL/dSH over all bands |

use super::CHANNELS;
use super::score::Scores;
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Error, Groups, Recording, Result};
use crate::kernels::qirf::{
    HighPass as HighPassKernel, HighPassPush, HighPassSpec, Residual, ResidualPush, ResidualSpec, Respond, RespondPush,
    RespondSpec,
};
use crate::primitives::WORKGROUP;
use crate::render::{Backward, Renderer};
use crate::scene::camera::Camera;

/// What an iteration's average keeps of the one before.
pub const KEEP: f64 = 0.995;
/// Outputs that one invocation of the blur owns.
const RUN: u32 = 8;

/// How views add up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gather {
    /// r <- 0.995 r + 0.005 x over iterations, this being the given one; where a view does not show a Gaussian, x = 0.
    Average {
        /// Iterations rise from one call to the next.
        iteration: u32,
    },
    /// The mean over this many views.
    Mean {
        /// Views of the whole pass.
        views: u32,
    },
}

/// How strongly the pictures depend on each Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Responses, n.
    pub responses: Vec<[f32; CHANNELS]>,
    /// Sum of T alpha, largest T alpha, hits, sum of opacity x T (see [`super::score`]), n; or none, where no selector asked reads them.
    pub scores: Vec<[f32; 4]>,
}

/// Responses of all Gaussians, in device memory. Both arrays together are its whole state.
pub struct Responses {
    /// n x 8: as of the iteration that last showed the Gaussian, since averages decay lazily.
    pub values: Buffer<f32>,
    /// n: that iteration.
    pub seen: Buffer<u32>,
}

impl Responses {
    /// Bytes of the responses of so many Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<f32>::bytes_of(CHANNELS * gaussians) + Buffer::<u32>::bytes_of(gaussians)
    }

    /// No response yet.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn zeros(device: &Device, gaussians: usize) -> Result<Self> {
        let (values, seen) =
            (device.buffer("responses", CHANNELS * gaussians)?, device.buffer("responses' iterations", gaussians)?);
        let mut recording = Recording::new();
        recording.fill(&values, 0);
        recording.fill(&seen, 0);
        device.run(recording)?;
        Ok(Self { values, seen })
    }

    /// Records this view's responses, after [`Renderer::record_backward`] of the same view
    /// with [`Backward::residual`].
    ///
    /// Nothing happens where the view's pairs did not fit, as in training.
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &Renderer,
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
            moments_a: &slots.moments_a,
            moments_b: &slots.moments_b,
            moments_c: &slots.moments_c,
            log_scales: &model.log_scales,
            rotations: &model.rotations,
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

    /// The responses, one row a Gaussian; averages decayed to the iteration given, means as they are.
    ///
    /// # Errors
    /// Device errors.
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

/// Records the mean over the colours of |picture - photo| into the gradient's fourth component, after the loss.
///
/// Where `transparent`, the photo's fourth byte is its opacity over `background`.
pub fn record_residual(
    recording: &mut Recording,
    image: &Buffer<[f32; 4]>,
    photo: &Buffer<u32>,
    gradient: &Buffer<[f32; 4]>,
    [width, height]: [u32; 2],
    transparent: bool,
    [r, g, b]: [f32; 3],
) {
    let pixels = width * height;
    let kernel = Residual {
        image: &image.cast(),
        photo,
        gradient: &gradient.cast(),
        push: ResidualPush { background: [r, g, b, 0.0], pixels },
        spec: ResidualSpec { workgroup: WORKGROUP, alpha: u32::from(transparent) },
    };
    recording.scope("residual", |r| r.dispatch(&kernel, Groups::Count(pixels.div_ceil(WORKGROUP))));
}

/// Stands for the loss where there are no photos: L = sum C (C - blur C), the blur's sigma 2 pixels, its bracket constant.
pub struct HighPass {
    scratch: Buffer<f32>,
}

impl HighPass {
    /// Bytes of [`HighPass::new`].
    pub fn bytes(pixels: usize) -> u64 {
        Buffer::<f32>::bytes_of(3 * pixels)
    }

    /// Scratch for pictures of up to `pixels`.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, pixels: usize) -> Result<Self> {
        Ok(Self { scratch: device.buffer("blurred columns", 3 * pixels)? })
    }

    /// Records C - blur C into the gradient, and the mean over the colours of its absolute value into the fourth component.
    pub fn record(
        &self,
        recording: &mut Recording,
        image: &Buffer<[f32; 4]>,
        gradient: &Buffer<[f32; 4]>,
        [width, height]: [u32; 2],
    ) {
        recording.scope("high pass", |r| {
            for (phase, lines, length) in [(0, width, height), (1, height, width)] {
                let kernel = HighPassKernel {
                    image: &image.cast(),
                    scratch: &self.scratch,
                    gradient: &gradient.cast(),
                    push: HighPassPush { width, height },
                    spec: HighPassSpec { workgroup: WORKGROUP, phase },
                };
                r.dispatch(&kernel, Groups::Count((lines * length.div_ceil(RUN)).div_ceil(WORKGROUP)));
            }
        });
    }
}

/// A deterministic pass: the mean response over all `cameras`, view by view, and where asked for the scores of other methods.
///
/// `loss` records, for a view and its picture, the loss's gradient with the residual in its fourth component into
/// `image_gradient`, which holds the largest view. The model does not change.
///
/// # Errors
/// Device memory; device errors; what `loss` returns.
///
/// # Panics
/// When the renderer was not made [`Renderer::for_training`].
pub fn full_pass<E: From<Error>>(
    device: &Device,
    renderer: &mut Renderer,
    model: &Resident,
    cameras: &[Camera],
    image_gradient: &Buffer<[f32; 4]>,
    with_scores: bool,
    mut loss: impl FnMut(&mut Recording, usize, &Buffer<[f32; 4]>) -> std::result::Result<(), E>,
) -> std::result::Result<Evidence, E> {
    let responses = Responses::zeros(device, model.len)?;
    let scores = with_scores.then(|| Scores::zeros(device, model.len)).transpose()?;
    let backward = Backward { residual: true, ..Backward::default() };
    let gather = Gather::Mean { views: cameras.len() as u32 };
    for (v, camera) in cameras.iter().enumerate() {
        renderer.make_room(model, camera)?;
        loop {
            let mut recording = Recording::new();
            renderer.forget_pairs(&mut recording);
            renderer.record(&mut recording, model, camera);
            loss(&mut recording, v, renderer.image())?;
            renderer.record_backward(&mut recording, model, camera, image_gradient, backward);
            responses.record(&mut recording, renderer, model, camera, gather);
            if let Some(scores) = &scores {
                scores.record(&mut recording, renderer, model, camera);
            }
            device.run(recording)?;
            // A view whose pairs did not fit has changed nothing.
            if !renderer.make_room_for_pairs(renderer.pairs()?)? {
                break;
            }
        }
    }
    let scores = scores.map(|s| s.values.read(device)).transpose()?;
    Ok(Evidence { responses: responses.read(device, gather)?, scores: scores.unwrap_or_default() })
}
