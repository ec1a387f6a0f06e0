//! What growth by relocation does in every iteration: opacities and scales are pulled down, and faint Gaussians are shaken.

use super::relocation::Relocation;
use super::trainee::Trainee;
use crate::gpu::Recording;
use crate::kernels::constants::explore::{PULL, SHAKE};
use crate::kernels::train::{Explore, ExplorePush, ExploreSpec};
use crate::primitives::WORKGROUP;
use crate::render::Renderer;

/// The profiler's scope.
pub const STAGE: &str = "explore";

/// Records the slopes of opacities and scales into the rows of [`Renderer::record_backward`], before Adam.
pub fn pull(recording: &mut Recording, renderer: &Renderer, trainee: &Trainee, settings: &Relocation) {
    let n = trainee.trained().max(1) as f64;
    let push = ExplorePush {
        opacity: (settings.opacity / n) as f32,
        scale: (settings.scale / (3.0 * n)) as f32,
        ..ExplorePush::default()
    };
    record(recording, renderer, trainee, PULL, push);
}

/// Records the random steps of faint Gaussians, after Adam. `rate` is the positions' learning rate; `key` the run's seed and
/// the iteration.
pub fn shake(
    recording: &mut Recording,
    renderer: &Renderer,
    trainee: &Trainee,
    settings: &Relocation,
    rate: f32,
    [seed, iteration]: [u32; 2],
) {
    let noise = (settings.noise * f64::from(rate)) as f32;
    record(recording, renderer, trainee, SHAKE, ExplorePush { seed, iteration, noise, ..ExplorePush::default() });
}

fn record(recording: &mut Recording, renderer: &Renderer, trainee: &Trainee, phase: u32, push: ExplorePush) {
    let (model, rows) = (&trainee.model, renderer.gradient_rows());
    let kernel = Explore {
        pairs: rows.pairs,
        count: &trainee.count().value,
        logits: &model.parameters.opacity_logits,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        rows: rows.values,
        means: &model.parameters.means,
        push: ExplorePush { pair_limit: rows.limit, ..push },
        spec: ExploreSpec { workgroup: WORKGROUP, phase },
    };
    recording.scope(STAGE, |r| r.dispatch(&kernel, trainee.count().groups(WORKGROUP)));
}
