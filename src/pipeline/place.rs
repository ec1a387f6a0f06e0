//! Models and scenes with different local origins in one world.

use super::Error;
use crate::gaussians::Gaussians;
use crate::scene::{OpenOptions, Scene, origin};
use glam::DVec3;
use std::path::Path;

/// Moves the means of a model from the local origin `from` to a scene's.
pub fn place(model: &mut Gaussians, from: &mut [f64; 3], (scene, images): (&Path, Option<&Path>)) -> Result<(), Error> {
    let near = *from == [0.0; 3] && origin::near(mean(model), 1.0) == DVec3::ZERO;
    if !near {
        let options = OpenOptions { images: images.map(Path::to_owned), ..OpenOptions::default() };
        place_in(model, from, &Scene::open(scene, &options)?);
    }
    Ok(())
}

/// As [`place`]. A model without a recorded origin is assumed to use the world's if that brings it closer to the scene.
pub fn place_in(model: &mut Gaussians, from: &mut [f64; 3], scene: &Scene) {
    let (own, mean) = (DVec3::from(*from), mean(model));
    let in_world = own != DVec3::ZERO || mean.distance(scene.origin) < mean.length();
    if in_world && own != scene.origin {
        model.shift(own - scene.origin);
        *from = scene.origin.to_array();
    }
}

/// Mean of the means, in world units.
fn mean(model: &Gaussians) -> DVec3 {
    let means = &model.means;
    means.iter().map(|m| DVec3::from(m.map(f64::from))).sum::<DVec3>() / means.len().max(1) as f64
}
