//! Blender's transforms_{train,val,test}.json; instant-ngp's and nerfstudio's transforms.json.
//!
//! Poses are camera-to-world with OpenGL's camera axes. World coordinates are the file's: nerfstudio's
//! `applied_transform` (the difference from COLMAP's) is not undone, and its point cloud lies in the same world.
//! instant-ngp's `scale`, `offset` and `aabb_scale` concern its own volume only and are ignored.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec2;
use serde::Deserialize;
use serde_json::Value;

use super::masks::Masks;
use super::names::{Lookup, tidy};
use super::{ListedView, Listing, clouds, files, point_ply, pose};
use crate::scene::lens::{Curve, Distortion, Lens, LensModel};
use crate::scene::view::Role;
use crate::scene::{Error, OpenOptions, SceneKind, Skipped};

/// Intrinsics of the file or of one of its frames.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct Intrinsics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<String>,
    depth_file_path: Option<String>,
}

/// Fields of nerfstudio's file that concern all frames.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Whole {
    train_filenames: Vec<String>,
    val_filenames: Vec<String>,
    test_filenames: Vec<String>,
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
}

/// Reads the transforms file `path` of the scene at `root`, for Blender with its companion files.
pub(super) fn read(root: &Path, path: &Path, options: &OpenOptions) -> Result<Listing, Error> {
    let images = options.images.as_ref().map(|asked| files::image_folder(root, asked)).transpose()?;
    let mut reader = Reader {
        root,
        images,
        views: Vec::new(),
        skipped: Skipped::default(),
        usual_size: None,
        camera_ids: HashMap::new(),
        lookup: Lookup::of(root),
        masks: HashMap::new(),
    };
    let mut points = Vec::new();
    let sisters = [
        ("transforms_train.json", Role::Train),
        ("transforms_val.json", Role::Validation),
        ("transforms_test.json", Role::Test),
    ];
    let kind = if sisters.iter().any(|(name, _)| path.file_name().is_some_and(|n| n == *name)) {
        for (name, role) in sisters {
            let sister = root.join(name);
            if sister.is_file() {
                reader.file(&sister, role)?;
            }
        }
        SceneKind::Blender
    } else {
        let whole = reader.file(path, Role::Unsaid)?;
        if let Some(named) = whole.ply_file_path {
            let ply = root.join(tidy(&named));
            if ply.is_file() {
                points = clouds::usable(point_ply::read(&ply)?, &mut reader.skipped);
            } else {
                reader.skipped.notes.push(format!("{}, named by ply_file_path, does not exist", ply.display()));
            }
        }
        SceneKind::Transforms
    };
    let Reader { views, mut skipped, masks, images, .. } = reader;
    if points.is_empty() {
        points = clouds::beside(std::iter::empty(), root, &mut skipped);
    }
    if points.is_empty() && kind == SceneKind::Transforms {
        skipped.notes.push("no points: training begins at random ones".to_owned());
    }
    skipped.notes.extend(masks.values().filter_map(Masks::doubt));
    let photos = images.is_none().then(|| root.join("images")).filter(|folder| folder.is_dir());
    Ok(Listing { kind, root: root.to_owned(), source: path.to_owned(), views, points, skipped, photos })
}

