//! The interface for methods of other papers: their work within an iteration of training and between iterations.
//!
//! The training loop knows no method by name. A method is attached by [`Options::method`](super::Options::method);
//! `src/lab/methods` holds those of this program, each a file or folder. Without one, no hook is called and nothing is
//! recorded.

use super::error::Result;
use super::rates::Rates;
use super::schedule::Schedule;
use super::training_model::{ArrayKind, TrainingModel};
use crate::gpu::{Buffer, Device, Recording};
use crate::render::TrainingRenderer;
use crate::scene::camera::Camera;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A method that changes how a model grows or which Gaussians stay.
pub trait Method: Send + Sync {
    /// Its name in `config.toml`.
    fn name(&self) -> &'static str;

    /// Its arrays.
    fn arrays(&self) -> &'static [ArrayKind] {
        &[]
    }

    /// Returns true if it replaces density control and opacity resets.
    fn replaces_density_control(&self) -> bool {
        false
    }

    /// Returns true if [`Method::between`] is to be called after iteration `iteration`.
    fn acts(&self, _schedule: &Schedule, _iteration: u32) -> bool {
        false
    }

    /// Records commands between [`crate::render::Renderer::record_lists`] and [`crate::render::Renderer::record_blending`].
    fn before_blending(&self, _recording: &mut Recording, _now: &Iteration<'_>) {}

    /// Records commands between [`TrainingRenderer::record_backward`] and the step of Adam.
    fn before_adam(&self, _recording: &mut Recording, _now: &Iteration<'_>) {}

    /// Records commands after the step of Adam.
    fn after_adam(&self, _recording: &mut Recording, _now: &Iteration<'_>) {}

    /// Changes the model from the host, after an iteration for which [`Method::acts`] is true.
    ///
    /// # Errors
    /// Device memory; device errors. The model is then unchanged.
    fn between(&self, _pause: &mut Pause<'_>) -> Result<Changed> {
        Ok(Changed::default())
    }
}

impl fmt::Debug for dyn Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An iteration being recorded.
#[derive(Clone, Copy)]
pub struct Iteration<'a> {
    /// The renderer that draws its picture.
    pub renderer: &'a TrainingRenderer,
    /// The picture's camera.
    pub camera: &'a Camera,
    /// The model.
    pub model: &'a TrainingModel,
    /// The run's seed and the number of the iteration, from 1: keys of random numbers.
    pub key: [u32; 2],
    /// Gradient of the loss by the picture's red, green, blue and alpha.
    pub image_gradient: &'a Buffer<[f32; 4]>,
    /// True if the gradient's fourth component is not a gradient by alpha.
    pub colours: bool,
    /// Learning rates of the step of Adam.
    pub rates: Rates,
}

/// The state of a run between two iterations.
pub struct Pause<'a> {
    /// The device.
    pub device: &'a Device,
    /// The model, which may be changed.
    pub model: &'a mut TrainingModel,
    /// The run's schedule.
    pub schedule: &'a Schedule,
    /// The run's seed and the number of the last iteration.
    pub key: [u32; 2],
    /// Largest number of Gaussians.
    pub most: usize,
}

/// The changes that a method made between two iterations.
#[derive(Clone, Copy, Debug, Default)]
pub struct Changed {
    /// True if rows of the model were added, removed or moved.
    pub rows: bool,
    /// The cut that ends the method, if it is over: its arrays are then freed, and it is never called again.
    pub cut: Option<Cut>,
}

/// The cut to a given number of Gaussians that ends a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    /// Iterations done before it.
    pub iteration: u32,
    /// Gaussians before it.
    pub before: usize,
    /// Number of these that the method itself would have kept.
    pub shown: usize,
    /// Gaussians kept.
    pub after: usize,
}
