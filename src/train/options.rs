//! What a run depends on besides its photos and model.

use super::loss::Weights;
use super::schedule::Schedule;
use crate::render::Settings;
use std::ops::Range;

/// What a run depends on besides its photos and model.
#[derive(Clone, Debug)]
pub struct Options {
    /// Course of the run.
    pub schedule: Schedule,
    /// Image formation.
    pub settings: Settings,
    /// Key of all random numbers.
    pub seed: u32,
    /// Highest SH degree.
    pub degree: usize,
    /// No more Gaussians than this.
    pub most: usize,
    /// If each photo has an exposure of its own: the measured gains of red, green and blue by photo; empty if none could be
    /// measured.
    pub exposure: Option<Vec<[f32; 3]>>,
    /// Weights of the loss.
    pub weights: Weights,
    /// Iterations, after the last density step, whose responses are averaged for [`super::Trainer::averages`]; none where empty.
    pub averaged: Range<u32>,
    /// Room for (tile, Gaussian) pairs to begin with; results do not depend on it.
    pub pairs: u32,
}
