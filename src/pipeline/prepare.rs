//! From a scene on disk to views in memory, and to the Gaussians that training begins with.

use super::checkpoint::Checkpoint;
use super::config::{Init, RunConfig, Selection};
use super::watcher::Watcher;
use crate::effects::Effect;
use crate::error::Error;
use crate::gaussians::{Gaussians, formats};
use crate::scene::camera::Camera;
use crate::scene::photo::Photo;
use crate::scene::{self, OpenOptions, Resize, Scene, SceneKind, View};
use crate::train::initialise::{self, Seed};
use crate::train::photos::TrainView;
use crate::train::pixels::{PhotoFile, Pixels};
use glam::DVec3;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Random points for each pixel of a picture, and the bounds of their number.
const POINTS_PER_PIXEL: f64 = 0.3;
const POINTS: (usize, usize) = (5_000, 100_000);

/// A scene ready to train on.
pub struct Prepared {
    /// The scene, its views those whose photos were loaded.
    pub scene: Scene,
    /// Views trained on.
    pub train: Vec<TrainView>,
    /// Views held out, with their names.
    pub test: Vec<(String, TrainView)>,
    /// 1.1 times the largest distance of a training camera from their mean.
    pub extent: f64,
    /// Whether any photo carries alpha.
    pub transparent: bool,
    /// Whether the photos' fourth byte says how much of a pixel counts.
    pub masked: bool,
    /// Colour behind everything.
    pub background: [f32; 3],
}

impl Prepared {
    /// All views, those held out first.
    pub fn views(&self) -> impl Iterator<Item = &TrainView> {
        self.test.iter().map(|(_, view)| view).chain(&self.train)
    }
}

/// Reads `W` or `/K`.
///
/// # Errors
/// A sentence that says what is wrong.
pub fn resolution(text: &str) -> Result<Resize, String> {
    let number = |t: &str| t.parse::<u32>().ok().filter(|n| *n > 0);
    let read = match text.strip_prefix('/') {
        Some(k) => number(k).map(Resize::Divide),
        None => number(text).map(Resize::Width),
    };
    read.ok_or_else(|| format!("'{text}' is neither a width in pixels, such as 800, nor a divisor, such as /4"))
}

/// A scene whose photos are there, not decoded yet.
pub struct Opened {
    /// The scene.
    pub scene: Scene,
    resize: Resize,
    selection: Selection,
}

/// Opens a scene.
///
/// # Errors
/// What the scene's readers refuse; photos that are not there.
pub fn open(selection: &Selection) -> Result<Opened, Error> {
    let resize = match &selection.resolution {
        Some(text) => resolution(text).map_err(Error::Usage)?,
        None => Resize::Full,
    };
    selection.effects.check().map_err(Error::Usage)?;
    let undistort = selection.effects.forced(Effect::Distortion);
    let options = OpenOptions { images: selection.images.clone(), undistort };
    let mut scene = Scene::open(&selection.scene, &options)?;
    scene.require_photos()?;
    Ok(Opened { scene, resize, selection: selection.clone() })
}

impl Opened {
    /// Width and height that every picture fits in.
    pub fn size(&self) -> [u32; 2] {
        let larger = |[w, h]: [u32; 2], c: Camera| [w.max(c.width), h.max(c.height)];
        self.scene.views.iter().map(|v| v.camera_at(self.resize)).fold([1, 1], larger)
    }

    /// Pixels of each picture that is trained on; photos that turn out damaged are still among them.
    pub fn train_pixels(&self) -> Vec<u64> {
        let pixels = |i: &usize| {
            let camera = self.scene.views[*i].camera_at(self.resize);
            u64::from(camera.width) * u64::from(camera.height)
        };
        self.scene.split(self.selection.eval_every).train.iter().map(pixels).collect()
    }

    /// As [`Opened::load`], where photos to train on are needed.
    ///
    /// # Errors
    /// As [`Opened::load`]; none to train on.
    pub fn load_to_train(self, room: (u64, &Path), watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let prepared = self.load(room, watcher)?;
        if prepared.train.is_empty() {
            return Err(Error::NothingToTrainOn(prepared.scene.source));
        }
        Ok(prepared)
    }

