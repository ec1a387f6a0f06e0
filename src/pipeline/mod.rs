//! Floor 7: whole jobs as readable lists of stages.

pub mod config;
pub mod evaluate;
pub mod pictures;
pub mod prepare;
pub mod results;
pub mod run;

pub use config::{Init, Preset, RunConfig};
