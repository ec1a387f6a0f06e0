//! From a scene on disk to views in memory, and to the Gaussians that training begins with.

use super::config::{Init, RunConfig, Selection};
use crate::error::Error;
use crate::gaussians::{Gaussians, formats};
use crate::scene::{OpenOptions, Resize, Scene, SceneKind};
use crate::train::initialise::{self, Seed};
use crate::train::photos::TrainView;
use glam::DVec3;
use std::sync::Arc;

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

/// Opens the scene and decodes its photos.
///
/// # Errors
/// What the scene's readers refuse; photos that are not there.
pub fn prepare(selection: &Selection, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<Prepared, Error> {
    let resize = match &selection.resolution {
        Some(text) => resolution(text).map_err(Error::Usage)?,
        None => Resize::Full,
    };
    let mut scene = Scene::open(&selection.scene, &OpenOptions { images: selection.images.clone(), undistort: None })?;
    scene.require_photos()?;
    let total = scene.views.len();
    let photos = scene.load_photos(resize, &|done| progress(done, total))?;
    let split = scene.split(selection.eval_every);
    let transparent = photos.iter().any(|p| p.has_alpha);
    let mut photos: Vec<_> = photos.into_iter().map(Some).collect();
    let mut view = |i: usize| TrainView {
        camera: scene.views[i].camera_at(resize),
        pixels: photos[i].take().map_or_else(|| Arc::from([]), |p| Arc::from(p.pixels)),
    };
    let train = split.train.iter().map(|i| view(*i)).collect();
    let test = split.test.iter().map(|i| (scene.views[*i].name.clone(), view(*i))).collect();
    let extent = scene.extent(&split.train);
    // The field trains and scores Blender scenes on white.
    let background = selection.background.unwrap_or(if transparent { [1.0; 3] } else { [0.0; 3] });
    Ok(Prepared { scene, train, test, extent, transparent, background })
}

/// The Gaussians that training begins with.
///
/// # Errors
/// A model that cannot be read; a scene in which no random point is seen by enough cameras.
pub fn initialise(config: &RunConfig, prepared: &Prepared) -> Result<Gaussians, Error> {
    let blender = prepared.scene.kind == SceneKind::Blender;
    let points = &prepared.scene.points;
    let seeds = match &config.init {
        Init::Model(path) => return Ok(formats::read(path)?.gaussians),
        Init::Points if !points.is_empty() => points
            .iter()
            .map(|p| Seed { position: p.position, colour: DVec3::from(p.colour.map(f64::from)) / 255.0 })
            .collect(),
        Init::Points | Init::Random => {
            let pixels = prepared.train.iter().map(|v| f64::from(v.camera.width) * f64::from(v.camera.height));
            let count = (pixels.fold(0.0, f64::max) * POINTS_PER_PIXEL) as usize;
            let count = config.init_count.unwrap_or(count.clamp(POINTS.0, POINTS.1));
            initialise::random(&prepared.train, count, blender, u64::from(config.seed))
        }
    };
    if seeds.is_empty() {
        return Err(Error::Usage(format!(
            "{}: no point to begin with: no place is seen by three cameras; check the poses, or give --init MODEL",
            config.scene.display()
        )));
    }
    let mut model = initialise::from_points(&seeds);
    if model.len() > config.max_gaussians {
        let n = model.len();
        // Evenly over the list, so that no region is left out.
        let kept: Vec<usize> = (0..config.max_gaussians).map(|k| k * n / config.max_gaussians).collect();
        model = model.select(&kept);
    }
    Ok(model)
}
