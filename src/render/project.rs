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
        means: &model.means,
        log_scales: &model.log_scales,
        rotations: &model.rotations,
        logits: &model.opacity_logits,
        sh0: &model.sh[0],
        sh1: &model.sh[1],
        sh2: &model.sh[2],
        sh3: &model.sh[3],
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
            antialias: launch.settings.antialias,
            degree: model.degree as u32,
            half: model.half,
        },
    };
    recording.dispatch(&kernel, model.count.groups(WORKGROUP));
}
