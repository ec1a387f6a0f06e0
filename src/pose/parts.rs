//! The parts that photos fall into: models without a connection to each other. The largest becomes the scene.

use super::folder::Folder;
use super::{FEWEST, Matching, Posed, SHARES, panoramas, path};
use crate::job::Error;
use crate::scene::{Names, OpenOptions, Scene, median};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Focal lengths in widths of the photo that lenses have.
const FOCAL: (f64, f64) = (0.4, 3.0);
/// Mean reprojection error in pixels beyond which poses are doubtful.
const REPROJECTION: f64 = 1.5;

/// Takes the part with most photos as the scene's poses; `of_panoramas` says whether the photos are the faces of panoramas.
pub(super) fn choose(folder: &Folder, of_panoramas: bool) -> Result<Posed, Error> {
    let (photos, sequential) = (folder.photos().len(), folder.has_matches(Matching::Sequential));
    let mut found = Vec::new();
    models(&folder.models(), &mut found);
    let (mut parts, mut unread) = (Vec::new(), None);
    for path in found {
        match Scene::open(&path, &OpenOptions::default()) {
            Ok(scene) => parts.push((path, scene)),
            Err(error) => unread = Some(error),
        }
    }
    // Stable: of equal parts the program's first.
    parts.sort_by_key(|(_, scene)| std::cmp::Reverse(scene.views.len()));
    let Some((best, scene)) = parts.first() else {
        return Err(unread.map_or(Error::FewPoses { photos, posed: 0, sequential }, Error::from));
    };
    let posed = scene.views.len();
    if posed < FEWEST || (posed as f64) < SHARES.0 * photos as f64 {
        return Err(Error::FewPoses { photos, posed, sequential });
    }
    // Parts may share photos: one without a photo of its own is none.
    let mut taken: BTreeSet<&str> = scene.views.iter().map(|view| view.name.as_str()).collect();
    let mut others = Vec::new();
    for (path, scene) in &parts[1..] {
        let own = scene.views.iter().filter(|view| taken.insert(&view.name)).count();
        if own > 0 {
            others.push((path.clone(), own));
        } else if !best.starts_with(path) {
            let _ = fs::remove_dir_all(path);
        }
    }
    let mut nowhere = Names::default();
    for name in folder.photos().iter().filter(|name| !taken.contains(name.as_str())) {
        nowhere.add(name);
    }
    let mut warnings = doubts(scene, photos);
    warnings.extend(if of_panoramas { panoramas::apart(scene) } else { None });
    let nested = folder.photos().iter().any(|name| name.contains('/'));
    if !others.is_empty() && nested && sequential {
        warnings
            .push("photos of different folders were hardly compared; --matching exhaustive may connect them".into());
    }
    let posed = Posed { photos, posed, others, nowhere, warnings };
    put(best, &folder.poses())?;
    Ok(posed)
}

/// The model with most photos, and their number.
pub(super) fn largest(models: &Path) -> Option<(PathBuf, usize)> {
    let mut found = Vec::new();
    self::models(models, &mut found);
    let photos = |path: &PathBuf| Scene::open(path, &OpenOptions::default()).map_or(0, |scene| scene.views.len());
    let mut sized: Vec<(PathBuf, usize)> = found.into_iter().map(|path| (path.clone(), photos(&path))).collect();
    sized.sort_by_key(|(_, photos)| std::cmp::Reverse(*photos));
    sized.into_iter().next()
}

/// Model folders in and below a folder, by name.
fn models(at: &Path, found: &mut Vec<PathBuf>) {
    if ["bin", "txt"].iter().any(|e| at.join("images").with_extension(e).is_file()) {
        found.push(at.to_owned());
    }
    let entries = fs::read_dir(at).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|e| e.path()).filter(|p| p.is_dir()).collect();
    folders.sort();
    for folder in &folders {
        models(folder, found);
    }
}

/// Moves a model to its place, instead of an earlier one.
fn put(model: &Path, place: &Path) -> Result<(), Error> {
    let _ = fs::remove_dir_all(place);
    let moved = place.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::rename(model, place));
    moved.map_err(|source| Error::Write { path: place.to_owned(), source })
}

/// Reasons to doubt these poses.
fn doubts(scene: &Scene, photos: usize) -> Vec<String> {
    let mut doubts = Vec::new();
    if (scene.views.len() as f64) < SHARES.1 * photos as f64 {
        doubts.push("many photos have no pose: parts of the scene may be missing; add photos between them".to_owned());
    }
    let focal = |lens: &crate::scene::lens::Lens| lens.focal.x / f64::from(lens.width.max(lens.height));
    if let Some(view) = scene.views.iter().find(|v| !(FOCAL.0..=FOCAL.1).contains(&focal(&v.lens))) {
        let ratio = focal(&view.lens);
        doubts.push(format!("{} would have a focal length of {ratio:.2} widths; lenses rarely do", view.name));
    }
    let errors: Vec<f64> = scene.points.iter().map(|p| f64::from(p.error)).filter(|e| *e > 0.0).collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    if mean > REPROJECTION {
        doubts.push(format!("the mean reprojection error is {mean:.1} px: the photos may be blurred"));
    }
    let all: Vec<usize> = (0..scene.views.len()).collect();
    let centre = scene.centre(&all);
    let mut distances: Vec<f64> = scene.points.iter().map(|p| p.position.distance(centre)).collect();
    let path = path::doubt(scene.views.iter().map(|v| &v.camera), scene.extent(&all), median(&mut distances));
    doubts.extend(path.map(ToOwned::to_owned));
    doubts
}