    /// Decodes the photos in parallel. Where they would take more than `room` bytes of the host's memory, they go to a
    /// temporary file in `folder` as they are decoded. What was skipped is told to `watcher`.
    ///
    /// # Errors
    /// No photo can be decoded; a file that cannot be written.
    pub fn load(self, (room, folder): (u64, &Path), watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let Self { mut scene, resize, selection } = self;
        let ends: Vec<u64> = scene
            .views
            .iter()
            .map(|v| v.camera_at(resize))
            .scan(0, |end, c| {
                *end += 4 * u64::from(c.width) * u64::from(c.height);
                Some(*end)
            })
            .collect();
        let all = ends.last().copied().unwrap_or(0);
        let writing = |source| Error::Write { path: folder.to_owned(), source };
        let file = if all > room { Some(PhotoFile::new(folder).map_err(writing)?) } else { None };
        if file.is_some() {
            tracing::info!("{all} bytes of photos are beyond {room}: they go to a file in {}", folder.display());
        }
        let store = |photo: Photo, end: u64| -> Result<(Pixels, bool), Error> {
            let pixels = match &file {
                Some(file) => file.put(end - photo.pixels.len() as u64, &photo.pixels).map_err(writing)?,
                None => Pixels::from(photo.pixels),
            };
            Ok((pixels, photo.has_alpha))
        };
        // Where the user wants no transparency, alpha is not looked at.
        let opaque = selection.effects.forced(Effect::Transparency) == Some(false);
        let masked = selection.effects.forced(Effect::Masks) != Some(false)
            && scene.views.iter().any(|v| v.mask.is_some())
            && (opaque || !scene.views.par_iter().any(View::announces_alpha));
        let (done, total) = (AtomicUsize::new(0), scene.views.len());
        let photos: Vec<Result<(Pixels, bool), scene::Error>> = scene
            .views
            .par_iter()
            .zip(&ends)
            .map(|(view, end)| {
                let photo = view.load_photo(resize).map(|photo| fourth(photo, opaque, masked));
                watcher.loading(done.fetch_add(1, Ordering::Relaxed) + 1, total);
                // A damaged photo fails alone; a full disk ends it all.
                Ok(match photo {
                    Ok(photo) => Ok(store(photo, *end)?),
                    Err(damaged) => Err(damaged),
                })
            })
            .collect::<Result<_, Error>>()?;
        let photos = scene.keep_loaded(photos)?;
        for line in scene.skipped.summary() {
            watcher.note(&line);
        }
        let split = scene.split(selection.eval_every);
        let transparent = !masked && photos.iter().any(|(_, has_alpha)| *has_alpha);
        let view = |i: usize| TrainView { camera: scene.views[i].camera_at(resize), pixels: photos[i].0.clone() };
        let train = split.train.iter().map(|i| view(*i)).collect();
        let test = split.test.iter().map(|i| (scene.views[*i].name.clone(), view(*i))).collect();
        let extent = scene.extent(&split.train);
        // The field trains and scores Blender scenes on white.
        let background = selection.background.unwrap_or(if transparent { [1.0; 3] } else { [0.0; 3] });
        Ok(Prepared { scene, train, test, extent, transparent, masked, background })
    }
}

/// The photo with what its fourth byte is to mean.
fn fourth(mut photo: Photo, opaque: bool, masked: bool) -> Photo {
    if opaque && photo.has_alpha {
        photo.has_alpha = false;
        photo.pixels.iter_mut().skip(3).step_by(4).for_each(|a| *a = 255);
    }
    if masked {
        photo.fold_mask();
    }
    photo
}

/// What training begins with, before any photo is looked at.
pub enum Start {
    /// This model.
    Model(Gaussians),
    /// The scene's points: so many.
    Points(usize),
    /// So many random points.
    Random(usize),
    /// A run that was broken off.
    Resumed(Box<Checkpoint>),
}

impl Start {
    /// What the configuration says of this scene.
    ///
    /// # Errors
    /// A model that cannot be read.
    pub fn of(config: &RunConfig, opened: &Opened) -> Result<Self, Error> {
        let points = opened.scene.points.len();
        Ok(match &config.init {
            Init::Model(path) => Self::Model(formats::read(path)?.gaussians),
            Init::Points if points > 0 => Self::Points(points),
            Init::Points | Init::Random => {
                let pixels = opened.train_pixels().into_iter().max().unwrap_or(0) as f64;
                let count = (pixels * POINTS_PER_PIXEL) as usize;
                let count = config.init_count.unwrap_or(count.clamp(POINTS.0, POINTS.1));
                // More would be drawn only to be thinned.
                Self::Random(count.min(config.max_gaussians))
            }
        })
    }

    /// How many Gaussians that is.
    pub fn len(&self) -> usize {
        match self {
            Self::Model(model) => model.len(),
            Self::Points(n) | Self::Random(n) => *n,
            Self::Resumed(checkpoint) => checkpoint.snapshot.model.len(),
        }
    }

    /// Whether that is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Highest SH degree among them.
    pub fn degree(&self) -> usize {
        match self {
            Self::Model(model) => model.degree(),
            Self::Resumed(checkpoint) => checkpoint.snapshot.model.degree(),
            Self::Points(_) | Self::Random(_) => 0,
        }
    }
}

/// The Gaussians that training begins with.
///
/// # Errors
/// Cameras that leave no place for random points.
pub fn initialise(config: &RunConfig, prepared: &Prepared, start: Start) -> Result<Gaussians, Error> {
    let blender = prepared.scene.kind == SceneKind::Blender;
    let colour = |c: [u8; 3]| DVec3::from(c.map(f64::from)) / 255.0;
    let seeds = match start {
        Start::Model(model) => return Ok(model),
        Start::Resumed(checkpoint) => return Ok(checkpoint.snapshot.model),
        Start::Points(_) => {
            prepared.scene.points.iter().map(|p| Seed { position: p.position, colour: colour(p.colour) }).collect()
        }
        Start::Random(count) => initialise::random(&prepared.train, count, blender, u64::from(config.seed))?,
    };
    let mut model = initialise::from_points(&seeds);
    if model.len() > config.max_gaussians {
        let n = model.len();
        // Evenly over the list, so that no region is left out.
        let kept: Vec<usize> = (0..config.max_gaussians).map(|k| k * n / config.max_gaussians).collect();
        model = model.select(&kept);
    }
    Ok(model)
}
