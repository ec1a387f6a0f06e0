//! The Gaussians that training begins with.

use super::checkpoint::Checkpoint;
use super::config::{Init, RunConfig};
use super::prepare::{Opened, Prepared};
use crate::error::Error;
use crate::gaussians::{Gaussians, formats};
use crate::scene::SceneKind;
use crate::train::initialise::{self, Seed};

/// Random points for each pixel of a picture, and the bounds of their number.
const POINTS_PER_PIXEL: f64 = 0.3;
const POINTS: (usize, usize) = (5_000, 100_000);

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
    let seeds = match start {
        Start::Model(model) => return Ok(model),
        Start::Resumed(checkpoint) => return Ok(checkpoint.snapshot.model),
        Start::Points(_) => prepared.scene.points.iter().map(Seed::from).collect(),
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
