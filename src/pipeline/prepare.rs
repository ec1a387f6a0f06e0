//! From a scene on disk to views in memory, and to the Gaussians that training begins with.

use super::checkpoint::Checkpoint;
use super::config::{Init, RunConfig, Selection};
use super::watcher::Watcher;
use crate::effects::Effect;
use crate::error::Error;
use crate::gaussians::{Gaussians, formats};
use crate::scene::camera::Camera;
use crate::scene::{FourthByte, LoadOptions, OpenOptions, Photo, PhotoMemory, Resize, Scene, SceneKind};
use crate::train::initialise::{self, Seed};
use glam::DVec3;

/// Random points for each pixel of a picture, and the bounds of their number.
const POINTS_PER_PIXEL: f64 = 0.3;
const POINTS: (usize, usize) = (5_000, 100_000);

/// A scene ready to train on.
pub struct Prepared {
    /// The scene, its views those whose photos were loaded.
    pub scene: Scene,
    /// Views trained on.
    pub train: Vec<Photo>,
    /// Views held out, with their names.
    pub test: Vec<(String, Photo)>,
    /// 1.1 times the largest distance of a training camera from their mean.
    pub extent: f64,
    /// Colour behind everything.
    pub background: [f32; 3],
}

impl Prepared {
    /// All views, those held out first.
    pub fn views(&self) -> impl Iterator<Item = &Photo> {
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
    pub fn load_to_train(self, memory: PhotoMemory<'_>, watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let prepared = self.load(memory, watcher)?;
        if prepared.train.is_empty() {
            return Err(Error::NothingToTrainOn(prepared.scene.source));
        }
        Ok(prepared)
    }

    /// Decodes the photos and divides them. Skipped ones are reported to `watcher`.
    ///
    /// # Errors
    /// No photo can be decoded; a temporary file that cannot be written.
    pub fn load(self, memory: PhotoMemory<'_>, watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let Self { mut scene, resize, selection } = self;
        let wanted = |effect| selection.effects.forced(effect) != Some(false);
        let options = LoadOptions { resize, alpha: wanted(Effect::Transparency), masks: wanted(Effect::Masks), memory };
        let total = scene.views.len();
        let photos = scene.load_photos(&options, &|done| watcher.loading(done, total))?;
        for line in scene.skipped.summary() {
            watcher.note(&line);
        }
        let split = scene.split(selection.eval_every);
        let train = split.train.iter().map(|i| photos[*i].clone()).collect();
        let test = split.test.iter().map(|i| (scene.views[*i].name.clone(), photos[*i].clone())).collect();
        let extent = scene.extent(&split.train);
        let usual = match FourthByte::of(&photos) {
            // The field trains and scores Blender scenes on white.
            FourthByte::Alpha => [1.0; 3],
            FourthByte::Opaque | FourthByte::Mask => [0.0; 3],
        };
        let background = selection.background.unwrap_or(usual);
        Ok(Prepared { scene, train, test, extent, background })
    }
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
