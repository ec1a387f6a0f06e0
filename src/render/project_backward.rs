//! Backward pass of the projection: one row of gradients per Gaussian.

use super::backward::{Pass, Sums};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Recording};
use crate::kernels::render::{ProjectBackward, ProjectBackwardPush, ProjectBackwardSpec};
use crate::primitives::WORKGROUP;

pub(super) fn record(
    recording: &mut Recording,
    pass: &Pass<'_>,
    sums: &Sums<'_>,
    model: &Resident,
    guards: &Buffer<u32>,
) {
    let Pass { launch, frame, options, .. } = *pass;
    let Sums { counts, first, rows: sums } = *sums;
    // Without growth any buffer is bound in its place: the kernel does not touch it.
    let unused = frame.unused.cast();
    let kernel = ProjectBackward {
        view: &frame.view,
        count: &model.count.value,
        pairs: &frame.pairs.count.value,
        tile_counts: counts,
        first_slots: first,
        position_sums: &sums.position,
        covariance_sums: &sums.covariance,
        blue_sums: &sums.blue,
        shape: &frame.shape,
        colour: &frame.colour,
        means: &model.parameters.means,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        logits: &model.parameters.opacity_logits,
        sh1: &model.parameters.sh[1],
        sh2: &model.parameters.sh[2],
        sh3: &model.parameters.sh[3],
        rows: &frame.gradient_rows,
        growth: options.growth.unwrap_or(&unused),
        guards,
        push: ProjectBackwardPush { pair_limit: frame.pairs.count.limit() },
        spec: ProjectBackwardSpec {
            workgroup: WORKGROUP,
            antialias: launch.settings.style.antialias,
            degree: model.degree as u32,
            direction_gradient: options.through_direction,
            statistics: options.growth.is_some(),
            absolute: options.absolute,
            many: launch.tuning.bin_many,
            depths: options.depths,
        },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}
