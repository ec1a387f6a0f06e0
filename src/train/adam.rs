//! Adam, from the rows of gradients of the backward pass.

pub use super::moments::{Moments, zeros};
use super::rates::{Rates, Step};
use super::training_model::TrainingModel;

use crate::gaussians::resident::Resident;
use crate::gpu::{Groups, Recording};
use crate::kernels::constants::adam_step::{GRADIENT, UPDATE};
use crate::kernels::train::{Adam, AdamPush, AdamSpec};
use crate::primitives::{Count, WORKGROUP};
use crate::render::TrainingRenderer;

/// The profiler's scope.
pub const STAGE: &str = "adam";

/// Records a step of Adam, after [`TrainingRenderer::record_backward`]: moments and parameters change.
///
/// Nothing changes if the picture's pairs did not fit. A Gaussian with a non-finite gradient stays unchanged, and so does the
/// model's tail.
pub fn record(recording: &mut Recording, renderer: &TrainingRenderer, training: &TrainingModel, step: Step) {
    let TrainingModel { model, moments, .. } = training;
    let rows = Rows { model, count: training.count(), len: training.trained() };
    dispatch(recording, renderer, &rows, moments, (UPDATE, step));
}

/// Records the storing of the gradients of [`TrainingRenderer::record_backward`] as first moments, for tests and sweeps.
pub fn record_gradients(recording: &mut Recording, renderer: &TrainingRenderer, model: &Resident, moments: &Moments) {
    let rows = Rows { model, count: &model.count, len: model.len };
    dispatch(recording, renderer, &rows, moments, (GRADIENT, Step::new(1, Rates::default())));
}

/// The first rows of a model.
struct Rows<'a> {
    model: &'a Resident,
    /// Their number, on the device.
    count: &'a Count,
    /// The same number.
    len: usize,
}

impl Step {
    /// See `lib/adam_step.glsl`, as for the next.
    fn decays(&self) -> [f32; 4] {
        let [first, second] = self.decays;
        [first, 1.0 - first, second, 1.0 - second].map(|x| x as f32)
    }

    fn correction(&self) -> [f32; 2] {
        let [left1, left2] = self.decays.map(|decay| 1.0 - decay.powf(f64::from(self.number)));
        [(1.0 / left1) as f32, (1.0 / left2.sqrt()) as f32]
    }
}

/// A block of Gaussians per workgroup, or one Gaussian per invocation.
fn dispatch(
    recording: &mut Recording,
    renderer: &TrainingRenderer,
    first: &Rows<'_>,
    moments: &Moments,
    (form, step): (u32, Step),
) {
    let block = renderer.device().tuning().adam_block;
    let Rows { model, count, len } = *first;
    let (rows, values, rates) = (renderer.gradient_rows(), &model.parameters, step.rates);
    let kernel = Adam {
        pairs: rows.pairs,
        count: &count.value,
        rows: rows.values,
        means: &values.means,
        log_scales: &values.log_scales,
        rotations: &values.rotations,
        logits: &values.opacity_logits,
        sh0: &values.sh[0],
        sh1: &values.sh[1],
        sh2: &values.sh[2],
        sh3: &values.sh[3],
        mean_moments: &moments.means,
        log_scale_moments: &moments.log_scales,
        rotation_moments: &moments.rotations,
        logit_moments: &moments.opacity_logits,
        sh0_moments: &moments.sh[0],
        sh1_moments: &moments.sh[1],
        sh2_moments: &moments.sh[2],
        sh3_moments: &moments.sh[3],
        push: AdamPush {
            decays: step.decays(),
            correction: step.correction(),
            pair_limit: rows.limit,
            pressure: step.pressure.map_or(0.0, |p| p.pressure),
            least_through: step.pressure.map_or(1.0, |p| p.least_through),
            rate_means: rates.means,
            rate_log_scales: rates.log_scales,
            rate_rotations: rates.rotations,
            rate_logits: rates.opacity_logits,
            rate_sh0: rates.sh[0],
            rate_sh1: rates.sh[1],
            rate_sh2: rates.sh[2],
            rate_sh3: rates.sh[3],
        },
        spec: AdamSpec {
            workgroup: WORKGROUP,
            block,
            degree: model.degree as u32,
            form,
            pressed: step.pressure.is_some(),
        },
    };
    let each = if block == 1 { WORKGROUP } else { block };
    recording.scope(STAGE, |r| r.dispatch(&kernel, Groups::Count((len as u32).div_ceil(each))));
}
