//! Evaluation of models: views rendered, scored, and written.

mod assess;
mod camera_errors;
mod camera_fit;
mod evaluator;
pub mod exhibits;
mod exposure_fit;
pub mod pictures;

pub use assess::{Assessment, mean, protocol, rules};
pub use camera_errors::camera_errors;
pub use evaluator::{Evaluator, HeldOut, counts, hide, rgb, truth, weights};
pub use exposure_fit::exposure_rule;
