//! What a run depends on besides its views and model.

use super::loss::Weights;
use super::schedule::Schedule;
use crate::render::Settings;
use std::ops::Range;

/// What a run depends on besides its views and model.
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
    /// Whether the photos' alpha is opacity over the background.
    pub transparent: bool,
    /// Whether the photos' fourth byte says how much of a pixel counts.
    pub masked: bool,
    /// Where each photo has an exposure of its own: by view, the gains of red, green and blue that were
    /// measured; an empty list where none could be.
    pub exposure: Option<Vec<[f32; 3]>>,
    /// Weights of the loss.
    pub weights: Weights,
    /// Iterations, after the last density step, whose responses are averaged for [`super::Trainer::averages`]; none where empty.
    pub averaged: Range<u32>,
    /// Room for (tile, Gaussian) pairs to begin with; results do not depend on it.
    pub pairs: u32,
}

impl Options {
    /// Whether the photos' fourth byte is a share over the background: opacity, or how much of a pixel counts.
    pub(super) fn over(&self) -> bool {
        self.transparent || self.masked
    }
}
