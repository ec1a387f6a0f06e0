//! Blender's transforms_{train,val,test}.json; instant-ngp's and nerfstudio's transforms.json.
//!
//! Poses are camera-to-world with OpenGL's camera axes. World coordinates are the file's: nerfstudio's
//! `applied_transform` (the difference from COLMAP's) is not undone, and its point cloud lies in the same world.
//! instant-ngp's `scale`, `offset` and `aabb_scale` concern its own volume only and are ignored.

mod intrinsics;

use std::collections::{HashMap, HashSet};
use std::ffi::OsStr;
use std::iter;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::files::Folders;
use super::lookup::Lookup;
use super::masks::Masks;
use super::names::tidy;
use super::tree::reduction;
use super::{ListedView, Listing, clouds, files, point_ply, pose};
use crate::scene::lens::Lens;
use crate::scene::view::Role;
use crate::scene::{Error, OpenOptions, SceneKind, Skipped};
use crate::wording::counted;
use intrinsics::{Intrinsics, LensFault};

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    #[serde(default)]
    transform_matrix: Value,
    /// instant-ngp's frames of a rolling shutter have two matrices: the first counts.
    #[serde(default)]
    transform_matrix_start: Value,
    mask_path: Option<String>,
    depth_file_path: Option<String>,
    depth_path: Option<String>,
    #[serde(default, deserialize_with = "or_default")]
    is_bad: bool,
}

/// A field whose null says nothing.
fn or_default<'de, T: Default + Deserialize<'de>, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

impl Frame {
    /// The rows of its matrix, of which there are at least three; they may also be given one after another. NaN stands for
    /// what is no number.
    fn rows(&self) -> Option<Vec<Vec<f64>>> {
        let numbers = |list: &Vec<Value>| list.iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect::<Vec<f64>>();
        let list = self.transform_matrix.as_array().or_else(|| self.transform_matrix_start.as_array())?;
        let rows: Vec<Vec<f64>> = match list.len() {
            12 | 16 => numbers(list).chunks(4).map(<[f64]>::to_vec).collect(),
            _ => list.iter().map(|row| row.as_array().map(numbers)).collect::<Option<_>>()?,
        };
        (rows.len() >= 3 && rows.iter().all(|row| row.len() == 4)).then_some(rows)
    }
}

/// Fields of nerfstudio's file that concern all frames.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Whole {
    #[serde(deserialize_with = "or_default")]
    train_filenames: Vec<String>,
    #[serde(deserialize_with = "or_default")]
    val_filenames: Vec<String>,
    #[serde(deserialize_with = "or_default")]
    test_filenames: Vec<String>,
    /// Held-out frames beside the others, as of ScanNet++.
    #[serde(deserialize_with = "or_default")]
    test_frames: Vec<Value>,
    /// Length of a step of whole-number depth maps, under the names of nerfstudio and instant-ngp.
    depth_unit_scale_factor: Option<f64>,
    integer_depth_scale: Option<f64>,
    ply_file_path: Option<String>,
}

/// Gathers frames of one or three files.
struct Reader<'a> {
    root: &'a Path,
    images: Option<PathBuf>,
    views: Vec<ListedView>,
    skipped: Skipped,
    /// The first size found, for views without a size of their own.
    usual_size: Option<(u32, u32)>,
    camera_ids: HashMap<Vec<u64>, u32>,
    /// Photos and masks of the capture, by names that differ from theirs.
    lookup: Lookup,
    masks: HashMap<PathBuf, Masks>,
    /// For masks, depth maps and clouds that the file lists.
    folders: Folders,
    /// Frames that the file itself calls bad.
    bad_frames: usize,
    /// Frames of a rolling shutter, which have a second pose.
    moving_frames: usize,
    /// Frames that are called a fisheye's and have another camera model.
    called_fisheye: usize,
}

