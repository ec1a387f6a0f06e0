//! COLMAP models: cameras, images and points3D, binary or text.

mod binary;
mod split;
mod text;

use crate::extension::has_extension;
use crate::sample::evenly;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};

use self::split::Roles;
use super::lookup::Lookup;
use super::masks::Masks;
use super::names;
use super::notes::no_lens;
use super::tree::photo_folders;
use super::{Listing, clouds, files, pose};
use crate::scene::lens::{Lens, LensModel};
use crate::scene::view::View;
use crate::scene::{Error, Misfit, Names, OpenOptions, Point, SceneKind, Skipped};
use crate::wording::counted;

/// Cameras by COLMAP's ids; the fault of one that cannot be used counts only where an image has it.
type Cameras = HashMap<u32, Result<Lens, Error>>;

/// A pixel of a photo, and the id of the point seen there.
type Mark = (DVec2, u64);

/// A row of images.bin or images.txt.
struct ImageRow {
    id: u32,
    quaternion: [f64; 4],
    translation: [f64; 3],
    camera_id: u32,
    name: String,
    /// Its 2D points that name a point, if they were asked for.
    marks: Vec<Mark>,
}

/// A row of points3D.bin or points3D.txt; the track names images by id.
struct PointRow {
    id: u64,
    position: [f64; 3],
    colour: [u8; 3],
    error: f64,
    track: Vec<u32>,
}

/// True if a folder holds a model, binary or text.
pub(super) fn is_model(folder: &Path) -> bool {
    ["cameras", "images"].iter().all(|name| part(folder, name).is_file())
}

/// A file of a model: binary, unless only the text has both cameras and images, or only the text is there.
fn part(model: &Path, name: &str) -> PathBuf {
    let file = |name: &str, extension: &str| files::child(model, &format!("{name}.{extension}"));
    let has = |extension: &str| ["cameras", "images"].iter().all(|name| file(name, extension).is_file());
    let order = if has("bin") || !has("txt") { ["bin", "txt"] } else { ["txt", "bin"] };
    let [first, other] = order.map(|extension| file(name, extension));
    if first.is_file() || !other.is_file() { first } else { other }
}

/// Reads a file of a model by the reader of its kind.
fn read_part<T>(
    path: &Path,
    binary: impl Fn(&Path) -> Result<T, Error>,
    text: impl Fn(&Path) -> Result<T, Error>,
) -> Result<T, Error> {
    if has_extension(path, &["txt"]) { text(path) } else { binary(path) }
}

/// Largest number of a photo's 2D points by which its pose is compared with the points.
const MARKS: usize = 500;

/// At most [`MARKS`] of a photo's 2D points.
fn few(marks: Vec<Mark>) -> Vec<Mark> {
    if marks.len() <= MARKS { marks } else { evenly(&marks, MARKS).copied().collect() }
}

fn read_images(path: &Path, marks: bool) -> Result<Vec<ImageRow>, Error> {
    read_part(path, |path| binary::images(path, marks), |path| text::images(path, marks))
}

/// The models in `sparse` itself and in its subfolders, or, if there are none, one level deeper.
pub(super) fn models(sparse: &Path) -> Vec<PathBuf> {
    let inner = |folder: &Path| files::inside(folder).into_iter().filter(|path| path.is_dir());
    let folders: Vec<PathBuf> = inner(sparse).collect();
    let all = folders.iter().cloned().chain([sparse.to_owned()]);
    let models: Vec<PathBuf> = all.filter(|path| is_model(path)).collect();
    if models.is_empty() {
        folders.iter().flat_map(|folder| inner(folder)).filter(|path| is_model(path)).collect()
    } else {
        models
    }
}

