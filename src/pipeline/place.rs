//! Models and scenes with different local origins in one world.

use crate::edit::Region;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{Format, Loaded};
use crate::job::Error;
use crate::scene::{OpenOptions, Scene, View, origin};
use crate::wording::counted;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::Path;

/// Moves the means of a model from the local origin `from` to a scene's. Returns the [`doubt`] about one that was read in this format, but
/// none about a PLY near the world's origin: few of these have lost a comment, and it takes long to open a capture.
pub fn place(
    (model, from): (&mut Gaussians, &mut [f64; 3]),
    format: Option<Format>,
    scene: &Path,
    images: Option<&Path>,
) -> Result<Option<&'static str>, Error> {
    if is_near(model, *from) && format.is_none_or(|format| is_ply(format) || keeps_origins(format)) {
        return Ok(None);
    }
    let scene = open(scene, images)?;
    let doubt = format.and_then(|format| doubt_of(model, *from, format, &scene));
    place_in(model, from, &scene);
    Ok(doubt)
}

/// Variant of [`place`] for a model that was read.
pub fn place_read(loaded: &mut Loaded, scene: &Path, images: Option<&Path>) -> Result<Option<&'static str>, Error> {
    place((&mut loaded.gaussians, &mut loaded.origin), Some(loaded.format), scene, images)
}

fn open(scene: &Path, images: Option<&Path>) -> Result<Scene, Error> {
    Ok(Scene::open(scene, &OpenOptions { images: images.map(Path::to_owned), ..OpenOptions::default() })?)
}

/// True for a model without a local origin that lies near the world's: it lies as near to any scene's.
fn is_near(model: &Gaussians, from: [f64; 3]) -> bool {
    from == [0.0; 3] && origin::near(mean(model), 1.0) == DVec3::ZERO
}

/// The format that leaves most [`doubt`], of the formats of merged models that have no recorded local origin.
pub fn most_doubtful(formats: impl Iterator<Item = Format>) -> Option<Format> {
    formats.max_by_key(|format| (!keeps_origins(*format), !is_ply(*format)))
}

fn is_ply(format: Format) -> bool {
    matches!(format, Format::Ply | Format::CompressedPly)
}

/// True for formats whose record of a local origin cannot be lost: that of a PLY is a comment, which other programs drop, and the others
/// need a georeference.json beside the file.
fn keeps_origins(format: Format) -> bool {
    matches!(format, Format::Gltf | Format::Usd)
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

/// A warning, as a predicate, about a model whose record of a local origin may be lost: it is taken to have the scene's, which is another
/// than the world's.
pub fn doubt(loaded: &Loaded, scene: &Scene) -> Option<&'static str> {
    doubt_of(&loaded.gaussians, loaded.origin, loaded.format, scene)
}

fn doubt_of(model: &Gaussians, origin: [f64; 3], format: Format, scene: &Scene) -> Option<&'static str> {
    let is_guess = origin == [0.0; 3]
        && !keeps_origins(format)
        && scene.origin != DVec3::ZERO
        && shift_to(model, origin, scene) == DVec3::ZERO;
    let warning = "records no local origin, so the capture's is assumed; if its PLY comment `origin X Y Z` was lost, or a \
                   georeference.json names it, restore the comment, or put that file beside the model";
    is_guess.then_some(warning)
}

/// The positions, in the coordinates of a model with the local origin `from`, that at least `least` of a scene's photos show.
///
/// # Errors
/// [`Error::Usage`] if the scene has fewer photos.
pub fn seen(model: &Gaussians, from: [f64; 3], scene: &Scene, least: usize) -> Result<Region, Error> {
    let shift = shift_to(model, from, scene);
    let mut photos: BTreeMap<&str, Vec<View>> = BTreeMap::new();
    for view in &scene.views {
        let mut moved = view.clone();
        moved.camera = view.camera.relative_to(shift);
        photos.entry(view.photo_name()).or_default().push(moved);
    }
    if least > photos.len() {
        let (root, [wanted, there]) = (scene.root.display(), [least, photos.len()].map(|n| counted(n, "photo")));
        return Err(Error::Usage(format!("a crop by at least {wanted}: {root} has {there}; lower --least-views")));
    }
    Ok(Region::Views { photos: photos.into_values().collect(), least })
}

/// The local origin to subtract from cameras around `centre` that look at a model with this local origin: zero if the cameras are
/// nearer to the model's own coordinates than to the world's.
pub fn origin_of_cameras(centre: DVec3, origin: [f64; 3]) -> DVec3 {
    let origin = DVec3::from(origin);
    if centre.distance(origin) < centre.length() { origin } else { DVec3::ZERO }
}

/// Lets two models of one world, each with its local origin, lie as near to each other as their origins allow: a model without a record of
/// its origin may have world coordinates or local ones. Returns the shift of the model.
pub fn align(model: &mut Gaussians, [from, to]: [[f64; 3]; 2], original: &Gaussians) -> DVec3 {
    let shift = DVec3::from(from) - DVec3::from(to);
    let apart = mean(original) - mean(model);
    if apart.distance(shift) < apart.length() {
        model.shift(shift);
        shift
    } else {
        DVec3::ZERO
    }
}

/// Mean of the means, in world units.
fn mean(model: &Gaussians) -> DVec3 {
    let means = &model.means;
    means.iter().map(|m| DVec3::from(m.map(f64::from))).sum::<DVec3>() / means.len().max(1) as f64
}
