//! Adam, attribute by attribute, from the gradient rows that projection's backward pass leaves.

use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use crate::kernels::constants::adam::{GRADIENT, NO_BAND, UPDATE};
use crate::kernels::constants::gradient_row::{ROW_LOG_SCALE, ROW_LOGIT, ROW_MEAN, ROW_ROTATION};
use crate::kernels::train::{Adam, AdamPush, AdamSpec};
use crate::primitives::WORKGROUP;
use crate::render::{GradientRows, Renderer};

/// The profiler's scope.
pub const STAGE: &str = "adam";

/// First and second moment of every parameter, in the parameters' own layout.
pub struct AdamState {
    /// n x 3.
    pub means: Buffer<[f32; 2]>,
    /// n x 3.
    pub log_scales: Buffer<[f32; 2]>,
    /// n x 4.
    pub rotations: Buffer<[f32; 2]>,
    /// n.
    pub opacity_logits: Buffer<[f32; 2]>,
    /// Band l: n x (2l + 1) x 3; a band that the model lacks is one element.
    pub sh: [Buffer<[f32; 2]>; MAX_SH_DEGREE + 1],
}

impl AdamState {
    /// Bytes of the moments of a model of `n` Gaussians.
    pub fn bytes(n: usize, degree: usize) -> u64 {
        let of = Buffer::<[f32; 2]>::bytes_of;
        let band = |l: usize| of(if l <= degree { n * Gaussians::band_width(l) } else { 1 });
        2 * of(3 * n) + of(4 * n) + of(n) + (0..=MAX_SH_DEGREE).map(band).sum::<u64>()
    }

    /// Moments of zero for a model.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn zeros(device: &Device, model: &Resident) -> Result<Self> {
        let mut recording = Recording::new();
        let mut zeros = |name: &str, len: usize| -> Result<Buffer<[f32; 2]>> {
            let buffer = device.buffer(name, len)?;
            recording.fill(&buffer, 0);
            Ok(buffer)
        };
        let n = model.len;
        let band = |l: usize| if l <= model.degree { n * Gaussians::band_width(l) } else { 1 };
        let state = Self {
            means: zeros("means' moments", 3 * n)?,
            log_scales: zeros("log scales' moments", 3 * n)?,
            rotations: zeros("rotations' moments", 4 * n)?,
            opacity_logits: zeros("opacity logits' moments", n)?,
            sh: [
                zeros("sh0's moments", band(0))?,
                zeros("sh1's moments", band(1))?,
                zeros("sh2's moments", band(2))?,
                zeros("sh3's moments", band(3))?,
            ],
        };
        device.run(recording)?;
        Ok(state)
    }
}

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// Centres, in world units.
    pub mean: f32,
    /// Log scales.
    pub scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// SH band 0.
    pub dc: f32,
    /// SH bands above.
    pub rest: f32,
}

/// What becomes of the gradients.
#[derive(Clone, Copy)]
enum Form {
    /// An Adam step, the first being 1.
    Step(u32),
    /// They are written into the first moments, and the parameters stay.
    Gradients,
}

/// Records step `step` (1 at the first) of Adam, after [`Renderer::record_backward`]: moments and parameters change.
///
/// Nothing happens where the picture's pairs did not fit; a row whose gradient is not finite stays as it is.
pub fn record(
    recording: &mut Recording,
    renderer: &Renderer,
    model: &Resident,
    state: &AdamState,
    rates: &Rates,
    step: u32,
) {
    record_as(recording, renderer, model, state, rates, Form::Step(step));
}

/// Records that the gradients of [`Renderer::record_backward`] become the first moments, and the second 0; the parameters
/// stay. What tests and sweeps look at.
pub fn record_gradients(recording: &mut Recording, renderer: &Renderer, model: &Resident, state: &AdamState) {
    record_as(recording, renderer, model, state, &Rates::default(), Form::Gradients);
}

fn record_as(
    recording: &mut Recording,
    renderer: &Renderer,
    model: &Resident,
    state: &AdamState,
    rates: &Rates,
    form: Form,
) {
    let attributes = [
        (&model.means, &state.means, 3, ROW_MEAN, rates.mean),
        (&model.log_scales, &state.log_scales, 3, ROW_LOG_SCALE, rates.scale),
        (&model.rotations.cast(), &state.rotations, 4, ROW_ROTATION, rates.rotation),
        (&model.opacity_logits, &state.opacity_logits, 1, ROW_LOGIT, rates.opacity),
    ];
    recording.scope(STAGE, |r| {
        let pass = Pass {
            rows: renderer.gradient_rows(),
            model,
            form,
            by_gaussian: renderer.device().tuning().adam_by_gaussian,
        };
        for (values, moments, width, offset, rate) in attributes {
            pass.attribute(r, values, moments, Place { width, offset, band: NO_BAND }, rate);
        }
        for l in 0..=model.degree {
            let place = Place { width: Gaussians::band_width(l) as u32, offset: 0, band: l as u32 };
            let rate = if l == 0 { rates.dc } else { rates.rest };
            pass.attribute(r, &model.sh[l], &state.sh[l], place, rate);
        }
    });
}

/// Where an attribute's gradients stand in a row.
struct Place {
    width: u32,
    offset: u32,
    band: u32,
}

/// What all attributes share.
struct Pass<'a> {
    rows: GradientRows<'a>,
    model: &'a Resident,
    form: Form,
    /// Whether an invocation owns all elements of a Gaussian.
    by_gaussian: bool,
}

impl Pass<'_> {
    fn attribute(
        &self,
        recording: &mut Recording,
        values: &Buffer<f32>,
        moments: &Buffer<[f32; 2]>,
        Place { width, offset, band }: Place,
        rate: f32,
    ) {
        let (form, step) = match self.form {
            Form::Step(step) => (UPDATE, step),
            Form::Gradients => (GRADIENT, 1),
        };
        let correction = |beta: f64| 1.0 - beta.powf(f64::from(step));
        let run = if self.by_gaussian { width } else { 1 };
        let kernel = Adam {
            pairs: self.rows.pairs,
            count: &self.model.count.value,
            rows: self.rows.values,
            values,
            moments,
            push: AdamPush {
                rate,
                correction1: (1.0 / correction(BETA1)) as f32,
                correction2: (1.0 / correction(BETA2).sqrt()) as f32,
                pair_limit: self.rows.limit,
            },
            spec: AdamSpec { workgroup: WORKGROUP, width, offset, band, form, run },
        };
        let runs = self.model.len as u32 * (width / run);
        recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
    }
}