/// The model with the most images of those found in the folder `place`, and what to tell if there are several.
pub(super) fn largest(place: &Path, mut models: Vec<PathBuf>) -> Option<(PathBuf, Option<String>)> {
    // The folder itself comes last.
    models.sort_by_key(|model| (model == place, model.clone()));
    if models.len() < 2 {
        return models.pop().map(|only| (only, None));
    }
    let mut sized: Vec<(usize, PathBuf)> = models.into_iter().map(|model| (images_of(&model), model)).collect();
    // Stable: of equal ones the first.
    sized.sort_by_key(|(images, _)| std::cmp::Reverse(*images));
    let name = |model: &Path| match model.strip_prefix(place) {
        Ok(inner) if model != place => inner.display().to_string(),
        _ => model.file_name().unwrap_or_default().to_string_lossy().into_owned(),
    };
    let told = |(images, model): &(usize, PathBuf)| format!("{} ({})", name(model), counted(*images, "photo"));
    let rest: Vec<String> = sized[1..].iter().map(told).collect();
    let (shown, first) = (place.display(), told(&sized[0]));
    let note = format!("{shown} holds {} models: {first} is used, not {}", sized.len(), rest.join(", "));
    Some((sized.swap_remove(0).1, Some(note)))
}

/// The number of a model's images; 0 if its file cannot be read.
fn images_of(model: &Path) -> usize {
    read_images(&part(model, "images"), false).map_or(0, |rows| rows.len())
}

/// Reads the model in `model`, which belongs to the scene at `root`.
pub(super) fn read(root: &Path, model: &Path, options: &OpenOptions) -> Result<Listing, Error> {
    let [cameras_file, source, points_file] = ["cameras", "images", "points3D"].map(|name| part(model, name));
    let mut cameras = read_part(&cameras_file, binary::cameras, text::cameras)?;
    let rows = read_images(&source, options.check)?;
    // Cameras alone can be rendered; training then starts from random points.
    let points =
        if points_file.is_file() { read_part(&points_file, binary::points, text::points)? } else { Vec::new() };
    refuse_repeated(&rows, &points, &source)?;

    let root = if root == model { scene_of(model) } else { root.to_owned() };
    let images = photo_folder(&root, options, &rows)?;
    let mut photos = Photos::of(&images, &rows);
    let mut skipped = Skipped::default();
    let places: HashMap<u64, DVec3> = if options.check {
        points.iter().map(|row| (row.id, DVec3::from_array(row.position))).collect()
    } else {
        HashMap::new()
    };
    let mut roles = Roles::of(&root, model, &rows, &mut skipped);
    let mut views = Vec::with_capacity(rows.len());
    let (mut faulty, mut fault, mut left_out) = (Names::default(), None, Vec::new());
    for row in rows {
        let Some(role) = roles.find(&row.name) else {
            left_out.push(photos.find(row.name).1);
            continue;
        };
        let lens = match cameras.get(&row.camera_id) {
            Some(Ok(lens)) => *lens,
            Some(Err(_)) => {
                faulty.add(&row.name);
                fault = fault.or(Some(row.camera_id));
                left_out.push(photos.find(row.name).1);
                continue;
            }
            None => return Err(no_camera(&row, &source, &cameras_file)),
        };
        let Some(pose) = pose::from_quaternion(row.quaternion, row.translation) else {
            skipped.bad_poses.add(&row.name);
            continue;
        };
        let marks: Vec<(DVec2, DVec3)> =
            row.marks.iter().filter_map(|(at, id)| Some((*at, *places.get(id)?))).collect();
        let misfit = Misfit::of(&lens, pose, &marks);
        let (name, image) = photos.find(row.name);
        let view = View { image, misfit, camera_id: row.camera_id, role, ..View::new(name, lens, pose) };
        views.push((row.id, view));
    }
    skipped.notes.extend(roles.note());
    skipped.notes.extend(split::unread(&root));
    if let Some(Err(error)) = fault.and_then(|id| cameras.remove(&id)) {
        if views.is_empty() {
            return Err(error);
        }
        skipped.notes.push(no_lens(&faulty, &error));
    }
    let masks = Masks::of(&root, &images, views.iter().map(|(_, view)| view.name.as_str()));
    for (_, view) in &mut views {
        view.mask = masks.find(&view.name);
    }
    skipped.notes.extend(masks.doubt());
    skipped.choices.extend(elsewhere(&root, &images, options));
    let point = |row: PointRow| {
        let (position, error) = (DVec3::from_array(row.position), row.error as f32);
        Point { position, normal: None, colour: row.colour, error, track: row.track }
    };
    let mut points = clouds::usable(points.into_iter().map(point).collect(), &mut skipped);
    if points.is_empty() {
        let above = model.parent().filter(|above| above.starts_with(&root)).unwrap_or(&root);
        points = clouds::beside(&[model, above, &root], &mut skipped);
    }
    let kind = if has_extension(&source, &["txt"]) { SceneKind::ColmapText } else { SceneKind::ColmapBinary };
    let photos = options.images.is_none().then_some(images);
    Ok(Listing { kind, root, source, views, points, skipped, photos, left_out })
}

