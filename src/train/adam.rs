//! Adam, attribute by attribute, from the rows of gradients that the backward pass leaves.

use super::trainee::Trainee;

pub use super::moments::{Moments, zeros};
use crate::gaussians::Attributes;
use crate::gaussians::resident::Resident;
use crate::gpu::{Groups, Recording};
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use crate::kernels::constants::adam::{GRADIENT, NO_BAND, UPDATE};
use crate::kernels::constants::gradient_row::{ROW_LOG_SCALE, ROW_LOGIT, ROW_MEAN, ROW_ROTATION};
use crate::kernels::train::{Adam, AdamPush, AdamSpec};
use crate::primitives::WORKGROUP;
use crate::render::Renderer;

/// The profiler's scope.
pub const STAGE: &str = "adam";

/// Learning rates of one step, in units of the stored parameters.
pub type Rates = Attributes<f32>;

/// The offset of each attribute's gradients in a row, and its SH band. The gradients of a band are those of the colour,
/// times the basis.
const PLACES: Attributes<(u32, u32)> = Attributes {
    means: (ROW_MEAN, NO_BAND),
    log_scales: (ROW_LOG_SCALE, NO_BAND),
    rotations: (ROW_ROTATION, NO_BAND),
    opacity_logits: (ROW_LOGIT, NO_BAND),
    sh: [(0, 0), (0, 1), (0, 2), (0, 3)],
};

/// Use of the gradients.
#[derive(Clone, Copy)]
enum Outcome<'a> {
    /// A step of Adam, the first being 1.
    Stepped { rates: &'a Rates, step: u32 },
    /// Stored as first moments; second moments become 0, and parameters stay unchanged.
    Stored,
}

/// Records step `step` (the first is 1) of Adam, after [`Renderer::record_backward`]: moments and parameters change.
///
/// Nothing changes if the picture's pairs did not fit. A Gaussian with a non-finite gradient stays unchanged.
pub fn record(recording: &mut Recording, renderer: &Renderer, trainee: &Trainee, rates: &Rates, step: u32) {
    let Trainee { model, moments, .. } = trainee;
    recording.scope(STAGE, |r| each(r, renderer, model, moments, Outcome::Stepped { rates, step }));
}

/// Records that the gradients of [`Renderer::record_backward`] are stored as first moments, for tests and sweeps.
pub fn record_gradients(recording: &mut Recording, renderer: &Renderer, model: &Resident, moments: &Moments) {
    recording.scope(STAGE, |r| each(r, renderer, model, moments, Outcome::Stored));
}

fn each(recording: &mut Recording, renderer: &Renderer, model: &Resident, moments: &Moments, outcome: Outcome<'_>) {
    let (form, step, rates) = match outcome {
        Outcome::Stepped { rates, step } => (UPDATE, step, *rates),
        Outcome::Stored => (GRADIENT, 1, Rates::default()),
    };
    let correction = |beta: f64| 1.0 - beta.powf(f64::from(step));
    let rows = renderer.gradient_rows();
    let arrays = model.parameters.each_ref().zip(moments.each_ref());
    let all = PLACES.zip(Attributes::widths(model.degree)).zip(arrays).zip(rates);
    for ((((offset, band), width), (values, moments)), rate) in all.up_to(model.degree) {
        let width = width as u32;
        let run = if renderer.device().tuning().adam_by_gaussian { width } else { 1 };
        let kernel = Adam {
            pairs: rows.pairs,
            count: &model.count.value,
            rows: rows.values,
            values,
            moments,
            push: AdamPush {
                rate,
                correction1: (1.0 / correction(BETA1)) as f32,
                correction2: (1.0 / correction(BETA2).sqrt()) as f32,
                pair_limit: rows.limit,
            },
            spec: AdamSpec { workgroup: WORKGROUP, width, offset, band, form, run },
        };
        let runs = model.len as u32 * (width / run);
        recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
    }
}
