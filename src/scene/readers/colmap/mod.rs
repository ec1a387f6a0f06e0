//! COLMAP models: cameras, images and points3D, binary or text.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::{ListedPoint, ListedView, Listing, files, pose};
use crate::scene::lens::{Lens, LensModel};
use crate::scene::view::Role;
use crate::scene::{Error, OpenOptions, SceneKind, Skipped};

/// Cameras by COLMAP's ids.
type Cameras = HashMap<u32, Lens>;

/// A row of images.bin or images.txt without its 2D points.
struct ImageRow {
    id: u32,
    quaternion: [f64; 4],
    translation: [f64; 3],
    camera_id: u32,
    name: String,
}

/// A row of points3D.bin or points3D.txt; the track names images by id.
struct PointRow {
    position: [f64; 3],
    colour: [u8; 3],
    error: f64,
    track: Vec<u32>,
}

/// True if a folder holds a model, binary or text.
pub(super) fn is_model(folder: &Path) -> bool {
    ["bin", "txt"].iter().any(|e| has(folder, e))
}

fn has(folder: &Path, extension: &str) -> bool {
    ["cameras", "images"].iter().all(|f| folder.join(f).with_extension(extension).is_file())
}

/// Reads the model in `model`, which belongs to the scene at `root`; binary files take precedence over text.
pub(super) fn read(root: &Path, model: &Path, options: &OpenOptions) -> Result<Listing, Error> {
    let binary = has(model, "bin");
    let extension = if binary { "bin" } else { "txt" };
    let file = |name: &str| model.join(name).with_extension(extension);
    let (cameras_file, source, points_file) = (file("cameras"), file("images"), file("points3D"));
    let (cameras, rows) = if binary {
        (binary::cameras(&cameras_file)?, binary::images(&source)?)
    } else {
        (text::cameras(&cameras_file)?, text::images(&source)?)
    };
    let points = match (points_file.is_file(), binary) {
        (false, _) => Vec::new(), // cameras alone can be rendered; training then starts from random points
        (true, true) => binary::points(&points_file)?,
        (true, false) => text::points(&points_file)?,
    };

    let root = if root == model { scene_of(model) } else { root.to_owned() };
    let images = photo_folder(&root, options, &rows)?;
    let masks = files::mask_folder(&root, &images);
    let mut skipped = Skipped::default();
    let mut views = Vec::with_capacity(rows.len());
    for row in rows {
        let Some(&lens) = cameras.get(&row.camera_id) else {
            return Err(Error::malformed(
                &source,
                format!("image {} ({:?})", row.id, row.name),
                format!("refers to camera {}, which {} does not hold", row.camera_id, cameras_file.display()),
            ));
        };
        let Some(pose) = pose::from_quaternion(row.quaternion, row.translation) else {
            skipped.bad_poses.add(&row.name);
            continue;
        };
        views.push(ListedView {
            id: row.id,
            image: files::find_photo(&[images.join(&row.name)]),
            mask: masks.as_ref().and_then(|folder| files::find_mask(folder, &row.name)),
            name: row.name,
            lens,
            camera_id: row.camera_id,
            pose,
            role: Role::Unsaid,
        });
    }
    let mut kept = Vec::with_capacity(points.len());
    for row in points {
        let position = DVec3::from_array(row.position);
        if pose::is_place(position) {
            kept.push(ListedPoint { position, colour: row.colour, error: row.error as f32, track: row.track });
        } else {
            skipped.bad_points += 1;
        }
    }
    let kind = if binary { SceneKind::ColmapBinary } else { SceneKind::ColmapText };
    Ok(Listing { kind, root, source, views, points: kept, skipped })
}

/// The scene of a model folder given by itself: the folder or the nearest of its three parents with photos.
fn scene_of(model: &Path) -> PathBuf {
    let absolute = std::path::absolute(model).unwrap_or_else(|_| model.to_owned());
    let found = absolute.ancestors().take(4).find(|a| a.join("images").is_dir());
    found.unwrap_or(model).to_owned()
}

/// The folder that image names are relative to: as requested, otherwise images, otherwise input or the scene itself if
/// the first photos lie there.
fn photo_folder(root: &Path, options: &OpenOptions, rows: &[ImageRow]) -> Result<PathBuf, Error> {
    if let Some(asked) = &options.images {
        return files::image_folder(root, asked);
    }
    let usual = root.join("images");
    if usual.is_dir() {
        return Ok(usual);
    }
    let holds = |folder: &PathBuf| rows.iter().take(100).any(|row| folder.join(&row.name).is_file());
    Ok([root.join("input"), root.to_owned()].into_iter().find(holds).unwrap_or(usual))
}

/// Adds a camera; refuses an id that is already taken.
fn add_camera(cameras: &mut Cameras, id: u32, lens: Lens) -> Result<(), String> {
    match cameras.insert(id, lens) {
        Some(_) => Err(format!("camera {id} is listed twice; remove the wrong entry")),
        None => Ok(()),
    }
}

/// A fault of a camera's record.
enum CameraFault {
    Model(String),
    Other(String),
}

impl CameraFault {
    fn at(self, path: &Path, record: String) -> Error {
        match self {
            Self::Model(model) => Error::UnknownModel { path: path.to_owned(), record, model },
            Self::Other(what) => Error::malformed(path, record, what),
        }
    }
}

impl From<String> for CameraFault {
    fn from(what: String) -> Self {
        Self::Other(what)
    }
}

/// The model with COLMAP's number; the fault names the models that the engine lacks.
fn model_of(id: i32) -> Result<LensModel, CameraFault> {
    LensModel::from_id(id).ok_or_else(|| {
        CameraFault::Model(match id {
            7 => "FOV (number 7)".to_owned(),
            11 => "RAD_TAN_THIN_PRISM_FISHEYE (number 11)".to_owned(),
            _ => format!("number {id}"),
        })
    })
}
