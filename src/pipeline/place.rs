//! Models and scenes with different local origins in one world.

use crate::edit::Region;
use crate::gaussians::Gaussians;
use crate::job::Error;
use crate::scene::{OpenOptions, Resize, Scene, origin};
use glam::DVec3;
use std::path::Path;

/// Moves the means of a model from the local origin `from` to a scene's.
pub fn place(model: &mut Gaussians, from: &mut [f64; 3], scene: &Path, images: Option<&Path>) -> Result<(), Error> {
    let near = *from == [0.0; 3] && origin::near(mean(model), 1.0) == DVec3::ZERO;
    if !near {
        let options = OpenOptions { images: images.map(Path::to_owned), ..OpenOptions::default() };
        place_in(model, from, &Scene::open(scene, &options)?);
    }
    Ok(())
}

/// Variant of [`place`] for an open scene. A model without a recorded origin is assumed to use the world's if that
/// brings it closer to the scene.
pub fn place_in(model: &mut Gaussians, from: &mut [f64; 3], scene: &Scene) {
    let shift = shift_to(model, *from, scene);
    if shift != DVec3::ZERO {
        model.shift(shift);
        *from = scene.origin.to_array();
    }
}

/// The shift that takes the means of a model, whose local origin is `from`, to a scene's coordinates.
pub fn shift_to(model: &Gaussians, from: [f64; 3], scene: &Scene) -> DVec3 {
    let (own, mean) = (DVec3::from(from), mean(model));
    let in_world = own != DVec3::ZERO || mean.distance(scene.origin) < mean.length();
    if in_world { own - scene.origin } else { DVec3::ZERO }
}

/// The positions, in the coordinates of a model with the local origin `from`, that at least `least` of a scene's cameras show.
///
/// # Errors
/// [`Error::Usage`] if the scene has fewer cameras.
pub fn seen(model: &Gaussians, from: [f64; 3], scene: &Scene, least: usize) -> Result<Region, Error> {
    let (shift, there) = (shift_to(model, from, scene), scene.views.len());
    if least > there {
        let root = scene.root.display();
        return Err(Error::Usage(format!(
            "a crop by at least {least} views: {root} has {there} views; lower --least-views"
        )));
    }
    let cameras = scene.views.iter().map(|view| view.camera_at(Resize::Full).relative_to(shift)).collect();
    Ok(Region::Views { cameras, least })
}

/// The local origin to subtract from cameras around `centre` that look at a model with this local origin: zero if the cameras are
/// nearer to the model's own coordinates than to the world's.
pub fn origin_of_cameras(centre: DVec3, origin: [f64; 3]) -> DVec3 {
    let origin = DVec3::from(origin);
    if centre.distance(origin) < centre.length() { origin } else { DVec3::ZERO }
}

/// Lets two models of one world, each with its local origin, lie as near to each other as their origins allow: a model without a record of
/// its origin may have world coordinates or local ones.
pub fn align(model: &mut Gaussians, [from, to]: [[f64; 3]; 2], original: &Gaussians) {
    let shift = DVec3::from(from) - DVec3::from(to);
    let apart = mean(original) - mean(model);
    if apart.distance(shift) < apart.length() {
        model.shift(shift);
    }
}

/// Mean of the means, in world units.
fn mean(model: &Gaussians) -> DVec3 {
    let means = &model.means;
    means.iter().map(|m| DVec3::from(m.map(f64::from))).sum::<DVec3>() / means.len().max(1) as f64
}
