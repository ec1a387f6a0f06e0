//! Floor 7: whole jobs as readable lists of stages.

pub mod budget;
pub mod checkpoint;
pub mod compare;
pub mod compress;
pub mod config;
pub mod effects;
pub mod eval;
pub mod evaluate;
pub mod job;
pub mod output;
pub mod pairs;
pub mod prepare;
pub mod prune;
pub mod records;
pub mod run;
pub mod sweep;
pub mod virtual_views;
pub mod watcher;

pub use config::{Init, Preset, RunConfig, Selection};
pub use output::Output;
pub use watcher::Watcher;
