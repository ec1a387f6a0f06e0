//! Projection: 2D Gaussians, colours, depths and tile counts.

use super::frame::{Frame, Launch};
use crate::gaussians::resident::Resident;
use crate::gpu::Recording;
use crate::kernels::render::{Project, ProjectSpec};
use crate::primitives::WORKGROUP;

pub(super) fn record(recording: &mut Recording, launch: &Launch, frame: &Frame, model: &Resident) {
    let kernel = Project {
        view: &frame.view,
        count: &model.count.value,
        means: &model.parameters.means,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        logits: &model.parameters.opacity_logits,
        sh0: &model.parameters.sh[0],
        sh1: &model.parameters.sh[1],
        sh2: &model.parameters.sh[2],
        sh3: &model.parameters.sh[3],
        geometry: &frame.geometry,
        shape: &frame.shape,
        colour: &frame.colour,
        depth: &frame.depth,
        tile_counts: &frame.tile_counts,
        visible: &frame.visible,
        spec: ProjectSpec {
            workgroup: WORKGROUP,
            tile: launch.tuning.tile,
            culling: launch.settings.culling as u32,
            antialias: launch.settings.style.antialias,
            degree: model.degree as u32,
        },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}
