//! Options of a run besides its photos and model.

use super::loss::Weights;
use super::method::Method;
use super::schedule::Schedule;
use crate::gaussians::MAX_SH_DEGREE;
use crate::render::Settings;
use std::ops::Range;
use std::sync::Arc;

/// Source of the photos' exposures.
#[derive(Clone, Debug, PartialEq)]
pub enum Exposures {
    /// Learnt with the model. They begin as these measured gains of red, green and blue, by photo; the list is empty if
    /// none could be measured.
    Learnt(Vec<[f32; 3]>),
    /// Known: a fixed affine map of [`super::exposure::SIZE`] numbers for each photo.
    Known(Vec<f32>),
}

impl Exposures {
    /// The measured gains, if the exposures are learnt.
    pub fn learnt(&self) -> Option<&[[f32; 3]]> {
        match self {
            Self::Learnt(gains) => Some(gains),
            Self::Known(_) => None,
        }
    }
}

/// Options of a run besides its photos and model.
#[derive(Clone, Debug)]
pub struct Options {
    /// The schedule of the run.
    pub schedule: Schedule,
    /// Settings of image formation.
    pub settings: Settings,
    /// Key of all random numbers.
    pub seed: u32,
    /// Highest SH degree.
    pub degree: usize,
    /// Largest number of Gaussians, without the tail.
    pub most: usize,
    /// Number of Gaussians at the model's end that are drawn and never change: the part of the other blocks that a
    /// block sees. They have no moments, and density control, resets, attrition and prunes leave them alone.
    pub tail: usize,
    /// Mean of the scene's camera centres in world units, if the photos are only a part of the scene's; default: the
    /// mean of the photos' own cameras.
    pub cameras: Option<[f32; 3]>,
    /// The photos' exposures, if each has one of its own.
    pub exposure: Option<Exposures>,
    /// True if the photos' cameras are corrected.
    pub poses: bool,
    /// True if pictures leave out Gaussians by chance.
    pub dropout: bool,
    /// True if pictures are compared with the photos' depth maps, too.
    pub depth_loss: bool,
    /// Weights of the loss.
    pub weights: Weights,
    /// Iterations, after the last density step, whose responses are averaged for [`super::Trainer::averages`]; may be empty.
    pub averaged: Range<u32>,
    /// The method of another paper to train with, if any.
    pub method: Option<Arc<dyn Method>>,
    /// Initial capacity in (tile, Gaussian) pairs; results do not depend on it.
    pub pairs: u32,
}

impl Default for Options {
    /// The 3DGS reference's schedule of 30,000 iterations over a black background.
    fn default() -> Self {
        Self {
            schedule: Schedule::default(),
            settings: Settings::default(),
            seed: 1,
            degree: MAX_SH_DEGREE,
            most: 4_000_000,
            tail: 0,
            cameras: None,
            exposure: None,
            poses: false,
            dropout: false,
            depth_loss: false,
            weights: Weights::default(),
            averaged: 0..0,
            method: None,
            pairs: 1 << 18,
        }
    }
}
