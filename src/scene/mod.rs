//! Cameras, photos, points and the train/test split of a capture.
//!
//! [`Scene::open`] reads COLMAP (binary and text), Blender, instant-ngp and nerfstudio data sets. All cameras follow
//! one convention ([`camera`]); a distorted lens comes with the ideal pinhole that replaces it ([`lens`]). Opening
//! reads only the photos' headers, for their sizes; [`Scene::load_photos`] decodes them into [`Photo`]s.

pub mod camera;
mod cover;
mod decode;
mod error;
mod exif;
pub mod faces;
mod front;
mod image_file;
mod image_size;
mod jpeg;
pub mod lens;
mod loaded;
mod median;
mod merge;
mod misfit;
mod near;
mod neighbours;
pub mod orbit;
pub mod origin;
mod overlap;
mod photo;
mod pixels;
mod readers;
mod resample;
mod skipped;
mod view;
pub mod walk;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Serialize;

use crate::wording::counted;

pub use decode::{ALPHA_SHARE, LoadOptions, PhotoMemory, alpha_role, load_photos};
pub use error::Error;
pub use exif::CameraKind;
#[cfg(feature = "pipeline")]
pub(crate) use front::in_front;
pub(crate) use front::{Front, fronts};
#[cfg(feature = "pose")]
pub(crate) use image_file::in_eight_bits;
pub use loaded::LoadedPhotos;
pub(crate) use median::{median, weighted_quantile};
pub use misfit::{Misfit, Reading};
pub use near::{ONE_PLACE, USUAL_DISTANCE, near_at};
#[cfg(feature = "train")]
pub(crate) use neighbours::Neighbours;
pub use photo::{AlphaRole, DepthMap, Photo};
pub use pixels::{PhotoFile, Pixels};
pub(crate) use readers::text_of;
#[cfg(feature = "pipeline")]
pub(crate) use readers::unread_depth_map;
pub use readers::{PhotoTree, archive_in, instead, is_video_name, masks_of, photo_folder, photo_names, read_text};
pub use skipped::{Names, Skipped};
#[cfg(feature = "pose")]
pub(crate) use view::is_panorama;
pub use view::{Resize, Role, View};

/// One view in this many, sorted by name, is held out: the protocol of the 3DGS papers.
pub const EVAL_EVERY: usize = 8;

/// A scene with fewer points is trained from random ones.
const FEWEST_POINTS: usize = 10;

/// Least distance of a first camera's target in a scene without points, in near planes: 1 unit where that is 3DGS's 0.2.
const NEAREST_SIGHT: f64 = 5.0;

/// The format of a scene's files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// COLMAP's cameras.bin, images.bin, points3D.bin.
    ColmapBinary,
    /// COLMAP's cameras.txt, images.txt, points3D.txt.
    ColmapText,
    /// transforms_train.json and its companions, as in the NeRF synthetic scenes.
    Blender,
    /// One transforms.json, as in instant-ngp and nerfstudio.
    Transforms,
}

/// A point of the reconstruction.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Position in world coordinates.
    pub position: DVec3,
    /// Unit normal of the surface there, to either side; none if it is not known.
    pub normal: Option<DVec3>,
    /// Red, green, blue.
    pub colour: [u8; 3],
    /// Mean reprojection error in pixels; 0 where the format has none.
    pub error: f32,
    /// Indices of the views that saw it, ascending; empty where the format has no tracks.
    pub track: Vec<u32>,
}

/// Options of opening a scene.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Photo folder: a name within the scene (`images_4`) or a path; the data set's own if none is given.
    pub images: Option<PathBuf>,
    /// True to undistort all photos, false to undistort none; if not given, those whose lens moves some pixel by more
    /// than [`lens::VISIBLE_DISPLACEMENT`].
    pub undistort: Option<bool>,
    /// Angle in degrees: panoramas and wide fisheyes are masked within it of straight down.
    pub pole_mask: f64,
    /// Folder of depth maps with the photos' names; the data set's own if none is given.
    pub depth: Option<PathBuf>,
    /// True for scenes to train on or to inspect: measures how well poses fit the points ([`View::misfit`]), and merges near copies of
    /// points.
    pub check: bool,
}

