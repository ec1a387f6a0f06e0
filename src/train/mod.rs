//! Floor 6: loss, schedule, density control and the training loop.

pub mod checkpoint;
pub mod density;
mod error;
mod evidence;
pub mod exposure;
pub mod halve;
pub mod initialise;
pub mod loss;
pub mod mask;
mod memory;
mod objective;
pub mod photos;
pub mod pixels;
pub mod schedule;
pub mod smoothing;
mod trainer;

pub use error::{Error, Result};
pub use memory::Demand;
pub use trainer::{Options, Progress, Trainer};
