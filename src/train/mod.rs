//! Floor 6: loss, schedule, density control and the training loop.

pub mod checkpoint;
pub mod density;
pub mod initialise;
pub mod loss;
mod memory;
pub mod photos;
pub mod schedule;
mod trainer;

pub use memory::Demand;
pub use trainer::{Options, Progress, Trainer};
