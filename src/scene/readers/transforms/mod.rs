//! Blender's transforms_{train,val,test}.json; instant-ngp's and nerfstudio's transforms.json.
//!
//! Poses are camera-to-world with OpenGL's camera axes. World coordinates are the file's: nerfstudio's
//! `applied_transform` (the difference from COLMAP's) is not undone, and its point cloud lies in the same world.
//! instant-ngp's `scale`, `offset` and `aabb_scale` concern its own volume only and are ignored.

mod fields;
mod intrinsics;

use std::collections::{HashMap, HashSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::files::Folders;
use super::lookup::Lookup;
use super::masks::Masks;
use super::names::{above, tidy};
use super::notes::no_lens;
use super::repeated::no_split;
use super::tree::reduction;
use super::{Listing, clouds, colmap, files, point_ply, pose};
use crate::scene::lens::Lens;
use crate::scene::view::{Role, View};
use crate::scene::{Error, Names, OpenOptions, SceneKind, Skipped};
use crate::wording::counted;
use fields::{Frame, Whole, fields, movement, name_of, with_matrices, without_frames, without_nan};
use intrinsics::Intrinsics;

/// Difference of a side from that of eight times its smaller copy.
const ROUNDED: f64 = 8.0;
/// The folder of photos that frames name, and those of smaller copies that may stand for it, the largest first.
const COPIES: [&str; 4] = ["images", "images_2", "images_4", "images_8"];

/// Gathers frames of one or three files.
#[derive(Default)]
struct Reader {
    root: PathBuf,
    images: Option<PathBuf>,
    /// The first of `COPIES` that holds a photo of the frames.
    folder: Option<&'static str>,
    /// Folders of names of which a photo is there, and its format. In others, grey pictures may be photos that are listed in another format; none while
    /// that is decided.
    there: Option<HashMap<String, String>>,
    /// True for a file whose camera axes are OpenCV's.
    has_opencv_axes: bool,
    /// Radius in pixels of the circle that the file's photos show.
    crop_radius: Option<f64>,
    views: Vec<View>,
    skipped: Skipped,
    /// The first size found, for views without a size of their own.
    usual_size: Option<(u32, u32)>,
    camera_ids: HashMap<Vec<u64>, u32>,
    /// Photos and masks of the capture, by names that differ from theirs.
    lookup: Lookup,
    /// For masks, depth maps and clouds that the file lists.
    folders: Folders,
    /// Frames that the file itself calls bad.
    bad_frames: usize,
    /// Frames of a rolling shutter, which have a second pose.
    moving_frames: usize,
    /// Frames that are called a fisheye's and have another camera model.
    called_fisheye: usize,
    /// Photos of frames that are not used.
    left_out: Vec<PathBuf>,
    /// Frames whose lens cannot be used, and the first one's fault.
    faulty: Names,
    fault: Option<Error>,
}

/// Reads the transforms file `path` of the scene at `root`, for Blender with its companion files. Photos that are not there are
/// looked for in all of `outer`.
pub(super) fn read(root: &Path, outer: &Path, path: &Path, options: &OpenOptions) -> Result<Listing, Error> {
    let images = options.images.as_ref().map(|asked| files::image_folder(root, asked)).transpose()?;
    let lookup = Lookup::of(outer);
    let there = Some(HashMap::new());
    let mut reader = Reader { root: root.to_owned(), images, lookup, there, ..Reader::default() };
    let mut points = Vec::new();
    let sisters = [
        ("transforms_train.json", Role::Train),
        ("transforms_val.json", Role::Validation),
        ("transforms_test.json", Role::Test),
    ];
    let kind = if sisters.iter().any(|(name, _)| path.file_name().is_some_and(|n| n.eq_ignore_ascii_case(name))) {
        for (name, role) in sisters {
            let sister = files::child(root, name);
            if sister.is_file() {
                reader.file(&sister, role)?;
            }
        }
        SceneKind::Blender
    } else {
        let whole = reader.file(path, Role::Unsaid)?;
        if let Some(named) = whole.ply_file_path {
            let ply = reader.folders.listed(root, &named);
            if ply.is_file() {
                points = clouds::usable(point_ply::read(&ply)?, &mut reader.skipped);
            } else {
                reader.skipped.notes.push(format!("{}, named by ply_file_path, does not exist", ply.display()));
            }
        }
        SceneKind::Transforms
    };
    let Reader { mut views, mut skipped, images, bad_frames, moving_frames, called_fisheye, faulty, left_out, .. } =
        reader;
    if let Some(error) = reader.fault {
        if views.is_empty() {
            return Err(error);
        }
        skipped.notes.push(no_lens(&faulty, &error));
    }
    for (count, what) in [
        (bad_frames, "that the file calls bad (is_bad)"),
        (moving_frames, "with a pose at the end of the exposure (transform_matrix_end), which is not used"),
        (called_fisheye, "whose is_fisheye contradicts their camera_model, which counts"),
    ] {
        skipped.notes.extend((count > 0).then(|| format!("{} {what}", counted(count, "frame"))));
    }
    let train = files::child(root, "transforms_train.json");
    if kind == SceneKind::Transforms && train.is_file() && train != path {
        skipped.choices.push(format!("the poses in {} are used, not those in {}", path.display(), train.display()));
    }
    if points.is_empty() {
        points = clouds::beside(&[root], &mut skipped);
        let sparse = files::child(root, "colmap/sparse");
        if points.is_empty()
            && let Some((model, _)) = colmap::largest(&sparse, colmap::models(&sparse))
        {
            skipped
                .notes
                .push(format!("no points: to use those of {} and its poses, give it instead", model.display()));
        }
    }
    find_masks(root, images.as_deref(), &mut views, &mut skipped);
    let photos = images.is_none().then(|| folder_of(root, &views)).flatten();
    let views = (0..).zip(views).collect();
    Ok(Listing { kind, root: root.to_owned(), source: path.to_owned(), views, points, skipped, photos, left_out })
}

impl Reader {
    fn file(&mut self, path: &Path, role: Role) -> Result<Whole, Error> {
        let text = files::read_text(path)?;
        // Writers in Python know numbers that JSON does not.
        let json: Value = serde_json::from_str(&text)
            .or_else(|_| serde_json::from_str(&without_nan(&text)))
            .map_err(|e| Error::malformed(path, format!("line {}", e.line()), format!("is not JSON: {e}")))?;
        let Some(frames) = json.get("frames").and_then(Value::as_array) else {
            return Err(Error::malformed(path, "the top level", without_frames(&json)));
        };
        let top = |what: String| Error::malformed(path, "the top level", what);
        let common = Intrinsics::of(&json).map_err(top)?;
        let whole = Whole::of(&json).map_err(top)?;
        if role == Role::Unsaid {
            with_matrices(frames.iter().chain(&whole.test_frames)).map_err(top)?;
        }
        self.has_opencv_axes = whole.from_na;
        self.crop_radius = whole.fisheye_crop_radius.filter(|radius| *radius > 0.0);
        self.choose_folder(frames.iter().chain(&whole.test_frames));
        let moved = movement(&json).filter(|note| !self.skipped.notes.contains(note));
        self.skipped.notes.extend(moved);
        let mut roles: HashMap<String, Role> = HashMap::new();
        let mut doubtful = HashSet::new();
        for (names, role) in [
            (&whole.val_filenames, Role::Validation),
            (&whole.test_filenames, Role::Test),
            (&whole.train_filenames, Role::Train),
        ] {
            for name in names.iter().map(|name| tidy(name)) {
                if roles.insert(name.clone(), role).is_some_and(|other| other != role && role == Role::Train) {
                    doubtful.insert(name);
                }
            }
        }
        if !doubtful.is_empty() {
            self.skipped.notes.push(no_split(doubtful.len()));
            roles.extend(doubtful.into_iter().map(|name| (name, Role::Unsaid)));
        }
        let listed = roles.len();
        let step = whole.depth_unit_scale_factor.or(whole.integer_depth_scale).filter(|step| *step > 0.0);
        let names: HashSet<String> = frames.iter().filter_map(name_of).collect();
        // As in nerfstudio, frames that no list has are then not used.
        let by_lists = whole.train_filenames.iter().any(|name| names.contains(&tidy(name)));
        let mut unlisted = Names::default();
        let read = self.views.len();
        let own = if whole.test_frames.is_empty() { role } else { Role::Train };
        for (list, frames, role) in [("frame", frames, own), ("test_frames, frame", &whole.test_frames, Role::Test)] {
            for (i, json) in frames.iter().enumerate() {
                let name = name_of(json).filter(|name| by_lists && role != Role::Test && !roles.contains_key(name));
                if let Some(name) = name {
                    unlisted.add(&name);
                    self.left_out.push(self.usual(&name));
                    continue;
                }
                self.frame((path, format!("{list} {}", i + 1)), json, &common, (&roles, role), frames)?;
            }
        }
        self.views[read..].iter_mut().for_each(|view| view.depth_step = step);
        self.skipped.notes.extend((unlisted.count > 0).then(|| {
            let photos = counted(unlisted.count, "photo");
            format!("{photos} in none of the lists of train_filenames, val_filenames and test_filenames, not used ({unlisted})")
        }));
        let found = roles.keys().filter(|name| names.contains(*name)).count();
        if found < listed {
            self.skipped.notes.push(format!(
                "{} of {listed} in train_filenames, val_filenames and test_filenames match no frame's file_path",
                listed - found
            ));
        }
        Ok(whole)
    }

    /// Adds the view of a frame, whose role is `role` unless the file's lists say another.
    fn frame(
        &mut self,
        (path, record): (&Path, String),
        json: &Value,
        common: &Intrinsics,
        (roles, role): (&HashMap<String, Role>, Role),
        all: &[Value],
    ) -> Result<(), Error> {
        let mut record = record;
        let wrong = |record: &str, what: String| Error::malformed(path, record, what);
        let frame: Frame = fields(json).map_err(|what| wrong(&record, what))?;
        if frame.is_bad {
            self.bad_frames += 1;
            return Ok(());
        }
        let own = Intrinsics::of(json).map_err(|what| wrong(&record, what))?;
        let name = tidy(&frame.file_path);
        record = format!("{record} ({name:?})");
        if frame.is_unposed() {
            self.skipped.bad_poses.add(&name);
            return Ok(());
        }
        self.moving_frames += usize::from(json.get("transform_matrix_end").is_some_and(|end| !end.is_null()));
        let Some(mut rows) = pose::rows(frame.matrix()).filter(|_| !name.is_empty()) else {
            return Err(wrong(&record, "needs a file_path and a transform_matrix of 4 x 4 numbers".to_owned()));
        };
        pose::divide(&mut rows).map_err(|what| wrong(&record, what))?;
        if self.has_opencv_axes {
            pose::opencv_to_opengl(&mut rows);
        }
        let usual = self.usual(&name);
        let intrinsics = own.over(common);
        self.called_fisheye += usize::from(intrinsics.contradicts_itself());
        let photo = || files::photo_size(&usual).map(|size| self.whole_size(&name, &usual, size));
        let size = own.size_of_frame(common, photo).map_err(|what| wrong(&record, what))?;
        if let (Some((side, length)), Some((w, h))) = (intrinsics.lone_side(), size)
            && (length - f64::from(if side == "w" { w } else { h })).abs() > ROUNDED
        {
            let what =
                format!("gives {side} alone, and {length} is not that of {}: give both w and h", usual.display());
            return Err(wrong(&record, what));
        }
        // Blender's files give no size; a frame whose photo is absent has the size of the others.
        self.usual_size = self.usual_size.or(size).or_else(|| self.first_size(all));
        let Some((width, height)) = size.or(self.usual_size) else {
            let what = format!("gives neither w nor h, and {} does not exist; add them", usual.display());
            return Err(wrong(&record, what));
        };
        let model = intrinsics.model().map_err(|what| wrong(&record, what))?;
        let lens = match intrinsics.lens(model, width, height) {
            Ok(lens) => lens,
            Err(what) => {
                self.faulty.add(&name);
                self.left_out.push(usual);
                self.fault.get_or_insert_with(|| wrong(&record, what));
                return Ok(());
            }
        };
        let Some(pose) = pose::from_opengl(&rows) else {
            self.skipped.bad_poses.add(&name);
            if pose::is_mirrored(&rows) {
                self.skipped.mirrored_poses.add(&name);
            }
            return Ok(());
        };
        let camera_id = self.camera_id(&lens);
        let (mask, depth) = (frame.mask_path, frame.depth_file_path.or(frame.depth_path));
        let mask = listed(&mut self.folders, &self.root, mask.as_deref(), &mut self.skipped.missing_masks);
        let depth = listed(&mut self.folders, &self.root, depth.as_deref(), &mut self.skipped.missing_depths);
        let role = roles.get(&name).copied().unwrap_or(role);
        let image = self.photo(&name, usual);
        let circle = self.crop_radius.map(|radius| radius / f64::from(lens.width));
        self.views.push(View { image, mask, circle, depth, camera_id, role, ..View::new(name, lens, pose) });
        Ok(())
    }

    /// Decides, unless that was done, which folder stands for images/, the first of `COPIES` that holds one of these frames, and where
    /// grey pictures may be photos.
    fn choose_folder<'a>(&mut self, frames: impl Iterator<Item = &'a Value>) {
        let names: Vec<String> = frames.filter_map(name_of).collect();
        let of_images = || names.iter().filter(|name| name.starts_with("images/"));
        let holds = |folder: &&str| of_images().any(|name| self.placed(name, folder).is_file());
        self.folder = self.folder.or_else(|| COPIES.into_iter().find(holds));
        let mut there = self.there.take().unwrap_or_default();
        let found = |name: &str| Some(self.photo(name, self.usual(name))).filter(|photo| photo.is_file());
        there.extend(files::folders_there(names.iter().map(String::as_str), found));
        self.there = Some(there);
    }

    /// The format of the photos that are there in the folder of a frame's.
    fn known(&self, name: &str) -> Option<&str> {
        self.there.as_ref().map_or(files::STRICT, |there| there.get(above(name)).map(String::as_str))
    }

    /// The photo of a frame as listed, with this folder in place of images/.
    fn placed(&self, name: &str, folder: &str) -> PathBuf {
        let inner = name.strip_prefix("images/").map(|inner| self.root.join(folder).join(inner));
        files::find_photo(&[inner.unwrap_or_else(|| self.root.join(name))], self.known(name))
    }

    /// The photo of a frame as listed, in the capture's folder of smaller copies, or the one that must be meant.
    fn usual(&self, name: &str) -> PathBuf {
        let listed = self.placed(name, self.folder.unwrap_or("images"));
        if listed.is_file() {
            return listed;
        }
        self.lookup.find(name, self.known(name)).map_or(listed, |found| self.lookup.folder().join(found))
    }

    /// The size of a frame's photo, of which a smaller copy of this size was found.
    fn whole_size(&self, name: &str, found: &Path, (width, height): (u32, u32)) -> (u32, u32) {
        let folder = found.strip_prefix(&self.root).ok().and_then(|path| path.iter().next()).and_then(OsStr::to_str);
        let factor = folder.filter(|_| name.starts_with("images/")).map_or(1, reduction);
        (width.saturating_mul(factor), height.saturating_mul(factor))
    }

    /// The size of the first photo that exists.
    fn first_size(&self, frames: &[Value]) -> Option<(u32, u32)> {
        frames.iter().find_map(|frame| files::photo_size(&self.usual(&name_of(frame)?)))
    }

    /// The photo of a frame: as listed, or in the requested folder under its name without the first folder, its whole
    /// name or its last part.
    fn photo(&self, name: &str, usual: PathBuf) -> PathBuf {
        let Some(folder) = &self.images else { return usual };
        let inner = name.split_once('/').map_or(name, |(_, rest)| rest);
        let last = name.rsplit('/').next().unwrap_or(name);
        files::find_photo(&[inner, name, last].map(|n| folder.join(n)), self.known(name))
    }

    /// The number of the physical camera: equal lenses share one.
    fn camera_id(&mut self, lens: &Lens) -> u32 {
        let next = self.camera_ids.len() as u32;
        *self.camera_ids.entry(lens.key()).or_insert(next)
    }
}

