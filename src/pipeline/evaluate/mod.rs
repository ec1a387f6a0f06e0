//! Evaluation of models: views rendered, scored, and written.

mod assess;
mod evaluator;
pub mod exhibits;
mod exposure_fit;
pub mod pictures;

pub use assess::{Assessment, Compared, mean, protocol};
pub use evaluator::{Evaluator, HeldOut, hide, rgb, truth};