/// Refuses images with one id and different names if the track of a point names it.
fn refuse_repeated(rows: &[ImageRow], points: &[PointRow], source: &Path) -> Result<(), Error> {
    let (mut names, mut repeated) = (HashMap::<u32, &str>::new(), HashMap::<u32, [&str; 2]>::new());
    for ImageRow { id, name, .. } in rows {
        if let Some(other) = names.insert(*id, name).filter(|other| other != name) {
            repeated.entry(*id).or_insert([name.as_str(), other]);
        }
    }
    let named = points.iter().flat_map(|point| &point.track).find_map(|id| repeated.get_key_value(id));
    named.map_or(Ok(()), |(id, [name, other])| {
        let what = format!("has the id of image {other:?}, which points name; give each image its own");
        Err(Error::malformed(source, format!("image {id} ({name:?})"), what))
    })
}

/// The error of an image whose camera is not in the model's file of cameras.
fn no_camera(row: &ImageRow, source: &Path, cameras: &Path) -> Error {
    let record = format!("image {} ({:?})", row.id, row.name);
    Error::malformed(
        source,
        record,
        format!("refers to camera {}, which {} does not hold", row.camera_id, cameras.display()),
    )
}

/// The photos of a model, found by its names.
struct Photos<'a> {
    images: &'a Path,
    lookup: Lookup,
    /// Keys of the last parts of names that several images share.
    twins: HashSet<String>,
    /// Files that are some image's.
    taken: HashSet<String>,
    /// Folders of names of which a photo is there, and its format. In others, grey pictures may be photos that are listed in another format.
    there: HashMap<String, String>,
}

impl<'a> Photos<'a> {
    fn of(images: &'a Path, rows: &[ImageRow]) -> Self {
        let (lookup, twins) = (Lookup::of(images), names::twins(rows.iter().map(|row| row.name.as_str())));
        let taken = rows.iter().map(|row| row.name.clone()).collect();
        let found = |name: &str| {
            let listed = Some(files::find_photo(&[images.join(name)], files::STRICT)).filter(|photo| photo.is_file());
            listed.or_else(|| lookup.find(name, files::STRICT).map(|found| images.join(found)))
        };
        let there = files::folders_there(rows.iter().map(|row| row.name.as_str()), found);
        Self { images, lookup, twins, taken, there }
    }

    /// The name of an image's photo within the folder, and its path, whether it is there or not.
    fn find(&mut self, name: String) -> (String, PathBuf) {
        let known = self.there.get(names::above(&name)).map(String::as_str);
        let image = files::find_photo(&[self.images.join(&name)], known);
        if image.is_file() {
            return (name, image);
        }
        // A file that belongs to another view is not this one's, nor is one that may be another's as well.
        let own = |found: &str| {
            names::folder_key(found) == names::folder_key(&names::relative(&name))
                || !self.twins.contains(&names::key(names::last(&name)))
        };
        let found = self.lookup.find(&name, known).filter(|found| own(found) && self.taken.insert(found.clone()));
        let name = found.unwrap_or_else(|| names::relative(&name));
        let image = self.images.join(&name);
        (name, image)
    }
}

