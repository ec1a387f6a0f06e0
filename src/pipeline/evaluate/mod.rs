//! Evaluation of models: views rendered, scored, and written.

mod assess;
mod camera_errors;
mod camera_fit;
mod evaluator;
pub mod exhibits;
mod exposure_fit;
pub mod pictures;

pub use assess::{Assessment, Compared, mean, protocol};
pub use camera_errors::camera_errors;
pub use evaluator::{Evaluator, HeldOut, hide, rgb, truth, weights};
