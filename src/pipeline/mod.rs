//! Floor 7: whole jobs as readable lists of stages.

pub mod budget;
pub mod checkpoint;
pub mod compare;
pub mod compress;
pub mod compressed;
pub mod compression;
pub mod config;
pub mod effects;
pub mod eval;
pub mod evaluate;
pub mod exposed;
pub mod gallery;
pub mod job;
pub mod orbit;
pub mod output;
pub mod pictures;
pub mod prepare;
pub mod ranges;
pub mod results;
pub mod run;
pub mod sweep;
pub mod virtual_views;
pub mod watcher;

pub use config::{Init, Preset, RunConfig, Selection};
pub use output::Output;
pub use watcher::Watcher;
