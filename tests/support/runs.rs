//! Small runs on synthetic scenes.

use qirf_vk::effects::Overrides;
use qirf_vk::job::{Preset, RunConfig};
use std::path::Path;

/// A dense run of the quick preset on a scene's own photos, without effects, checkpoints and prunes.
pub fn config(scene: &Path, iterations: u32) -> RunConfig {
    RunConfig {
        sh_degree: 1,
        max_gaussians: 3000,
        checkpoint_every: 0,
        schedule: Preset::Quick.schedule(Some(iterations)),
        effects: Overrides::default(),
        ..RunConfig::of(scene.to_owned(), Preset::Quick)
    }
}
