//! Small runs on synthetic scenes.

use qirf_vk::effects::Overrides;
use qirf_vk::pipeline::config::{Init, Preset, RunConfig};
use qirf_vk::render::Style;
use std::path::Path;

/// A dense run of the quick preset on a scene's own photos, without effects, checkpoints and prunes.
pub fn config(scene: &Path, iterations: u32) -> RunConfig {
    RunConfig {
        scene: scene.to_owned(),
        images: None,
        resolution: None,
        seed: 1,
        eval_every: 8,
        sh_degree: 1,
        init: Init::Points,
        init_count: None,
        background: None,
        style: Style::default(),
        exposure: false,
        max_gaussians: 3000,
        checkpoint_every: 0,
        schedule: Preset::Quick.schedule(Some(iterations)),
        prune: None,
        method: None,
        clean: false,
        effects: Overrides::default(),
        tuning: None,
    }
}
