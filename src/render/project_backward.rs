//! Backward of the projection, fused with Adam.

use super::renderer::{Frame, Moments, Shape};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::render::{ProjectBackward, ProjectBackwardPush, ProjectBackwardSpec};
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

pub(super) fn record(
    recording: &mut Recording,
    shape: &Shape,
    frame: &Frame,
    moments: &Moments,
    model: &Resident,
    update: &Update<'_>,
) {
    let (form, step, through_direction) = match update.form {
        Form::Adam(step) => (0, step, true),
        Form::Gradients { through_direction } => (1, 1, through_direction),
    };
    let correction = |beta: f64| 1.0 - beta.powf(f64::from(step));
    let state = update.state;
    let kernel = ProjectBackward {
        view: &frame.view,
        count: &model.count.value,
        pairs: &frame.pairs.count.value,
        tile_counts: &frame.tile_counts,
        first_slots: &frame.first_slots,
        moments_a: &moments.a,
        moments_b: &moments.b,
        moments_c: &moments.c,
        means: &model.means,
        log_scales: &model.log_scales,
        rotations: &model.rotations,
        logits: &model.opacity_logits,
        sh0: &model.sh[0],
        sh1: &model.sh[1],
        sh2: &model.sh[2],
        sh3: &model.sh[3],
        means_adam: &state.means,
        log_scales_adam: &state.log_scales,
        rotations_adam: &state.rotations,
        logits_adam: &state.opacity_logits,
        sh0_adam: &state.sh[0],
        sh1_adam: &state.sh[1],
        sh2_adam: &state.sh[2],
        sh3_adam: &state.sh[3],
        growth: update.growth,
        guards: update.guards,
        push: ProjectBackwardPush {
            rate_mean: update.rates.mean,
            rate_scale: update.rates.scale,
            rate_rotation: update.rates.rotation,
            rate_opacity: update.rates.opacity,
            rate_dc: update.rates.dc,
            rate_rest: update.rates.rest,
            correction1: (1.0 / correction(0.9)) as f32,
            correction2: (1.0 / correction(0.999).sqrt()) as f32,
            pair_limit: frame.pairs.count.limit(),
        },
        spec: ProjectBackwardSpec {
            workgroup: WORKGROUP,
            antialias: shape.settings.antialias,
            degree: model.degree as u32,
            form,
            direction_gradient: through_direction,
            statistics: update.statistics,
        },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}