/// A capture: views sorted by name, and the points reconstructed from them.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The format read.
    pub kind: SceneKind,
    /// The scene's folder.
    pub root: PathBuf,
    /// The file that lists the views.
    pub source: PathBuf,
    /// Views in ascending order of their names (by bytes).
    pub views: Vec<View>,
    /// Points of the reconstruction; empty where the format has none.
    pub points: Vec<Point>,
    /// The colour of all points of the files, if they have one in common, as those of a cloud without colours do.
    pub plain: Option<[u8; 3]>,
    /// Everything left out since the scene was opened.
    pub skipped: Skipped,
    /// Nothing nearer to a camera than this is drawn, in world units: 3DGS's 0.2 in scenes of usual size, and in proportion
    /// to the depth of the points in others. It stays when views are dropped.
    pub near: f32,
    /// The unit of length in units of the files: 1 unless [`Scene::use_usual_unit`] chose another.
    pub unit: f64,
    /// Local origin of the coordinates, in the world of the files; non-zero if the scene lies far from the world's origin
    /// ([`origin`]).
    pub origin: DVec3,
}

/// The training and the held-out views, as ascending indices into [`Scene::views`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Views trained on.
    pub train: Vec<usize>,
    /// Views held out.
    pub test: Vec<usize>,
}

/// Counts a view of the scene in `source` whose photo is absent or of another shape than its camera, and says why it cannot be
/// used; the first other shape is noted.
fn unusable(view: &View, kind: SceneKind, source: &Path, skipped: &mut Skipped) -> Option<String> {
    let photo = view.image.display();
    if !view.image.is_file() {
        skipped.missing_images.add_photo(view);
        // Only the message of the first absent photo is shown.
        let instead = if skipped.missing_images.count == 1 { readers::only_unread(&view.image) } else { None };
        return Some(match instead {
            Some(instead) => format!("{photo}: {instead}"),
            None => format!("{photo} does not exist"),
        });
    }
    let (width, height) = view.mismatched()?;
    let is_first = skipped.mismatched_images.count == 0;
    skipped.mismatched_images.add_photo(view);
    let turned = view.lens.fits(height, width);
    if turned {
        skipped.turned_images.add_photo(view);
    }
    let (file, remedy) = match kind {
        SceneKind::Blender | SceneKind::Transforms => (source, "correct w and h, or give the photos that were posed"),
        // Cameras have a file of their own beside that of the views.
        SceneKind::ColmapBinary | SceneKind::ColmapText => {
            (source.parent().unwrap_or(source), "give the photos that were posed")
        }
    };
    let remedy = if turned && view.has_exif_rotation() {
        "EXIF rotation is ignored; store photos as the camera saw them (`magick mogrify -auto-orient`), or pose the stored pixels"
    } else {
        remedy
    };
    let camera = format!("its camera in {} is {} x {}", file.display(), view.lens.width, view.lens.height);
    let told = format!("{photo} is {width} x {height}, but {camera}: {remedy}");
    skipped.notes.extend(is_first.then(|| told.clone()));
    Some(told)
}

impl Scene {
    /// A note if the scene has too few points to start training from, or they show too little of it.
    pub fn lacks_points(&self) -> Option<String> {
        let said = match self.points.len() {
            0 => "no points".to_owned(),
            few @ 1..FEWEST_POINTS => format!("only {}", counted(few, "point")),
            _ => format!("the points fall into {:.0} % of the middle photo", 100.0 * self.uncovered()?),
        };
        Some(format!("{said}: training starts from random ones"))
    }

    /// Drops and counts the views whose photo is absent or differs in shape from its camera.
    ///
    /// # Errors
    /// [`Error::NoPhotos`] where no view is left.
    pub fn require_photos(&mut self) -> Result<(), Error> {
        let Self { kind, source, views, skipped, .. } = self;
        let reasons: Vec<Option<String>> = views.iter().map(|view| unusable(view, *kind, source, skipped)).collect();
        self.keep_sound(&reasons)
    }

    /// True if [`Scene::require_photos`] leaves a view.
    pub fn has_photos(&self) -> bool {
        let mut skipped = Skipped::default();
        self.views.iter().any(|view| unusable(view, self.kind, &self.source, &mut skipped).is_none())
    }

    /// Drops the views for which there is a reason.
    fn keep_sound(&mut self, reasons: &[Option<String>]) -> Result<(), Error> {
        let listed = self.views.len();
        self.retain_views(&reasons.iter().map(Option::is_none).collect::<Vec<_>>());
        if self.views.is_empty() {
            let what = reasons.iter().flatten().next().map_or("no view is listed", |reason| reason).to_owned();
            return Err(Error::NoPhotos { root: self.root.clone(), listed, what });
        }
        Ok(())
    }