/// Reads the transforms file `path` of the scene at `root`, for Blender with its companion files. Photos that are not there are
/// looked for in all of `outer`.
pub(super) fn read(root: &Path, outer: &Path, path: &Path, options: &OpenOptions) -> Result<Listing, Error> {
    let images = options.images.as_ref().map(|asked| files::image_folder(root, asked)).transpose()?;
    let mut reader = Reader {
        root,
        images,
        views: Vec::new(),
        skipped: Skipped::default(),
        usual_size: None,
        camera_ids: HashMap::new(),
        lookup: Lookup::of(outer),
        masks: HashMap::new(),
        folders: Folders::default(),
        bad_frames: 0,
        moving_frames: 0,
        called_fisheye: 0,
    };
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
    let Reader { views, mut skipped, masks, images, bad_frames, moving_frames, called_fisheye, .. } = reader;
    for (count, what) in [
        (bad_frames, "that the file calls bad (is_bad)"),
        (moving_frames, "with a pose at the end of the exposure (transform_matrix_end), which is not used"),
        (called_fisheye, "whose is_fisheye contradicts their camera_model, which counts"),
    ] {
        skipped.notes.extend((count > 0).then(|| format!("{} {what}", counted(count, "frame"))));
    }
    let train = files::child(root, "transforms_train.json");
    if kind == SceneKind::Transforms && train.is_file() && train != path {
        skipped.notes.push(format!("the poses in {} are used, not those in {}", path.display(), train.display()));
    }
    if points.is_empty() {
        points = clouds::beside(&[root], &mut skipped);
    }
    skipped.notes.extend(masks.values().filter_map(Masks::doubt));
    let photos = images.is_none().then(|| files::child(root, "images")).filter(|folder| folder.is_dir());
    Ok(Listing { kind, root: root.to_owned(), source: path.to_owned(), views, points, skipped, photos })
}

