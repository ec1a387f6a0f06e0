//! Whole jobs as readable lists of stages.

pub mod active_run;
pub mod budget;
pub mod checkpoint;
pub mod compress;
pub mod config;
pub mod diagnostics;
mod draw_source;
pub mod earlier;
pub mod effects;
mod error;
pub mod eval;
pub mod evaluate;
pub mod film;
pub mod floaters;
mod host_memory;
pub mod kernels;
pub mod output;
pub mod pair_capacity;
pub mod panorama;
pub mod prepare;
pub mod prune;
pub mod records;
pub mod render;
pub mod run;
pub mod session;
pub mod setup;
pub mod start;
pub mod tune;
pub mod virtual_views;
pub mod watcher;

pub use config::{Init, Preset, RunConfig, Selection};
pub use earlier::Earlier;
pub use error::{Error, Relief};
pub use output::Output;
pub use session::{Session, host_bytes};
pub use watcher::{Silent, Watcher};
