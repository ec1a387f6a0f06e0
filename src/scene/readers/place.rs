//! Location of a scene's poses: the given folder, or a subfolder.

use crate::extension::{folder_of, has_extension};
use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};

use super::files::{child, inside, photo_size, subfolders};
use super::foreign::{self, SUBFOLDERS};
use super::instead::{archive_in, instead};
use super::tree::{PhotoTree, unread};
use super::{colmap, photo_folder};
use crate::scene::view::is_panorama;
use crate::scene::{Error, OpenOptions};

/// The places where [`find`] looks, in this order.
const LOOKED_FOR: &str = "cameras.bin/.txt with images.bin/.txt (COLMAP) in it, in sparse/0 (or another number), sparse, \
                          colmap/sparse/0 and distorted/sparse/0, transforms.json, transforms_train.json, and for one folder \
                          that holds them";

/// The files that hold poses.
pub(super) enum Poses {
    /// The folder of a COLMAP model.
    Colmap(PathBuf),
    /// A transforms file.
    Transforms(PathBuf),
}

/// A scene's place.
pub(super) struct Place {
    /// Its folder.
    pub root: PathBuf,
    /// The folder in which it was found: below it, photos may lie.
    pub outer: PathBuf,
    /// Its poses.
    pub poses: Poses,
    /// A note on the choice for the user, if there was one.
    pub note: Option<String>,
}

/// Finds the scene at `path`, and reads nothing.
pub(super) fn find(path: &Path, options: &OpenOptions) -> Result<Place, Error> {
    std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    let folder = if path.is_file() { folder_of(path) } else { path };
    let nothing = |beside: String| match instead(path) {
        Some(what) => Error::Instead { path: path.to_owned(), what: what + &beside },
        None => Error::NoScene { root: path.to_owned(), looked_for: LOOKED_FOR, beside },
    };
    if path.is_file() && !is_part(path) {
        if has_extension(path, &["json"]) && instead(path).is_none() {
            return Ok(Place::of(folder, Poses::Transforms(path.to_owned())));
        }
        return Err(nothing(String::new()));
    }
    if let Some(place) = here(folder, options) {
        return Ok(place);
    }
    let mut inner = within(folder);
    if inner.is_empty() {
        inner = within(&child(folder, "dense"));
    }
    if inner.len() > 1 {
        let names = inner.into_iter().map(|place| name_in(folder, &place.root)).collect();
        return Err(Error::SeveralScenes { root: folder.to_owned(), names });
    }
    if let Some(place) = inner.pop() {
        let note = format!("no poses in {} itself: {} in it is used", folder.display(), name_in(folder, &place.root));
        return Ok(Place { outer: folder.to_owned(), note: Some(place.note.unwrap_or(note)), ..place });
    }
    let images = photo_folder(folder, options.images.as_deref());
    let deeper = || deeper(folder, images.as_deref());
    let beside = above(folder).or_else(deeper).unwrap_or_else(|| foreign::poses(folder));
    match images {
        Some(images) => {
            let photos = PhotoTree::of(&images).names.len();
            Err(Error::NoPoses { root: folder.to_owned(), images, photos, beside })
        }
        None => Err(nothing(beside)),
    }
}

/// An error of [`find`] that also tells of an archive that may hold poses, of photos that are not read, and of those that may be panoramas.
pub(super) fn told(error: Error) -> Error {
    let Error::NoPoses { root, images, photos, beside } = error else { return error };
    let packed = archive_in(&root).filter(|_| beside.is_empty());
    let packed = packed.map(|zip| format!("; if {} holds some, unpack it", zip.display())).unwrap_or_default();
    let tree = PhotoTree::with_twins(&images);
    let unread = unread(&tree.unread).map(|unread| format!("; {unread}")).unwrap_or_default();
    let mut sizes = tree.names.iter().filter_map(|name| photo_size(&images.join(name))).peekable();
    let are_panoramas = sizes.peek().is_some() && sizes.all(is_panorama);
    let hint = "; all photos are twice as wide as high: for panoramas (360°), use `run` or `pose` with --panoramas";
    let hint = if are_panoramas { hint } else { "" };
    Error::NoPoses { root, images, photos, beside: beside + &packed + &unread + hint }
}

/// True for the path of a COLMAP model's file.
fn is_part(path: &Path) -> bool {
    let named = |name: &&str| path.file_stem().is_some_and(|stem| stem.eq_ignore_ascii_case(name));
    ["cameras", "images", "points3D"].iter().any(named) && has_extension(path, &["bin", "txt"])
}

/// A clause on the poses beside a folder of photos.
fn above(folder: &Path) -> Option<String> {
    let above = match folder.components().next_back()? {
        Component::Normal(_) => folder_of(folder).to_owned(),
        Component::CurDir => PathBuf::from(".."),
        _ => folder.join(".."),
    };
    here(&above, &OpenOptions::default())?;
    Some(format!("; poses lie beside it: give {} to use them", above.display()))
}