impl Reader<'_> {
    fn file(&mut self, path: &Path, role: Role) -> Result<Whole, Error> {
        let text = files::read_text(path)?;
        // Writers in Python know numbers that JSON does not.
        let json: Value = serde_json::from_str(&text)
            .or_else(|_| serde_json::from_str(&without_nan(&text)))
            .map_err(|e| Error::malformed(path, format!("line {}", e.line()), format!("is not JSON: {e}")))?;
        let Some(frames) = json.get("frames").and_then(Value::as_array) else {
            return Err(Error::malformed(path, "the top level", "has no list \"frames\"; is this a transforms file?"));
        };
        let top = |e: serde_json::Error| Error::malformed(path, "the top level", e.to_string());
        let common = Intrinsics::of(&json).map_err(top)?;
        let whole = Whole::deserialize(&json).map_err(top)?;
        let mut roles = HashMap::new();
        for (names, role) in [
            (&whole.val_filenames, Role::Validation),
            (&whole.test_filenames, Role::Test),
            (&whole.train_filenames, Role::Train),
        ] {
            roles.extend(names.iter().map(|name| (tidy(name), role)));
        }
        let listed = roles.len();
        let step = whole.depth_unit_scale_factor.or(whole.integer_depth_scale).filter(|step| *step > 0.0);
        let read = self.views.len();
        let own = if whole.test_frames.is_empty() { role } else { Role::Train };
        for (list, frames, role) in [("frame", frames, own), ("test_frames, frame", &whole.test_frames, Role::Test)] {
            for (i, json) in frames.iter().enumerate() {
                self.frame((path, format!("{list} {}", i + 1)), json, &common, (&roles, role), frames)?;
            }
        }
        self.views[read..].iter_mut().for_each(|view| view.depth_step = step);
        let names: HashSet<String> = frames.iter().filter_map(name_of).collect();
        let found = roles.keys().filter(|name| names.contains(*name)).count();
        if found < listed {
            self.skipped.notes.push(format!(
                "{} of {listed} in train_filenames, val_filenames and test_filenames are no frame's file_path",
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
        let frame = Frame::deserialize(json).map_err(|e| wrong(&record, e.to_string()))?;
        if frame.is_bad {
            self.bad_frames += 1;
            return Ok(());
        }
        let own = Intrinsics::of(json).map_err(|e| wrong(&record, e.to_string()))?;
        let name = tidy(&frame.file_path);
        record = format!("{record} ({name:?})");
        if json.get("transform_matrix").is_some_and(Value::is_null) && frame.transform_matrix_start.is_null() {
            // Some writers list photos that were not posed.
            self.skipped.bad_poses.add(&name);
            return Ok(());
        }
        self.moving_frames += usize::from(json.get("transform_matrix_end").is_some_and(|end| !end.is_null()));
        let Some(mut rows) = frame.rows().filter(|_| !name.is_empty()) else {
            return Err(wrong(&record, "needs a file_path and a transform_matrix of 4 x 4 numbers".to_owned()));
        };
        pose::divide(&mut rows).map_err(|what| wrong(&record, what))?;
        let usual = self.usual(&name);
        let intrinsics = own.over(common);
        self.called_fisheye += usize::from(intrinsics.contradicts_itself());
        let size = match intrinsics.size() {
            Some(size) => Some(size),
            None => files::photo_size(&usual).map(|size| self.whole_size(&name, &usual, size)),
        };
        // Blender's files give no size; a frame whose photo is absent has the size of the others.
        self.usual_size = self.usual_size.or(size).or_else(|| self.first_size(all));
        let Some((width, height)) = size.or(self.usual_size) else {
            let what = format!("gives no w and h, and {} is not there to tell; add them", usual.display());
            return Err(wrong(&record, what));
        };
        let lens = match intrinsics.lens(width, height) {
            Ok(lens) => lens,
            Err(LensFault::Model(model)) => {
                return Err(Error::UnknownModel { path: path.to_owned(), record, model, known: intrinsics::models() });
            }
            Err(LensFault::Other(what)) => return Err(wrong(&record, what)),
        };
        let Some(pose) = pose::from_opengl(&rows) else {
            self.skipped.bad_poses.add(&name);
            if pose::is_mirrored(&rows) {
                self.skipped.mirrored_poses.add(&name);
            }
            return Ok(());
        };
        let camera_id = self.camera_id(&lens);
        let mask = self.mask(&name, frame.mask_path.as_deref());
        let depth = self.depth(frame.depth_file_path.as_deref().or(frame.depth_path.as_deref()));
        let listed = roles.get(&name).copied();
        self.views.push(ListedView {
            id: self.views.len() as u32,
            mask,
            misfit: None,
            depth,
            depth_step: None,
            image: self.photo(&name, usual),
            lens,
            camera_id,
            pose,
            role: listed.unwrap_or(role),
            name,
        });
        Ok(())
    }

    /// The photo of a frame as listed, in a folder of smaller copies, or the one that must be meant.
    fn usual(&self, name: &str) -> PathBuf {
        let smaller = |folder: &str| name.strip_prefix("images/").map(|inner| self.root.join(folder).join(inner));
        let copies = ["images_2", "images_4", "images_8"].into_iter().filter_map(smaller);
        let listed = files::find_photo(&iter::once(self.root.join(name)).chain(copies).collect::<Vec<_>>());
        if listed.is_file() {
            return listed;
        }
        self.lookup.find(name).map_or(listed, |found| self.lookup.folder().join(found))
    }

    /// The size of a frame's photo, of which a smaller copy of this size was found.
    fn whole_size(&self, name: &str, found: &Path, (width, height): (u32, u32)) -> (u32, u32) {
        let folder = found.strip_prefix(self.root).ok().and_then(|path| path.iter().next()).and_then(OsStr::to_str);
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
        files::find_photo(&[inner, name, last].map(|n| folder.join(n)))
    }

    /// The mask of a frame: as listed, or from a masks folder beside the photos' or in the scene.
    fn mask(&mut self, name: &str, listed: Option<&str>) -> Option<PathBuf> {
        if let Some(listed) = listed.filter(|listed| !listed.is_empty()) {
            let mask = self.folders.listed(self.root, listed);
            if mask.is_file() {
                return Some(mask);
            }
            self.skipped.missing_masks.add(listed);
        }
        let (first, inner) = name.split_once('/').unwrap_or(("", name));
        let images = self.images.clone().unwrap_or_else(|| self.root.join(first));
        let masks = self.masks.entry(images).or_insert_with_key(|images| Masks::of(self.root, images));
        masks.find(inner).or_else(|| masks.find(name))
    }

    /// The depth map that a frame names.
    fn depth(&mut self, listed: Option<&str>) -> Option<PathBuf> {
        let listed = listed?;
        let map = self.folders.listed(self.root, listed);
        if map.is_file() {
            return Some(map);
        }
        self.skipped.missing_depths.add(listed);
        None
    }

    /// The number of the physical camera: equal lenses share one.
    fn camera_id(&mut self, lens: &Lens) -> u32 {
        let next = self.camera_ids.len() as u32;
        *self.camera_ids.entry(lens.key()).or_insert(next)
    }
}

/// The name of a frame's photo.
fn name_of(frame: &Value) -> Option<String> {
    Some(tidy(frame.get("file_path")?.as_str()?))
}

/// The text with null for what Python writes for numbers that JSON does not know.
fn without_nan(text: &str) -> String {
    // Between quotes, of which none is escaped in what matters here.
    let mut inside = false;
    let part = |part: &str| {
        let told = if inside {
            part.to_owned()
        } else {
            part.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null")
        };
        inside = !inside;
        told
    };
    text.split('"').map(part).collect::<Vec<_>>().join("\"")
}
