//! Backward of the projection: one row of gradients a Gaussian.

use super::adam::{Form, Update};
use super::frame::{Frame, Moments, Shape};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Recording};
use crate::kernels::render::{ProjectBackward, ProjectBackwardPush, ProjectBackwardSpec};
use crate::primitives::WORKGROUP;

/// Where a Gaussian's sums lie: `counts` rows of the moments from `first` on.
pub(super) struct Sums<'a> {
    pub counts: &'a Buffer<u32>,
    pub first: &'a Buffer<u32>,
    pub moments: &'a Moments,
}

pub(super) fn record(
    recording: &mut Recording,
    shape: &Shape,
    frame: &Frame,
    Sums { counts, first, moments }: &Sums<'_>,
    model: &Resident,
    update: &Update<'_>,
) {
    let through_direction = !matches!(update.form, Form::Gradients { through_direction: false });
    let kernel = ProjectBackward {
        view: &frame.view,
        count: &model.count.value,
        pairs: &frame.pairs.count.value,
        tile_counts: counts,
        first_slots: first,
        moments_a: &moments.a,
        moments_b: &moments.b,
        moments_c: &moments.c,
        shape: &frame.shape,
        colour: &frame.colour,
        means: &model.means,
        log_scales: &model.log_scales,
        rotations: &model.rotations,
        logits: &model.opacity_logits,
        sh1: &model.sh[1],
        sh2: &model.sh[2],
        sh3: &model.sh[3],
        rows: &frame.gradient_rows,
        growth: update.growth,
        guards: update.guards,
        push: ProjectBackwardPush { pair_limit: frame.pairs.count.limit() },
        spec: ProjectBackwardSpec {
            workgroup: WORKGROUP,
            antialias: shape.settings.antialias,
            degree: model.degree as u32,
            direction_gradient: through_direction,
            statistics: update.statistics,
        },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}