/// A clause on scenes in the folders of a folder's subfolders, of which none is chosen; photos that do not lie in them are in `images`.
fn deeper(folder: &Path, images: Option<&Path>) -> Option<String> {
    let deeper = subfolders(folder).take(SUBFOLDERS).flat_map(|path| subfolders(&path).collect::<Vec<_>>());
    let scenes = deeper.take(SUBFOLDERS).filter_map(|path| here(&path, &OpenOptions::default()));
    let roots: Vec<PathBuf> = scenes.map(|place| place.root).collect();
    if roots.is_empty() {
        return None;
    }
    let images = images.filter(|_| roots.iter().all(|root| photo_folder(root, None).is_none()));
    let with = images.map(|images| format!(", with `--images {}`", innermost(images).display())).unwrap_or_default();
    let found: Vec<String> = roots.iter().map(|root| root.display().to_string()).collect();
    let one = if found.len() == 1 { "it" } else { "one of these" };
    Some(format!("; poses lie in {}: give {one} to use them{with}", found.join(", ")))
}

/// The innermost folder that holds all photos of a folder.
fn innermost(images: &Path) -> PathBuf {
    let photos: Vec<PathBuf> = PhotoTree::of(images).names.iter().map(|name| images.join(name)).collect();
    let holds = |folder: &&Path| photos.iter().all(|photo| photo.starts_with(folder));
    photos.first().and_then(|first| first.ancestors().skip(1).find(holds)).unwrap_or(images).to_owned()
}

impl Place {
    fn of(root: &Path, poses: Poses) -> Self {
        Self { root: root.to_owned(), outer: root.to_owned(), poses, note: None }
    }

    /// True if COLMAP writes this model's undistorted photos to `dense`: sparse/1 belongs to dense/1.
    fn is_undistorted_in(&self, dense: &Path) -> bool {
        let Poses::Colmap(model) = &self.poses else { return false };
        model.file_name() == dense.file_name() || model.ends_with("sparse")
    }
}

/// The path of a folder within another.
fn name_in(folder: &Path, inner: &Path) -> String {
    inner.strip_prefix(folder).unwrap_or(inner).display().to_string()
}

/// The last part of a path.
fn own_name(path: &Path) -> Cow<'_, str> {
    path.file_name().unwrap_or_default().to_string_lossy()
}

/// The scene whose poses lie in a folder.
fn here(folder: &Path, options: &OpenOptions) -> Option<Place> {
    let colmap = |root: &Path, place: &Path| {
        let (model, note) = colmap::largest(place, colmap::models(place))?;
        Some(Place { note, ..Place::of(root, Poses::Colmap(model)) })
    };
    if colmap::is_model(folder) {
        return Some(Place::of(folder, Poses::Colmap(folder.to_owned())));
    }
    if let Some(name) = folder.file_name().filter(|name| name.eq_ignore_ascii_case("sparse"))
        && let Some(place) = colmap(folder_of(folder), &folder_of(folder).join(name))
    {
        return Some(place);
    }
    if let Some(place) = colmap(folder, &child(folder, "sparse")) {
        // Where only undistorted photos are left, the cameras are those beside them.
        let elsewhere = photo_folder(folder, options.images.as_deref()).is_none();
        let undistorted = || {
            let dense = child(folder, "dense");
            here(&dense, &OpenOptions::default())
                .or_else(|| within(&dense).into_iter().find(|dense| place.is_undistorted_in(&dense.root)))
        };
        if let Some(dense) = if elsewhere { undistorted() } else { None } {
            let note = format!("the undistorted photos of {} and their cameras are used", name_in(folder, &dense.root));
            return Some(Place { note: Some(note), ..dense });
        }
        let other = child(folder, "transforms.json").is_file();
        let also = other.then(|| "the poses in sparse are used, not those in transforms.json".to_owned());
        let notes: Vec<String> = place.note.iter().cloned().chain(also).collect();
        return Some(Place { note: (!notes.is_empty()).then(|| notes.join("; ")), ..place });
    }
    let named = ["transforms.json", "transforms_train.json"].map(|name| child(folder, name));
    if let Some(file) = named.into_iter().find(|file| file.is_file()) {
        return Some(Place::of(folder, Poses::Transforms(file)));
    }
    let others = ["colmap/sparse", "distorted/sparse"].iter().find_map(|place| colmap(folder, &child(folder, place)));
    others.or_else(|| numbered(folder))
}

/// The scene with the largest model in folders such as sparse_16, as InstantSplat calls them by their number of photos.
fn numbered(folder: &Path) -> Option<Place> {
    let sparse = inside(folder).into_iter().filter(|path| own_name(path).to_lowercase().starts_with("sparse_"));
    let (model, note) = colmap::largest(folder, sparse.flat_map(|path| colmap::models(&path)).collect())?;
    let only = || format!("the poses are those of {}", name_in(folder, &model));
    let note = Some(note.unwrap_or_else(only));
    Some(Place { note, ..Place::of(folder, Poses::Colmap(model)) })
}

/// The scenes in a folder's subfolders, sorted, without results of this program.
fn within(folder: &Path) -> Vec<Place> {
    subfolders(folder).filter_map(|path| here(&path, &OpenOptions::default())).collect()
}