/// The file that a frame lists; if it does not exist, `missing` counts it.
fn listed(folders: &mut Folders, root: &Path, name: Option<&str>, missing: &mut Names) -> Option<PathBuf> {
    let name = name?;
    let file = folders.listed(root, name);
    if file.is_file() {
        return Some(file);
    }
    missing.add(name);
    None
}

/// Finds the masks of views for which none is listed: in the folder of photos that was asked for, otherwise in the capture.
fn find_masks(root: &Path, images: Option<&Path>, views: &mut [View], skipped: &mut Skipped) {
    let inner = |view: &View| {
        let found = images.and_then(|images| view.image.strip_prefix(images).ok()).filter(|_| view.image.is_file());
        match (found, images, view.name.split_once('/')) {
            (Some(found), ..) => tidy(&found.to_string_lossy()),
            (None, Some(_), Some((_, inner))) => inner.to_owned(),
            _ => view.name.clone(),
        }
    };
    let names: Vec<String> = views.iter().map(inner).collect();
    let masks = Masks::of(root, images.unwrap_or(root), names.iter().map(String::as_str));
    for (view, name) in views.iter_mut().zip(&names).filter(|(view, _)| view.mask.is_none()) {
        view.mask = masks.find(name);
    }
    skipped.notes.extend(masks.doubt());
}

/// The innermost folder of a capture that holds all photos of its views, or images if that does; none if it is the capture and no photo lies in it directly,
/// since what does is something else.
fn folder_of(root: &Path, views: &[View]) -> Option<PathBuf> {
    let usual = files::child(root, "images");
    let mut folders = views.iter().filter(|view| view.image.is_file()).filter_map(|view| view.image.parent());
    let Some(first) = folders.clone().next() else { return Some(usual).filter(|usual| usual.is_dir()) };
    let holds = |common: &Path| folders.clone().all(|folder| folder.starts_with(common));
    let common = first.ancestors().find(|common| holds(common))?;
    if common.starts_with(&usual) {
        return Some(usual);
    }
    let is_own = common.starts_with(root) && (common != root || folders.any(|folder| folder == root));
    is_own.then(|| common.to_owned())
}