    /// Loads the photos of all views in parallel, one for each view that is left; views with a damaged photo are
    /// dropped and counted. `progress` is called from any thread after each photo, with the number done so far.
    ///
    /// # Errors
    /// [`Error::NoPhotos`] where no view is left; [`Error::Store`] where the temporary file cannot be written.
    pub fn load_photos(
        &mut self,
        options: &LoadOptions<'_>,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Result<Vec<Photo>, Error> {
        let views: Vec<&View> = self.views.iter().collect();
        let loaded = load_photos(&views, options, progress)?;
        self.skipped.add_loaded(&loaded, &views);
        let reasons: Vec<Option<String>> =
            loaded.photos.iter().map(|photo| photo.as_ref().err().map(Error::to_string)).collect();
        self.keep_sound(&reasons)?;
        Ok(loaded.photos.into_iter().flatten().collect())
    }

    /// True if any view has a mask.
    pub fn has_masks(&self) -> bool {
        self.views.iter().any(View::is_masked)
    }

    /// Keeps the views whose flag is set (views beyond the flags are dropped) and renumbers the points' tracks.
    pub fn retain_views(&mut self, keep: &[bool]) {
        let mut next = 0;
        let renumbered: Vec<Option<u32>> = (0..self.views.len())
            .map(|i| {
                let number = keep.get(i).copied().unwrap_or(false).then_some(next);
                next += u32::from(number.is_some());
                number
            })
            .collect();
        let mut flags = renumbered.iter().map(Option::is_some);
        self.views.retain(|_| flags.next().unwrap_or(false));
        for point in &mut self.points {
            point.track = point.track.iter().filter_map(|&v| renumbered.get(v as usize).copied().flatten()).collect();
        }
    }

    /// The train/test split of the present views: the data set's own if it marks views to hold out; otherwise every
    /// `eval_every`-th photo, beginning with the first, is held out (none if that is 0; a single one only if it is 1), with all
    /// views that it was cut into.
    ///
    /// [`Scene::require_photos`] and [`Scene::load_photos`] renumber views: take the split after them.
    pub fn split(&self, eval_every: usize) -> Split {
        let of = |wanted: &[Role]| -> Vec<usize> {
            (0..self.views.len()).filter(|&i| wanted.contains(&self.views[i].role)).collect()
        };
        if self.views.iter().any(|v| matches!(v.role, Role::Test | Role::Validation)) {
            let test = of(&[Role::Test]);
            return Split {
                train: of(&[Role::Train, Role::Unsaid]),
                test: if test.is_empty() { of(&[Role::Validation]) } else { test },
            };
        }
        let mut numbers: HashMap<&str, usize> = HashMap::new();
        let photos: Vec<usize> = self
            .views
            .iter()
            .map(|view| {
                let next = numbers.len();
                *numbers.entry(view.photo_name()).or_insert(next)
            })
            .collect();
        let held_out = |i: &usize| {
            eval_every > 0 && photos[*i].is_multiple_of(eval_every) && (numbers.len() > 1 || eval_every == 1)
        };
        let (test, train) = (0..self.views.len()).partition(held_out);
        Split { train, test }
    }

    /// Mean of the camera centres of `views` (usually the split's training views), in world units; the origin for none.
    pub fn centre(&self, views: &[usize]) -> DVec3 {
        camera::mean_centre(self.chosen(views))
    }

    /// Scene extent of 3DGS: 1.1 times the largest distance of a camera of `views` (usually the split's training views)
    /// to their mean, in world units; half the distance of things in a scene of usual size if the cameras are at one place.
    pub fn extent(&self, views: &[usize]) -> f64 {
        let (own, near) = (camera::extent(self.chosen(views)), f64::from(self.near));
        if own > ONE_PLACE * near { own } else { 0.5 * USUAL_DISTANCE * near }
    }

    /// Up in the world: the mean of the cameras' up directions, of unit length; -y without cameras, and if they cancel out.
    pub fn up(&self) -> DVec3 {
        let sum: DVec3 = self.views.iter().map(|view| -view.camera.rotation.row(1)).sum();
        sum.try_normalize().unwrap_or(orbit::UP)
    }

    /// The point about which a first camera turns, in world units: on its axis, at the median depth of the points before it;
    /// without points, at the depth of the cameras' mean centre, but not nearer than five near planes.
    pub fn sight(&self, camera: &camera::Camera) -> DVec3 {
        let depths = self.points.iter().map(|point| camera.depth(point.position));
        let mut depths: Vec<f64> = depths.filter(|depth| *depth > 0.0).collect();
        let around = camera.depth(camera::mean_centre(self.views.iter().map(|view| &view.camera)));
        let depth = median(&mut depths).unwrap_or_else(|| around.max(NEAREST_SIGHT * f64::from(self.near)));
        camera.centre() + camera.rotation.row(2) * depth
    }

    fn chosen<'a>(&'a self, views: &'a [usize]) -> impl Iterator<Item = &'a camera::Camera> + Clone {
        views.iter().filter_map(|&i| self.views.get(i)).map(|v| &v.camera)
    }
}
