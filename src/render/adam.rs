//! Adam, attribute by attribute, from the gradient rows that projection's backward pass leaves.

use super::frame::{Frame, Shape};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::render::{Adam, AdamPush, AdamSpec};
use crate::primitives::WORKGROUP;

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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// An Adam step, the first being 1.
    Adam(u32),
    /// They are written into the first moments, and the parameters stay (tests).
    Gradients {
        /// Whether the view direction's gradient reaches the mean.
        through_direction: bool,
    },
    /// They stay in the renderer's rows: neither parameters nor moments change (scoring passes).
    Rows,
}

/// Where the projection's backward pass leaves its results.
pub struct Update<'a> {
    /// Optimiser state.
    pub state: &'a AdamState,
    /// n x (sum of the 2D mean's gradient norms in NDC units, views that saw it).
    pub growth: &'a Buffer<[f32; 2]>,
    /// Whether `growth` is added to.
    pub statistics: bool,
    /// Word 0: rows skipped for a gradient that is not finite; word 1: iterations done.
    pub guards: &'a Buffer<u32>,
    /// Learning rates.
    pub rates: Rates,
    /// What becomes of the gradients.
    pub form: Form,
}

/// What a scoring pass hands over in place of an optimiser: no moments, no density sums, and guards of its own.
pub struct Scoring {
    state: AdamState,
    growth: Buffer<[f32; 2]>,
    /// As [`Update::guards`].
    pub guards: Buffer<u32>,
}

impl Scoring {
    /// Arrays that no kernel of such a pass touches, and guards of zero.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn new(device: &Device) -> Result<Self> {
        let empty = || device.buffer("no moments", 1);
        let sh = [empty()?, empty()?, empty()?, empty()?];
        let state =
            AdamState { means: empty()?, log_scales: empty()?, rotations: empty()?, opacity_logits: empty()?, sh };
        Ok(Self { state, growth: device.buffer("no growth", 1)?, guards: device.upload("guards", &[0, 0])? })
    }

    /// Leaves the gradients in the renderer's rows: see [`Form::Rows`].
    pub fn update(&self) -> Update<'_> {
        Update {
            state: &self.state,
            growth: &self.growth,
            statistics: false,
            guards: &self.guards,
            rates: Rates::default(),
            form: Form::Rows,
        }
    }
}

/// Marks an attribute whose gradient stands in the row itself.
const NO_BAND: u32 = 4;

pub(super) fn record(recording: &mut Recording, shape: &Shape, frame: &Frame, model: &Resident, update: &Update<'_>) {
    let (state, rates) = (update.state, update.rates);
    // Offsets are those of lib/gradient_row.glsl.
    let attributes = [
        (&model.means, &state.means, 3, 0, rates.mean),
        (&model.log_scales, &state.log_scales, 3, 3, rates.scale),
        (&model.rotations.cast(), &state.rotations, 4, 6, rates.rotation),
        (&model.opacity_logits, &state.opacity_logits, 1, 10, rates.opacity),
    ];
    for (values, moments, width, offset, rate) in attributes {
        attribute(recording, shape.cpu, frame, model, update, values, moments, [width, offset, NO_BAND], rate);
    }
    for l in 0..=model.degree {
        let width = Gaussians::band_width(l) as u32;
        let rate = if l == 0 { rates.dc } else { rates.rest };
        attribute(recording, shape.cpu, frame, model, update, &model.sh[l], &state.sh[l], [width, 0, l as u32], rate);
    }
}

fn attribute(
    recording: &mut Recording,
    cpu: bool,
    frame: &Frame,
    model: &Resident,
    update: &Update<'_>,
    values: &Buffer<f32>,
    moments: &Buffer<[f32; 2]>,
    [width, offset, band]: [u32; 3],
    rate: f32,
) {
    let (form, step) = match update.form {
        Form::Adam(step) => (0, step),
        Form::Gradients { .. } | Form::Rows => (1, 1),
    };
    let correction = |beta: f64| 1.0 - beta.powf(f64::from(step));
    // On a GPU neighbouring lanes touch neighbouring words; on a CPU what a Gaussian's elements share is read once.
    let run = if cpu { width } else { 1 };
    let kernel = Adam {
        pairs: &frame.pairs.count.value,
        count: &model.count.value,
        rows: &frame.gradient_rows,
        values,
        moments,
        push: AdamPush {
            rate,
            correction1: (1.0 / correction(0.9)) as f32,
            correction2: (1.0 / correction(0.999).sqrt()) as f32,
            pair_limit: frame.pairs.count.limit(),
        },
        spec: AdamSpec { workgroup: WORKGROUP, width, offset, band, form, run },
    };
    let runs = model.len as u32 * (width / run);
    recording.dispatch(&kernel, Groups::Count(runs.div_ceil(WORKGROUP)));
}
