//! Loss, Adam, schedule, density control and the training loop.

pub mod adam;
pub mod attrition;
pub mod checkpoint;
pub mod density;
pub mod depth_loss;
pub mod device_photos;
pub mod dropout;
mod error;
pub mod exposure;
pub mod growth;
pub mod halve;
mod host_check;
pub mod initialise;
pub mod loss;
pub mod mask;
pub mod mean;
mod memory;
pub mod method;
mod moments;
mod objective;
mod options;
pub mod poses;
pub mod rates;
mod respond;
pub mod schedule;
pub mod smoothing;
pub mod state;
mod trainer;
mod training_model;

pub use error::{Error, Result};
pub use memory::TrainerNeeds;
pub use options::{Exposures, Options};
pub use respond::{PhotoNeeds, bytes as responses_bytes, responses, responses_by_photo};
pub use trainer::{Progress, Trainer};
pub use training_model::{Array, ArrayKind, TrainingModel};

use crate::render;

/// Names of the stages of every iteration in its timings, in order.
pub const STAGES: [&str; 9] = {
    let ([a, b, c, d, e], [f, g]) = (render::STAGES, render::BACKWARD_STAGES);
    [a, b, c, d, e, loss::STAGE, f, g, adam::STAGE]
};
