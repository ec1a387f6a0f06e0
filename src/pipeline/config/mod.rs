//! What jobs are asked to do, as `config.toml` and the command line have it.

mod file;
mod pruning;
pub mod ranges;
mod run;

pub use pruning::{Compression, Pruning, ResponseSource};
pub use run::{Init, Preset, RunConfig, Selection};
