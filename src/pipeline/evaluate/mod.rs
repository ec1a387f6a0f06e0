//! Models judged by views: pictures rendered, scored, and written.

mod evaluator;
pub mod exhibits;
mod exposure_fit;
pub mod pictures;
mod protocol;

pub use evaluator::{Evaluator, HeldOut, rgb, truth};
pub use protocol::{exposure_note, protocol};