/// The scene of a model folder given by itself: the folder or the nearest of its three parents with a folder of photos.
fn scene_of(model: &Path) -> PathBuf {
    let absolute = std::path::absolute(model).unwrap_or_else(|_| model.to_owned());
    let has = |folder: &Path, names: &[&str]| names.iter().any(|name| files::child(folder, name).is_dir());
    let others = ["input", "photos", "rgb", "frames", "images_2", "images_4", "images_8"];
    // Further up than two, folders of the other names may be anyone's.
    let holds = |(steps, folder): &(usize, &Path)| has(folder, &["images"]) || (*steps < 3 && has(folder, &others));
    let found = absolute.ancestors().enumerate().take(4).find(holds).map(|(_, folder)| folder);
    found.unwrap_or(model).to_owned()
}

/// Names of folders that are photos' whoever made the capture.
const USUAL: [&str; 4] = ["images", "input", "photos", "rgb"];

/// A note on photos in a folder of another name, such as one of smaller copies.
fn elsewhere(root: &Path, images: &Path, options: &OpenOptions) -> Option<String> {
    let known = images == root || USUAL.iter().any(|name| files::child(root, name) == *images);
    (!known && options.images.is_none()).then(|| format!("the photos are those of {}", images.display()))
}

/// The folder that image names are relative to: as requested, otherwise images, otherwise input, the scene itself or another of
/// its folders if the first photos lie there.
fn photo_folder(root: &Path, options: &OpenOptions, rows: &[ImageRow]) -> Result<PathBuf, Error> {
    if let Some(asked) = &options.images {
        return files::image_folder(root, asked);
    }
    let usual = files::child(root, "images");
    let first = || rows.iter().take(files::FIRST);
    let named = |folder: &Path, known: Option<&str>| {
        first().filter(|row| files::find_photo(&[folder.join(&row.name)], known).is_file()).count()
    };
    if named(&usual, None) > 0 {
        return Ok(usual);
    }
    if usual.is_dir() {
        // Without the right to look into it, other folders would be taken for the photos'.
        std::fs::read_dir(&usual).map_err(|source| Error::Io { path: usual.clone(), source })?;
    }
    let known = USUAL[1..].iter().map(|name| files::child(root, name));
    let others: Vec<PathBuf> = known.chain([root.to_owned()]).chain(photo_folders(root)).collect();
    // A folder of renders may hold some of the names, and one of maps all; of equal ones the first.
    let counts = others.iter().map(|folder| ((named(folder, files::STRICT), named(folder, None)), folder));
    if let Some(((_, 1..), folder)) = counts.rev().max_by_key(|(count, _)| *count) {
        return Ok(folder.clone());
    }
    if usual.is_dir() {
        return Ok(usual);
    }
    let meant = |folder: &PathBuf| {
        let lookup = Lookup::of(folder);
        folder.is_dir() && first().any(|row| lookup.find(&row.name, None).is_some())
    };
    Ok(others.into_iter().find(meant).unwrap_or(usual))
}

/// The cameras of a file by their ids, which are refused if one is there twice. Each comes with its record.
fn cameras_of(path: &Path, read: impl Iterator<Item = (String, u32, Result<Lens, String>)>) -> Result<Cameras, Error> {
    let mut cameras = Cameras::new();
    for (record, id, lens) in read {
        let fault = |what: String| Error::malformed(path, record.clone(), what);
        if cameras.insert(id, lens.map_err(fault)).is_some() {
            return Err(fault(format!("camera {id} is listed twice; remove the wrong entry")));
        }
    }
    Ok(cameras)
}

/// The model with COLMAP's number; the fault names the models that the engine lacks.
fn model_of(id: i32) -> Result<LensModel, String> {
    LensModel::from_id(id).ok_or_else(|| LensModel::unsupported(&format!("number {id}"), LensModel::ALL))
}