impl Reader<'_> {
    fn file(&mut self, path: &Path, role: Role) -> Result<Whole, Error> {
        let text = files::read_text(path)?;
        let json: Value = serde_json::from_str(&text).map_err(|e| {
            Error::malformed(path, format!("line {}", e.line()), format!("is not JSON: {e} (JSON knows no NaN)"))
        })?;
        let top = |e: serde_json::Error| Error::malformed(path, "the top level", e.to_string());
        let common = Intrinsics::deserialize(&json).map_err(top)?;
        let whole = Whole::deserialize(&json).map_err(top)?;
        let Some(frames) = json.get("frames").and_then(Value::as_array) else {
            return Err(Error::malformed(path, "the top level", "has no list \"frames\"; is this a transforms file?"));
        };
        let mut roles = HashMap::new();
        for (names, role) in [
            (&whole.val_filenames, Role::Validation),
            (&whole.test_filenames, Role::Test),
            (&whole.train_filenames, Role::Train),
        ] {
            roles.extend(names.iter().map(|name| (tidy(name), role)));
        }
        for (i, json) in frames.iter().enumerate() {
            let mut record = format!("frame {}", i + 1);
            let wrong = |record: &str, what: String| Error::malformed(path, record, what);
            let frame = Frame::deserialize(json).map_err(|e| wrong(&record, e.to_string()))?;
            let own = Intrinsics::deserialize(json).map_err(|e| wrong(&record, e.to_string()))?;
            let name = tidy(&frame.file_path);
            record = format!("{record} ({name:?})");
            if name.is_empty()
                || frame.transform_matrix.len() < 3
                || frame.transform_matrix.iter().any(|r| r.len() != 4)
            {
                return Err(wrong(&record, "needs a file_path and a transform_matrix of 4 x 4 numbers".to_owned()));
            }
            let usual = self.usual(&name);
            let intrinsics = own.over(&common);
            let size = match intrinsics.size() {
                Some(size) => Some(size),
                None => files::photo_size(&usual),
            };
            // Blender's files give no size; a frame whose photo is absent has the size of the others.
            self.usual_size = self.usual_size.or(size).or_else(|| self.first_size(frames));
            let Some((width, height)) = size.or(self.usual_size) else {
                let what = format!("gives no w and h, and {} is not there to tell; add them", usual.display());
                return Err(wrong(&record, what));
            };
            let lens = match intrinsics.lens(width, height) {
                Ok(lens) => lens,
                Err(LensFault::Model(model)) => {
                    return Err(Error::UnknownModel { path: path.to_owned(), record, model });
                }
                Err(LensFault::Other(what)) => return Err(wrong(&record, what)),
            };
            let Some(pose) = pose::from_opengl(&frame.transform_matrix) else {
                self.skipped.bad_poses.add(&name);
                if pose::is_mirrored(&frame.transform_matrix) {
                    self.skipped.mirrored_poses.add(&name);
                }
                continue;
            };
            let camera_id = self.camera_id(&lens);
            let mask = self.mask(&name, frame.mask_path.as_deref());
            let depth = self.depth(frame.depth_file_path.as_deref());
            self.views.push(ListedView {
                id: self.views.len() as u32,
                mask,
                misfit: None,
                depth,
                image: self.photo(&name, usual),
                lens,
                camera_id,
                pose,
                role: roles.get(&name).copied().unwrap_or(role),
                name,
            });
        }
        Ok(whole)
    }

    /// The photo of a frame as listed, or the one that must be meant.
    fn usual(&self, name: &str) -> PathBuf {
        let listed = files::find_photo(&[self.root.join(name)]);
        if listed.is_file() {
            return listed;
        }
        self.lookup.find(name).map_or(listed, |found| self.root.join(found))
    }

    /// The size of the first photo that exists.
    fn first_size(&self, frames: &[Value]) -> Option<(u32, u32)> {
        frames.iter().find_map(|frame| {
            let name = tidy(frame.get("file_path")?.as_str()?);
            files::photo_size(&self.usual(&name))
        })
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
        if let Some(listed) = listed {
            let mask = self.root.join(tidy(listed));
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
        let map = self.root.join(tidy(listed));
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

/// Models whose parameters have no names in these files.
const UNNAMED: [LensModel; 6] = [
    LensModel::ThinPrismFisheye,
    LensModel::RadTanThinPrismFisheye,
    LensModel::Fov,
    LensModel::SimpleDivision,
    LensModel::Division,
    LensModel::Eucm,
];

enum LensFault {
    Model(String),
    Other(String),
}

impl Intrinsics {
    /// The frame's own values if given, otherwise the file's; a frame's own field of view replaces the file's focal
    /// length.
    fn over(&self, common: &Self) -> Self {
        let angles = self.camera_angle_x.is_some() && self.fl_x.is_none();
        let focal = |own: Option<f64>, file: Option<f64>| if angles { own } else { own.or(file) };
        Self {
            fl_x: focal(self.fl_x, common.fl_x),
            fl_y: focal(self.fl_y, common.fl_y),
            camera_angle_x: self.camera_angle_x.or(common.camera_angle_x),
            camera_angle_y: focal(self.camera_angle_y, common.camera_angle_y),
            cx: self.cx.or(common.cx),
            cy: self.cy.or(common.cy),
            w: self.w.or(common.w),
            h: self.h.or(common.h),
            k1: self.k1.or(common.k1),
            k2: self.k2.or(common.k2),
            k3: self.k3.or(common.k3),
            k4: self.k4.or(common.k4),
            k5: self.k5.or(common.k5),
            k6: self.k6.or(common.k6),
            p1: self.p1.or(common.p1),
            p2: self.p2.or(common.p2),
            camera_model: self.camera_model.clone().or_else(|| common.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(common.is_fisheye),
        }
    }

    /// Width and height if given; absurd ones become 0, which no lens accepts.
    fn size(&self) -> Option<(u32, u32)> {
        let whole = |x: f64| x.round() as u32; // saturates; NaN gives 0
        Some((whole(self.w?), whole(self.h?)))
    }

    fn lens(&self, width: u32, height: u32) -> Result<Lens, LensFault> {
        let model = match self.camera_model.as_deref() {
            None if self.is_fisheye == Some(true) => LensModel::OpenCvFisheye,
            None => LensModel::OpenCv,
            Some(name) => match LensModel::from_name(name) {
                Some(model) if !UNNAMED.contains(&model) => model,
                _ => return Err(LensFault::Model(name.to_owned())),
            },
        };
        if model == LensModel::Equirectangular {
            // All directions, whatever focal length is given.
            return Lens::panorama(width.into(), height.into()).map_err(LensFault::Other);
        }
        let curve = if model.is_fisheye() { Curve::Angle } else { Curve::Straight };
        let k = [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6].map(|k| k.unwrap_or(0.0));
        let (radial, denominator) = if model == LensModel::FullOpenCv {
            ([k[0], k[1], k[2], 0.0, 0.0, 0.0], [k[3], k[4], k[5]])
        } else {
            ([k[0], k[1], k[2], k[3], 0.0, 0.0], [0.0; 3])
        };
        let tangential = if model.is_fisheye() { [0.0; 2] } else { [self.p1, self.p2].map(|p| p.unwrap_or(0.0)) };
        let distortion = Distortion { curve, radial, denominator, tangential, ..Distortion::default() };
        let size = DVec2::new(f64::from(width), f64::from(height));
        let from_angle = |extent: f64, angle: f64| 0.5 * extent / (0.5 * angle).tan();
        let fx = self.fl_x.or_else(|| self.camera_angle_x.map(|a| from_angle(size.x, a)));
        let fy = self.fl_y.or_else(|| match (self.fl_x, self.camera_angle_y) {
            (None, Some(angle)) => Some(from_angle(size.y, angle)),
            _ => fx,
        });
        let (Some(fx), Some(fy)) = (fx.or(fy), fy) else {
            return Err(LensFault::Other("gives neither fl_x nor camera_angle_x; add one".to_owned()));
        };
        let principal = DVec2::new(self.cx.unwrap_or(0.5 * size.x), self.cy.unwrap_or(0.5 * size.y));
        let model = if distortion == Distortion::default() { LensModel::Pinhole } else { model };
        let lens = Lens { model, width, height, focal: DVec2::new(fx, fy), principal, distortion };
        lens.checked().map_err(LensFault::Other)
    }
}
